"""The fitted model: k and what it rests on. No solving."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike

from imgscale._checks import as_array, check_type, nan_as_none
from imgscale._depth_values import valid_depths
from imgscale._format import with_error
from imgscale._html import Column, Markup, element, joined, name_of, table
from imgscale._typing import AnyFloatArray, DepthKind, FitMethod, FloatArray, ImageSize
from imgscale.camera import Camera
from imgscale.depth import Depth, DepthMap, GroundPlane, check_depth_type
from imgscale.errors import DepthMismatchError
from imgscale.fitted_plane import FittedPlane
from imgscale.flags import Flag, flag_words
from imgscale.laws import LAWS
from imgscale.model_record import fields_from, record_of
from imgscale.noise import Noise
from imgscale.priors import PriorTable
from imgscale.reference import Reference, numbered_labels
from imgscale.shared_scale import SharedScale

__all__ = ["ScaleModel"]

_NO_PRIOR = "no prior"
MOST_ROWS = 30  # of a table in a notebook
_PART = 1 << 15  # pixels of a map at a time


@attrs.frozen(kw_only=True)
class ScaleModel:
    """
    The scale of one image, as `fit` found it.

    Attributes
    ----------
    k : float
        The scale constant: metres per pixel are k times depth (see `metres_per_pixel`). It is
        1 / focal length for metric depth and the stereo baseline in metres for raw disparity.
    k_std : float
        Its standard error: k times half the width of the central 68.3 % of log k.
    shift, shift_std : float
        Shift b of the inverse depth and its standard error; 0 for kinds without one.
    correlation : float
        Correlation of the errors of log k and shift; 0 for kinds without one.
    kind : str
        The kind of depth it was fitted to.
    method : str
        The estimator.
    mean_depth : float
        Mean depth of the references used, in the unit of the depth given (the paper's fig. 3.17);
        NaN where the camera alone fixed the scale.
    references : tuple of Reference
        One for each detection given to `fit`, in their order.
    flags : Flag
        Reservations.
    priors : PriorTable
        The sizes it rests on.
    noise : Noise
        The errors it assumed, used again by `predict`.
    camera : Camera or None
        The camera given.
    ground : GroundPlane or None
        What was given of the ground plane; None where it took no part.
    plane : FittedPlane or None
        The ground plane as it was found.
    image_size : (width, height) or None
        Size of the image in pixels, where known.
    fingerprint : int or None
        Checksum of the depth map it was fitted to.
    scale_rel_std : float
        Relative standard error of the depth map's scale as a whole, as the map carried it.
    depth_rel : float or None
        Relative noise of the depths, as learned from how far the references disagree; None where
        it was told.
    shared : SharedScale or None
        What the frames of one camera say together, for a model of `fit_shared`.
    """

    k: float
    k_std: float
    shift: float
    shift_std: float
    correlation: float
    kind: DepthKind
    method: FitMethod
    mean_depth: float = attrs.field(eq=nan_as_none)
    references: tuple[Reference, ...]
    flags: Flag
    priors: PriorTable = attrs.field(repr=lambda table: f"<{len(table)} priors>")
    noise: Noise
    camera: Camera | None
    ground: GroundPlane | None
    plane: FittedPlane | None
    image_size: ImageSize | None
    fingerprint: int | None
    scale_rel_std: float
    depth_rel: float | None
    shared: SharedScale | None = None

    @property
    def unknown_noise(self) -> bool:
        """True where the noise of the depths was told by nobody, nor learned over many frames."""
        return self.depth_rel is not None and self.noise.depth_rel is None

    @property
    def focal_px(self) -> float | None:
        """Focal length in pixels: the camera's, else 1 / k for metric depth, else None."""
        if self.camera is not None:
            return self.camera.focal_px
        return 1 / self.k if self.kind == "metric" else None

    @property
    def camera_is_witness(self) -> bool:
        """True where the camera's focal length took part in the fit: with metric depth, k = 1/f."""
        fitted = self.method in {"robust", "posterior"}
        return self.camera is not None and self.kind == "metric" and fitted

    @property
    def camera_height_m(self) -> float | None:
        """Height of the camera above the ground plane in metres; None without a plane."""
        return self.plane.camera_height_m if self.plane else None

    @property
    def horizon_px(self) -> float | None:
        """Row of the horizon in the middle column, in pixels; None without a plane."""
        return self.plane.horizon_px if self.plane else None

    @property
    def mse_m2(self) -> float:
        """
        Mean squared error of the used references' sizes, in square metres (fig. 3.18).

        Each is predicted as ``k * d * p`` with the image's one k and compared with its prior mean.
        """
        law = LAWS[self.kind]
        squares = [
            (
                ref.prior_m
                - self.k * float(law.relative_distance(ref.depth, self.shift)) * ref.pixels
            )
            ** 2
            for ref in self.references
            if ref.used
        ]
        return float(np.mean(squares)) if squares else math.nan

    def metres_per_pixel(self, depth: ArrayLike) -> FloatArray:
        """
        Compute the scale at given depths.

        Parameters
        ----------
        depth : array_like of float
            Depth values of the model's kind, of any shape.

        Returns
        -------
        ndarray of float64
            ``k * d`` in m/px, of the same shape; NaN where a value is no depth.

        Examples
        --------
        >>> import imgscale as ims
        >>> door = ims.Detection("door", (100, 50, 180, 250))
        >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.0)])
        >>> model = ims.fit([door], ims.ObjectDepths([4.0], kind="relative"), table)
        >>> model.metres_per_pixel([4.0, 8.0])
        array([0.01, 0.02])
        """
        given = as_array("depth", "an array of numbers", depth)
        if given.dtype.kind not in "fiu":
            msg = f"`depth` must hold real numbers; got dtype {given.dtype}."
            raise TypeError(msg)
        values = given.astype(np.float64, copy=False)
        scale: FloatArray = np.empty(values.shape, dtype=np.float64)
        self._scale_into(scale, values, mark=True)
        return scale

    def scale_map(self, depth: DepthMap) -> AnyFloatArray:
        """
        Compute the scale at every pixel of the depth map.

        Parameters
        ----------
        depth : DepthMap
            The map that the model was fitted to, or for metric depth any map of that camera.

        Returns
        -------
        (H, W) ndarray of float32 or float64
            Metres per pixel of the image, for an object that lies there; NaN without depth. Of
            float32 for maps of float32 and float16, exact to 2e-7, but where the numbers do not
            fit it; of float64 for all others.

        Raises
        ------
        DepthMismatchError
            If the map is of another kind or, unless the kind is metric, another map.
        """
        self.check_depth(depth, same_scale=False)
        ends = self.metres_per_pixel(depth.valid_range)  # NaN beyond the horizon
        narrow = depth.values.dtype.itemsize <= 4 and _fit_float32([self.k, *ends.tolist()])
        scale: AnyFloatArray = np.empty_like(
            depth.values, dtype=np.float32 if narrow else np.float64
        )
        mark = not depth.gaps_are_nan or bool(np.isnan(ends).any())
        # in the order of memory; several steps in parts that stay in the processor's cache
        flat: AnyFloatArray = scale.reshape(-1, order="A")
        given: AnyFloatArray = depth.values.reshape(-1, order="A")
        size = _PART if mark or self.shift else flat.size
        for start in range(0, flat.size, size):
            part = slice(start, start + size)
            self._scale_into(flat[part], given[part], mark=mark)
        return scale

    def _scale_into(self, scale: AnyFloatArray, values: AnyFloatArray, *, mark: bool) -> None:
        """Write metres per pixel, and NaN where a value is no depth if that is to be marked."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            LAWS[self.kind].scale_into(scale, values, self.k, self.shift)
            if mark:
                missing = ~(valid_depths(values, self.kind) & (scale > 0))
                # all bits set are NaN; to copy under a mask takes several times as long
                bits = scale.view(f"i{scale.itemsize}")
                bits |= -missing.view(np.int8)

    def to_metric(self, depth: DepthMap, camera: Camera) -> DepthMap:
        """
        Put a depth map of any kind into metres.

        Parameters
        ----------
        depth : DepthMap
            The map that the model was fitted to, or for metric depth any map of that scale.
        camera : Camera
            The camera's focal length, in pixels of the image.

        Returns
        -------
        DepthMap
            Metric z-depth, Z = focal length x metres per pixel, with the errors of k and of the
            focal length, taken as independent, as its `scale_rel_std`. A metric map is put to the
            references' scale too: where its own is better known, leave it as it is.

        Raises
        ------
        DepthMismatchError
            If the map is of another kind or, unless the kind is metric, another map.
        ValueError
            If the camera belongs to another size of image.

        Examples
        --------
        One known object puts a relative map into metres:

        >>> import numpy as np
        >>> import imgscale as ims
        >>> depth = ims.DepthMap(np.full((480, 640), 4.0), kind="relative")
        >>> door = ims.Detection("door", (100, 50, 180, 250))
        >>> table = ims.PriorTable([ims.ObjectPrior("door", 2.0, 0.02)])
        >>> model = ims.fit([door], depth, table)
        >>> metric = model.to_metric(depth, ims.Camera(500.0, focal_rel_std=0.0))
        >>> float(metric.values[0, 0].round(2))
        5.0
        """
        check_type("depth", depth, DepthMap, " Only maps can be put into metres.")
        check_type("camera", camera, Camera).check_image_size(depth.image_size)
        return DepthMap(
            camera.focal_px * self.scale_map(depth),
            kind="metric",
            image_size=depth.image_size,
            scale_rel_std=math.hypot(self._scale_rel_std, camera.focal_rel_std),
        )

    @property
    def _scale_rel_std(self) -> float:
        """Relative error of metres per pixel; with a shift, at the references' mean depth."""
        of_k = self.k_std / self.k
        if not LAWS[self.kind].has_shift or math.isnan(self.mean_depth):
            return of_k
        distance = float(LAWS[self.kind].relative_distance(self.mean_depth, self.shift))
        of_shift = self.shift_std * distance
        variance = of_k**2 + of_shift**2 - 2 * self.correlation * of_k * of_shift
        return math.sqrt(max(variance, 0.0))

    def check_depth(self, depth: Depth, *, same_scale: bool) -> None:
        """
        Raise unless depth is of the model's kind and scale.

        Parameters
        ----------
        depth : DepthMap, ObjectDepths or GroundPlane
            The depth to be used with the model.
        same_scale : bool
            True where the caller vouches that another map has the scale of the fitted one.

        Raises
        ------
        DepthMismatchError
            If the kind or the image's size differs or, unless the kind is metric, the map.
        TypeError
            If it is no depth.
        """
        if check_depth_type(depth).kind != self.kind:
            msg = f'`depth` must be of the model\'s kind, "{self.kind}"; got "{depth.kind}".'
            raise DepthMismatchError(msg)
        if self.image_size and depth.image_size and self.image_size != depth.image_size:
            msg = (
                f"`depth` must have the image_size of the fitted image, {self.image_size}; got "
                f"{depth.image_size}. k belongs to pixels of that size; fit the resized image anew."
            )
            raise DepthMismatchError(msg)
        if self.kind == "metric" or same_scale or self.fingerprint is None:
            return
        if isinstance(depth, DepthMap) and depth.fingerprint != self.fingerprint:
            msg = (
                f'`depth` must be the map that the model was fitted to; got another "{self.kind}" '
                "map (or a copy of other precision), whose scale is its own. Fit it anew, or pass "
                "same_scale=True where its source keeps one scale."
            )
            raise DepthMismatchError(msg)

    def to_dict(self) -> dict[str, Any]:
        """
        Turn the model into built-in types that `json` writes.

        Returns
        -------
        dict
            With a "schema" entry; floats that are not finite become None.
        """
        return record_of(self)

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> ScaleModel:
        """
        Rebuild a model from `to_dict`.

        Parameters
        ----------
        record : mapping
            What `to_dict` returned, also after a round trip through JSON.

        Returns
        -------
        ScaleModel
            An equal model.

        Raises
        ------
        TypeError
            If the record is no mapping.
        ValueError
            If it is of another schema, lacks a field, or holds what no model holds.
        """
        return cls(**fields_from(record, [field.name for field in attrs.fields(cls)]))

    def __str__(self) -> str:
        pairs = _named(self.references)
        text = summary(self)
        for title, wanted in (("not used", True), ("without a prior", False)):
            names = [
                f"{name} ({ref.reason})" if wanted else name
                for name, ref in pairs
                if not ref.used and (ref.reason != _NO_PRIOR) == wanted
            ]
            if names:
                text += f"; {title}: {', '.join(names)}"
        return text

    def _repr_html_(self) -> str:
        return joined((summary_html(self), references_table(self, most=MOST_ROWS)))


def _fit_float32(numbers: Sequence[float]) -> bool:
    """Tell whether float32 holds numbers, those that are any, in its full precision."""
    range32 = np.finfo(np.float32)
    return all(
        math.isnan(number) or float(range32.tiny) <= number <= float(range32.max)
        for number in numbers
    )


def summary_html(model: ScaleModel) -> Markup:
    """
    Write a model's k, what it is from and its reservations as HTML.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    Markup
        A paragraph, and another one with the flags in words where there are any.
    """
    words = ", ".join(flag_words(model.flags))
    texts = [summary(model).replace("+-", "±"), f"Reservations: {words}" if words else ""]
    return joined(element("p", text, style="margin:0.25em 0") for text in texts if text)


def references_table(model: ScaleModel, *, most: int | None = None) -> Markup:
    """
    Lay out what every detection said of the scale as an HTML table.

    Parameters
    ----------
    model : ScaleModel
        The model.
    most : int, optional
        Rows to be shown.

    Returns
    -------
    Markup
        Object, size by its prior, extent in pixels, depth, share in k, z-score and use:
        references used first, the heaviest at the top; then those not used, with the reason; then
        what has no prior.
    """
    columns = (
        Column("object"),
        Column("known size", numeric=True),
        Column("pixels", numeric=True),
        Column("foot row" if model.kind == "ground_plane" else "depth", numeric=True),
        Column("share in k", numeric=True),
        Column("z-score", numeric=True),
        Column("use"),
    )
    pairs = sorted(
        _named(model.references),
        key=lambda pair: (not pair[1].used, pair[1].reason == _NO_PRIOR, -pair[1].weight),
    )
    return table(columns, [_reference_cells(name, ref) for name, ref in pairs], most=most)


def _reference_cells(name: str, ref: Reference) -> tuple[str, ...]:
    known = not math.isnan(ref.prior_m)
    size = with_error(ref.prior_m, ref.prior_std_m).replace("+-", "±")
    use = "no known size" if ref.reason == _NO_PRIOR else f"not used: {ref.reason}"
    return (
        name_of(name),
        f"{size} m" if known else "",
        f"{ref.pixels:.4g}",
        "" if math.isnan(ref.depth) else f"{ref.depth:.4g}",
        _share_text(ref.weight) if ref.used else "",
        "" if math.isnan(ref.z_score) else f"{ref.z_score:+z.1f}",
        "used" if ref.used else use,
    )


def _share_text(share: float) -> str:
    return "under 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"


def _named(references: Sequence[Reference]) -> list[tuple[str, Reference]]:
    """Give every reference a name of its own."""
    names = numbered_labels([ref.label for ref in references])
    return list(zip(names, references, strict=True))


def summary(model: ScaleModel) -> str:
    """
    Tell k and what it is from, without naming the references.

    Parameters
    ----------
    model : ScaleModel
        The model.

    Returns
    -------
    str
        The beginning of ``str(model)``.
    """
    law = LAWS[model.kind]
    used = sum(ref.used for ref in model.references)
    candidates = sum(ref.reason != _NO_PRIOR for ref in model.references)
    noun = "reference" if candidates == 1 else "references"
    shift = ""
    if model.kind == "ground_plane" and model.plane:
        shift = f", horizon at row {with_error(-model.shift, model.shift_std)} px,"
    elif law.has_shift:
        shift = f", shift {with_error(model.shift, model.shift_std)},"
    text = f"{_k_text(model)} ({law.k_meaning}){shift} from {used} of {candidates} {noun}"
    if model.shared:
        text += f" and those of {model.shared.n_frames - 1} other frames"
    if model.camera_is_witness:
        text += " and the camera's focal length"
    if model.ground and model.ground.camera_height_m is not None:
        text += " and the camera's height as it was given"
    if model.ground and model.ground.horizon_px is not None:
        text += " and the horizon as it was given"
    if model.plane and model.kind != "ground_plane":
        height = with_error(model.plane.camera_height_m, model.plane.camera_height_std_m)
        text += f"; the camera is {height} m above the ground"
    return text


def _k_text(model: ScaleModel) -> str:
    """Write k with its error, in powers of ten where it is small."""
    unit = LAWS[model.kind].k_unit
    if 1e-3 <= model.k < 1e6:
        return f"k = {with_error(model.k, model.k_std)} {unit}"
    exponent = math.floor(math.log10(model.k))
    factor = 10.0**exponent
    return f"k = ({with_error(model.k / factor, model.k_std / factor)})e{exponent} {unit}"
