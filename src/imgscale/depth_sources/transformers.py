"""
Depth networks of Hugging Face transformers.

Their output does not say what its numbers are: metres for one model, inverse depth up to a factor
and a shift for another. The model's configuration says it for most. Tried with transformers 5.23.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any, cast

import attrs
import numpy as np

from imgscale._checks import as_array, as_float, as_optional_float, check_choice, non_negative
from imgscale._depth_values import VALUE_KINDS
from imgscale._optional import require
from imgscale._tensors import as_numpy
from imgscale._typing import AnyFloatArray, DepthKind, ImageArray
from imgscale.camera import Camera
from imgscale.depth_map import DepthMap
from imgscale.errors import MissingDependencyError
from imgscale.picture import upright_rgb

__all__ = ["TransformersDepth", "from_transformers", "kind_of"]

# Depth Pro writes 10 000 m where it sees no end, to within half precision; the others end at 80 m.
_SKY_M = 9_900.0
_NETWORK_SCALE_REL_STD = 0.15
# DPT's heads on these backbones come from MiDaS. On DINOv2's the published ones give metres.
_MIDAS_BACKBONES = ("beit", "bit", "swinv2")


def kind_of(config: Any) -> DepthKind:
    """
    Tell from a model's configuration what its depth is.

    ===============  ==========================================  ==================
    model type       where                                       kind
    ===============  ==========================================  ==================
    depth_anything   depth_estimation_type is "relative"         "affine_inverse"
    depth_anything   depth_estimation_type is "metric"           "metric"
    dpt              MiDaS: ViT, BEiT, BiT or Swin V2 backbone   "affine_inverse"
    depth_pro        use_fov_model is true                       "metric"
    glpn             always                                      "metric"
    tipsv2_dpt       always                                      "metric"
    zoedepth         always                                      "metric"
    ===============  ==========================================  ==================

    Parameters
    ----------
    config : PretrainedConfig
        The model's configuration, `model.config`.

    Returns
    -------
    str
        The kind, as for `DepthMap`.

    Raises
    ------
    ValueError
        If the configuration does not tell: dpt on DINOv2 (metres as published, anything as
        trained by others), depth_anything of another type or of none, depth_pro without its field
        of view ("relative" after post-processing), prompt_depth_anything (the unit of its prompt),
        chmv2 (the height of trees seen from above, no depth at all) and models that are not in the
        table.

    Notes
    -----
    A network that was trained further on other depth keeps its configuration. Declare its kind
    yourself.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> from imgscale.depth_sources.transformers import kind_of
    >>> kind_of(SimpleNamespace(model_type="depth_anything", depth_estimation_type="relative"))
    'affine_inverse'
    """
    model_type = getattr(config, "model_type", None)
    told = getattr(config, "depth_estimation_type", None)
    if model_type == "depth_anything" and told == "relative":
        return "affine_inverse"
    if model_type == "depth_anything" and told == "metric":
        return "metric"
    if model_type == "dpt" and _is_midas(config):
        return "affine_inverse"
    if model_type in ("glpn", "tipsv2_dpt", "zoedepth"):
        return "metric"
    if model_type == "depth_pro" and getattr(config, "use_fov_model", False):
        return "metric"
    listed = ", ".join(f'"{kind}"' for kind in VALUE_KINDS)
    msg = (
        f"`kind` must be given where the model's configuration does not tell; got model type "
        f"{model_type!r}. Find out what the model was trained to give and pass kind=, one of "
        f"{listed}."
    )
    raise ValueError(msg)


def _is_midas(config: Any) -> bool:
    """Tell MiDaS by its backbone; its plain ViT is written as none."""
    backbone = getattr(config, "backbone_config", "not told")
    return backbone is None or getattr(backbone, "model_type", None) in _MIDAS_BACKBONES


def from_transformers(
    result: Mapping[str, Any],
    *,
    kind: DepthKind,
    scale_rel_std: float | None = None,
    image_size: Sequence[int] | None = None,
) -> DepthMap:
    """
    Turn what a depth network said of one picture into a depth map.

    Parameters
    ----------
    result : dict
        A "depth-estimation" pipeline's result, or one picture's dict of
        `post_process_depth_estimation`. Its "predicted_depth" is read, (H, W) or (1, H, W), of any
        floating type, on any device. Its "depth" is a picture for display and never read.
    kind : str
        What the numbers are, as for `DepthMap`: ``kind_of(model.config)``, or what you know.
    scale_rel_std : float, optional
        Relative standard error of the map's scale as a whole, >= 0. Where omitted, 0.15 for
        "metric", as networks guess, and 0 for the others.
    image_size : (width, height), optional
        Size of the upright picture in pixels, where the map was not resized to it.

    Returns
    -------
    DepthMap
        The map, a copy. Values that are not positive are missing: inverse depth is clipped at 0
        where all is too far, and the resizing of a map makes negative metres at edges. So are
        those of 9900 m or more, which Depth Pro writes for the sky.

    Raises
    ------
    ValueError
        If the result has no "predicted_depth", holds no floats, is of several pictures, or is
        declared metric and is Depth Pro's output without the picture's size.
    TypeError
        If it is no dict.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale.depth_sources.transformers import from_transformers
    >>> result = {"predicted_depth": np.array([[2.5, 10_000.0]])}
    >>> from_transformers(result, kind="metric").values
    array([[2.5, nan]])
    """
    values = _predicted_depth(result)
    if kind == "metric":
        _check_post_processed(result)
        values = np.where(values >= _SKY_M, np.nan, values)
    elif kind == "affine_inverse":
        # every such network of `kind_of` ends in a ReLU: 0 is farther than it tells, not a value
        values = np.where(values > 0, values, np.nan)
    if scale_rel_std is None:
        scale_rel_std = _NETWORK_SCALE_REL_STD if kind == "metric" else 0.0
    return DepthMap(values, kind=kind, image_size=image_size, scale_rel_std=scale_rel_std)


def _predicted_depth(result: Any) -> AnyFloatArray:
    """Fetch the map of a result, whatever tensor holds it."""
    if not isinstance(result, Mapping):
        several = isinstance(result, list)
        remedy = "Pass result[0]." if several else "Pass the pipeline's dict as it is."
        msg = f"`result` must be one picture's dict; got {type(result).__name__}. {remedy}"
        raise TypeError(msg)
    found = cast("Mapping[str, Any]", result)
    if "predicted_depth" not in found:
        msg = f'`result` must have "predicted_depth"; got {list(found)}.'
        if "depth" in found:
            msg += ' "depth" has 8 bits, stretched for display: no depth can be read from it.'
        raise ValueError(msg)
    return _one_map(found["predicted_depth"])


def _one_map(given: Any) -> AnyFloatArray:
    """Turn a tensor of one picture into an (H, W) array."""
    name, law = 'result["predicted_depth"]', "of shape (H, W) or (1, H, W), one picture"
    values = as_array(name, law, as_numpy(given) if hasattr(given, "detach") else given)
    if values.dtype.kind != "f":
        msg = (
            f"`{name}` must be floating point; got dtype {values.dtype}. Pass what the network "
            "gave, not a picture of it."
        )
        raise ValueError(msg)
    if values.ndim == 3 and values.shape[0] == 1:
        values = values[0]
    if values.ndim != 2:
        msg = f"`{name}` must be {law}; got {values.shape}."
        raise ValueError(msg)
    return values


def _check_post_processed(result: Mapping[str, Any]) -> None:
    """Raise where Depth Pro's inverse depth was not put into metres by its focal length."""
    if "field_of_view" in result and result.get("focal_length") is None:
        msg = (
            '`result` must carry "focal_length" beside "field_of_view" to be metric; got none. '
            "Pass target_sizes=[(height, width)] of the picture to post_process_depth_estimation()."
        )
        raise ValueError(msg)


