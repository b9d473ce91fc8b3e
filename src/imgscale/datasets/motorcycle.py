"""
A real photo with a stereo depth map and boxes, ready to be measured.

The scene is the Middlebury 2014 "Motorcycle" (Scharstein et al., GCPR 2014) that scikit-image
carries. Its calibration, quarter size: focal length 994.978 px, doffs 31.086 px, baseline 193.001
mm. With that baseline the rear tyre, whose size its code tells, comes out 1.46 times too small, so
the disparity is best taken as "inverse" depth, for which k is the baseline.
"""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imgscale._typing import FloatArray, ImageArray
from imgscale.camera import Camera
from imgscale.depth import DepthMap
from imgscale.detection import Detection
from imgscale.noise import Noise
from imgscale.object_prior import ObjectPrior
from imgscale.priors import PriorTable

__all__ = ["PUBLISHED_BASELINE_M", "Scene", "load"]

PUBLISHED_BASELINE_M = 0.193001
_FOCAL_PX = 994.978
_DOFFS_PX = 31.086
# 120/90-16: a 16 inch rim and twice 90 % of 120 mm, 0.4064 + 0.216 m. The spread is wear and load.
_REAR_TYRE = ObjectPrior(
    "rear tyre",
    0.622,
    0.012,
    source="nominal: size code 120/90-16",
    spans="tyre, ground to top",
)
# Drawn by eye on enlargements of the left image.
_BOXES = {
    "rear tyre": (121, 237, 279, 402),
    "front rim": (531, 297, 650, 435),
    "headlight": (510, 122, 561, 189),
    "bottle": (401, 52, 419, 92),
    "carton": (530, 31, 590, 98),
    "tall carton": (615, 184, 678, 274),
}


@attrs.frozen(eq=False, kw_only=True)
class Scene:
    """
    A photo and all that `fit` and `predict` take.

    Attributes
    ----------
    image : (500, 741, 3) ndarray of uint8
        The left photo.
    shifted_disparity : (500, 741) ndarray of float64
        Disparity + doffs, in pixels, NaN where there is none: proportional to inverse depth.
    detections : tuple of Detection
        Six hand-drawn boxes.
    priors : PriorTable
        The one object of known size, the rear tyre.
    camera : Camera
        The published focal length.
    noise : Noise
        Errors of hand-drawn boxes, 1.5 px, and of this disparity, 1 %: judged, not measured.
    """

    image: ImageArray
    shifted_disparity: FloatArray
    detections: tuple[Detection, ...]
    priors: PriorTable
    camera: Camera
    noise: Noise

    @property
    def depth(self) -> DepthMap:
        """The shifted disparity as inverse depth."""
        return DepthMap(self.shifted_disparity, kind="inverse")


def load() -> Scene:
    """
    Load the scene from scikit-image; nothing is downloaded.

    Returns
    -------
    Scene
        Photo, disparity and boxes.

    Examples
    --------
    >>> import imgscale as ims
    >>> from imgscale.datasets import motorcycle
    >>> scene = motorcycle.load()
    >>> model = ims.fit(scene.detections, scene.depth, scene.priors, noise=scene.noise)
    >>> print(model)
    k = 0.282 +- 0.008 m (stereo baseline) from 1 of 1 reference; without a prior: front rim,
    headlight, bottle, carton, tall carton
    """
    import skimage as ski  # noqa: PLC0415 - loads its parts on use

    stereo_motorcycle: Any = ski.data.stereo_motorcycle  # untyped there
    image, _, disparity = stereo_motorcycle()
    shifted = disparity.astype(np.float64) + _DOFFS_PX
    shifted[~np.isfinite(disparity)] = np.nan
    return Scene(
        image=image,
        shifted_disparity=shifted,
        detections=tuple(Detection(label, box) for label, box in _BOXES.items()),
        priors=PriorTable([_REAR_TYRE]),
        camera=Camera(_FOCAL_PX, focal_rel_std=0.0, image_size=(741, 500)),
        noise=Noise(box_px=1.5, depth_rel=0.01),
    )
