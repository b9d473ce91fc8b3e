"""
Depth of a picture that comes without: all at one distance, or standing on the ground.

`OneDistance` suits what lies flat before the camera: a plate with a coin, a conveyor belt, a wall,
a view from above. `OnGround` suits what stands on a floor or a road and is seen from the side.
"""

from __future__ import annotations

import attrs
import numpy as np

from imgscale._checks import as_optional_float, non_negative, positive
from imgscale._typing import ImageArray, ImageSize
from imgscale.depth import DepthMap, GroundPlane
from imgscale.picture import size_of

__all__ = ["OnGround", "OneDistance"]

_DISTANCE_REL_STD = 0.02  # where a distance comes without its error, as for a camera's height


@attrs.frozen
class OneDistance:
    """
    Depth source for objects that are all equally far from the camera.

    It gives a map of one pixel that stands for the whole picture. Without a distance its kind is
    "relative" and its value 1, so that k is the metres per pixel; with one, its kind is "metric".

    Tell `fit` how far objects are off that distance: ``Noise(depth_rel=...)``, their heights above
    the common plane over the camera's distance from it. Round fruit beside a coin, seen from above,
    looks 6 to 12 % too large by its height and longer side, as its widest part is nearer (257
    portions of ECUSTFD [1]_, `benchmarks/food.py`); with 0.08, intervals of 90 % hold the true
    diameter in 96 to 98 % of them. For flat parts on a belt 0.01 or less is right. None, the
    default, learns it from how far the references disagree, and says 5 % where there is only one.

    Attributes
    ----------
    distance_m : float or None
        Distance from the camera along its optical axis, in metres, positive. None: not known.
    distance_std_m : float or None
        Its standard error, in metres, >= 0; 2 % where a distance comes without it.

    Raises
    ------
    ValueError
        If a number breaks its law, or a standard error comes without its distance.

    Notes
    -----
    Two such maps without a distance are alike, whatever their pictures show: `predict` takes the
    scale of one picture for another without `same_scale`. That is right for a fixed camera alone.

    References
    ----------
    .. [1] Y. Liang and J. Li, "Computer vision-based food calorie estimation: dataset, method, and
       experiment", arXiv:1705.07632, 2017.

    Examples
    --------
    A ruler gives the scale of the other things on the table:

    >>> import numpy as np
    >>> import imgscale as ims
    >>> from imgscale.depth_sources.assumed import OneDistance
    >>> image = np.zeros((480, 640, 3), dtype=np.uint8)
    >>> depth = OneDistance()(image)
    >>> depth.values, depth.image_size
    (array([[1.]]), (640, 480))
    >>> ruler = ims.ObjectPrior("ruler", 0.3, 0.0)
    >>> seen = [
    ...     ims.Detection("ruler", (10, 50, 40, 450)),
    ...     ims.Detection("cup", (200, 50, 300, 170)),
    ... ]
    >>> noise = ims.Noise(depth_rel=0.01)
    >>> model = ims.fit(seen, depth, ims.PriorTable([ruler]), noise=noise, method="robust")
    >>> round(ims.predict(model, seen, depth)[1].size_m, 6)
    0.09
    """

    distance_m: float | None = attrs.field(
        default=None,
        converter=as_optional_float,
        validator=attrs.validators.optional(positive),
    )
    distance_std_m: float | None = attrs.field(
        default=None,
        kw_only=True,
        converter=as_optional_float,
        validator=attrs.validators.optional(non_negative),
    )

    def __attrs_post_init__(self) -> None:
        if self.distance_m is None and self.distance_std_m is not None:
            msg = (
                "`distance_m` must be given with its standard error; "
                f"got None +- {self.distance_std_m}."
            )
            raise ValueError(msg)

    def __call__(self, image: ImageArray, /) -> DepthMap:
        """
        Give the depth of a picture.

        Parameters
        ----------
        image : (H, W, 3) or (H, W) ndarray of uint8
            The picture, of which only the size counts.

        Returns
        -------
        DepthMap
            One pixel, with the picture's size as `image_size`.

        Raises
        ------
        TypeError, ValueError
            If `image` is no picture.
        """
        size = size_of(image)
        if self.distance_m is None:
            return DepthMap(np.ones((1, 1)), kind="relative", image_size=size)
        std_m = self.distance_std_m
        return DepthMap(
            np.full((1, 1), self.distance_m),
            kind="metric",
            image_size=size,
            scale_rel_std=_DISTANCE_REL_STD if std_m is None else std_m / self.distance_m,
        )


@attrs.frozen(kw_only=True)
class OnGround:
    """
    Depth source for objects that stand on one plane: a `GroundPlane` of each picture's size.

    Attributes
    ----------
    horizon_px : float or None
        Row of the horizon, in pixels of the pictures, from the top; all of them must be of one
        size, taken by a camera that does not move. None: not known.
    horizon_std_px : float or None
        Its standard error, in pixels, >= 0, as in `GroundPlane`.
    camera_height_m : float or None
        Height of the camera above the plane, in metres, positive. None: not known.
    camera_height_std_m : float or None
        Its standard error, in metres, >= 0, as in `GroundPlane`.
    roll_deg : float or None
        Slope of the horizon, in degrees, as in `GroundPlane`. None: not known.
    roll_std_deg : float or None
        Its standard error, in degrees, >= 0, as in `GroundPlane`.

    Raises
    ------
    ValueError
        If a number breaks its law, or a standard error comes without its value.

    Examples
    --------
    >>> import numpy as np
    >>> from imgscale.depth_sources.assumed import OnGround
    >>> plane = OnGround(camera_height_m=1.65)(np.zeros((375, 1242, 3), dtype=np.uint8))
    >>> plane.image_size, plane.camera_height_m
    ((1242, 375), 1.65)
    """

    horizon_px: float | None = None
    horizon_std_px: float | None = None
    camera_height_m: float | None = None
    camera_height_std_m: float | None = None
    roll_deg: float | None = None
    roll_std_deg: float | None = None

    def __attrs_post_init__(self) -> None:
        self._plane((1, 1))  # the laws are the plane's: ask it now, not at the first picture

    def __call__(self, image: ImageArray, /) -> GroundPlane:
        """
        Give the ground plane of a picture.

        Parameters
        ----------
        image : (H, W, 3) or (H, W) ndarray of uint8
            The picture, of which only the size counts.

        Returns
        -------
        GroundPlane
            The plane, with the picture's size as `image_size`.

        Raises
        ------
        TypeError, ValueError
            If `image` is no picture.
        """
        return self._plane(size_of(image))

    def _plane(self, image_size: ImageSize) -> GroundPlane:
        return GroundPlane(image_size=image_size, **attrs.asdict(self))