def _check_processor(_: object, __: attrs.Attribute[Any], value: object) -> None:
    if not hasattr(value, "post_process_depth_estimation"):
        msg = (
            "`image_processor` must have post_process_depth_estimation(); got "
            f"{type(value).__name__}. Take AutoImageProcessor's for the same checkpoint."
        )
        raise TypeError(msg)


def _check_model(value: object) -> None:
    if not hasattr(value, "config"):
        msg = (
            f"`model` must have a configuration, `config`; got {type(value).__name__}. Load one "
            "with AutoModelForDepthEstimation, or pass a pipeline's `pipe.model`."
        )
        raise TypeError(msg)


def _kind_of_model(source: TransformersDepth) -> DepthKind:
    _check_model(source.model)
    return kind_of(source.model.config)


def _check_kind(_: object, __: attrs.Attribute[Any], value: str) -> None:
    check_choice("kind", value, VALUE_KINDS)


@attrs.frozen(eq=False)
class TransformersDepth:
    """
    Run a depth network of transformers; it satisfies `DepthSource`.

    The model stays on its device and in its number type; pictures follow it. The map is resized to
    the picture by the image processor.

    Attributes
    ----------
    model : AutoModelForDepthEstimation
        The model, loaded, in evaluation mode.
    image_processor : AutoImageProcessor
        The image processor of the same checkpoint.
    kind : str
        What the model gives, as for `DepthMap`; `kind_of` its configuration where omitted.
    scale_rel_std : float or None
        As for `from_transformers`.
    focal_rel_std : float
        Relative standard error of the focal length in `with_camera`, >= 0. 0.25 is a judgement,
        not a figure from a source.

    Raises
    ------
    ValueError
        If the kind is omitted and the configuration does not tell it.
    TypeError
        If the model has no configuration, or the image processor cannot post-process depth.

    Examples
    --------
    With the `pipe` of ``transformers.pipeline("depth-estimation", model=...)``:

    >>> depth_source = TransformersDepth(pipe.model, pipe.image_processor)  # doctest: +SKIP
    """

    model: Any = attrs.field(repr=False)
    image_processor: Any = attrs.field(repr=False, validator=_check_processor)
    kind: DepthKind = attrs.field(
        default=attrs.Factory(_kind_of_model, takes_self=True),
        kw_only=True,
        validator=_check_kind,
    )
    scale_rel_std: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )
    focal_rel_std: float = attrs.field(
        default=0.25, kw_only=True, converter=as_float, validator=non_negative
    )

    def __attrs_post_init__(self) -> None:
        _check_model(self.model)

    def __call__(self, image: ImageArray, /) -> DepthMap:
        """
        Give the depth.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8
            The upright picture, RGB.

        Returns
        -------
        DepthMap
            (H, W), of the model's kind.

        Raises
        ------
        ValueError, TypeError
            If it is no such picture.
        MissingDependencyError
            If the model is a ZoeDepth and torchvision is absent, which its post-processing needs.
        """
        depth, _ = self.with_camera(image)
        return depth

    def with_camera(self, image: ImageArray, /) -> tuple[DepthMap, Camera | None]:
        """
        Give the depth and the camera that the network saw; a `DepthSource` as well.

        Parameters
        ----------
        image : (H, W, 3) ndarray of uint8
            The upright picture, RGB.

        Returns
        -------
        depth : DepthMap
            As the call gives it.
        camera : Camera or None
            Depth Pro's focal length, with the picture's size and `focal_rel_std`; None of a model
            that predicts none.

        Raises
        ------
        ValueError, TypeError, MissingDependencyError
            As the call does.

        Notes
        -----
        Depth Pro's depth is its focal length times what it saw, so the two err together and the
        error cancels from sizes: to treat them as two witnesses is on the safe side.
        """
        picture = upright_rgb(image)
        result = self._run(picture)
        size = (picture.shape[1], picture.shape[0])
        depth = from_transformers(
            result, kind=self.kind, scale_rel_std=self.scale_rel_std, image_size=size
        )
        focal_px = result.get("focal_length")
        if focal_px is None:
            return depth, None
        return depth, Camera(float(focal_px), focal_rel_std=self.focal_rel_std, image_size=size)

    def _run(self, image: ImageArray) -> Mapping[str, Any]:
        """Take a picture through the processor, the model and the post-processing."""
        torch = require("torch", extra="transformers", purpose="TransformersDepth")
        if (
            getattr(self.model.config, "model_type", None) == "zoedepth"
            and find_spec("torchvision") is None
        ):
            msg = (
                "ZoeDepth's post-processing needs the package 'torchvision'; install the one made "
                f"for your torch, {torch.__version__}."
            )
            raise MissingDependencyError(msg)
        inputs = self.image_processor(
            images=image, return_tensors="pt", input_data_format="channels_last"
        ).to(self.model.device, self.model.dtype)
        with torch.inference_mode():
            outputs = self.model(**inputs)
        # By place: ZoeDepth calls this argument source_sizes, all others target_sizes.
        (result,) = self.image_processor.post_process_depth_estimation(outputs, [image.shape[:2]])
        return cast("Mapping[str, Any]", result)
