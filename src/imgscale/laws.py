"""
The one law that every kind of depth obeys, ``p / H = (D + b) / k``.

p is an object's extent in pixels, H its size in metres, D an inverse depth, b its shift and k the
image's scale constant. With ``d = 1 / (D + b)`` the metres per pixel are ``k * d``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from imgscale._typing import AnyFloatArray, DepthKind, FloatArray

# A focal length outside this range, in units of the longer image side, belongs to no camera that
# takes photos (fields of view of 118 and 9.5 degrees): the depths or the sizes have a wrong unit.
PLAUSIBLE_FOCAL = (0.3, 6.0)


class Law(NamedTuple):
    """
    Hold what the values of one kind of depth mean.

    Attributes
    ----------
    kind : str
        The kind of depth.
    inverse : bool
        True where larger values are nearer.
    has_shift : bool
        True where the shift b is unknown and must be fitted.
    k_unit : str
        Unit of k.
    k_meaning : str
        The physical quantity that k is.
    """

    kind: DepthKind
    inverse: bool
    has_shift: bool
    k_unit: str
    k_meaning: str

    def relative_distance(self, values: AnyFloatArray | float, shift: float = 0.0) -> FloatArray:
        """
        Compute d, to which metres per pixel are proportional: ``1 / (D + b)``.

        Parameters
        ----------
        values : ndarray of float
            Depth values of this kind, valid ones.
        shift : float
            The shift b, in the unit of D.

        Returns
        -------
        ndarray of float64
            Values of d, of the same shape, in the unit of a z-depth.
        """
        array = np.asarray(values, dtype=np.float64)
        if not self.inverse:
            return array if shift == 0 else 1 / (1 / array + shift)
        return 1 / (array + shift)

    def scale_into(
        self, scale: AnyFloatArray, values: AnyFloatArray, k: float, shift: float
    ) -> None:
        """
        Write metres per pixel, ``k * d``, into an array.

        Parameters
        ----------
        scale : ndarray of float
            Where they go, rounded to its precision.
        values : ndarray of float
            Depth values of this kind, of the same shape.
        k : float
            The scale constant.
        shift : float
            The shift b, in the unit of D.
        """
        if shift != 0:  # in double precision: far away, D and b are all but opposite
            distance = self.relative_distance(values, shift)
            np.multiply(distance, k, out=scale, casting="same_kind")
        elif self.inverse:
            np.divide(k, values, out=scale, dtype=scale.dtype)
        else:
            np.multiply(values, k, out=scale, dtype=scale.dtype)

    def inverse_depth(self, values: AnyFloatArray | float) -> FloatArray:
        """
        Compute the D of the law, in which it is linear.

        Parameters
        ----------
        values : ndarray of float
            Depth values of this kind, valid ones or NaN.

        Returns
        -------
        ndarray of float64
            The values themselves where larger ones are nearer, else 1 / values.
        """
        array = np.asarray(values, dtype=np.float64)
        if self.inverse:
            return array
        with np.errstate(over="ignore"):  # of what is all but 0: infinitely near
            nearness: FloatArray = 1 / array
        return nearness

    def value_at(self, relative_distance: float, shift: float = 0.0) -> float:
        """
        Invert `relative_distance` for one number.

        Parameters
        ----------
        relative_distance : float
            Value of d, positive.
        shift : float
            The shift b, in the unit of D.

        Returns
        -------
        float
            The depth value of this kind that lies there.
        """
        inverse_depth = 1 / relative_distance - shift
        return inverse_depth if self.inverse else 1 / inverse_depth


LAWS: Mapping[DepthKind, Law] = {
    law.kind: law
    for law in (
        Law("metric", False, False, "1/px", "1 / focal length"),  # noqa: FBT003 - a table
        Law("relative", False, False, "m per px and depth unit", "depth unit / focal length"),  # noqa: FBT003
        Law("inverse", True, False, "m", "stereo baseline"),  # noqa: FBT003
        Law("affine_inverse", True, True, "m", "stereo baseline"),  # noqa: FBT003
        Law("ground_plane", True, True, "m", "camera height"),  # noqa: FBT003
    )
}
