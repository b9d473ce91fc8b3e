"""One run: what the library is shown of the scenes, and what is asked of it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, TypeAlias

import imgscale as ims

Protocol: TypeAlias = Literal["L", "U", "k"]
Kind: TypeAlias = Literal["metric", "relative", "inverse", "affine_inverse", "ground_plane"]
Damage: TypeAlias = Literal["none", "mixed", "cut", "swap"]
Boxes: TypeAlias = Literal["label", "frustum", "zenuity"]

# Boxes err by pixels and by a share of the object's height: labels, then detectors.
_BOX_PX = {"label": 1.5, "frustum": 2.0, "zenuity": 2.0}
_BOX_REL = {"label": 0.0, "frustum": 0.04, "zenuity": 0.06}
# Even exact depths miss the surface that the box outlines by this much.
_LEAST_DEPTH_REL = 0.015


@dataclass(frozen=True, kw_only=True)
class Run:
    """
    One run over all scenes.

    Protocol "L" sizes each known object from the other known ones of its image. "U" sizes objects
    of unknown class from known ones. "k" fits all known objects and looks at the scale alone: at
    the focal length or, on the ground plane, at the camera's height and the horizon.
    """

    protocol: Protocol
    depth_noise: float = 0.0
    told: bool = True
    """Whether the library is told how much the depths err."""
    depth: Literal["surface", "centre", "corrected", "map"] = "surface"
    """Which depth it is given; "corrected" is the centre's, declared as such."""
    kind: Kind = "metric"
    """Of which kind its depth is; of the "ground_plane" there is none but the foot rows."""
    foot: bool = False
    """Whether the foot rows are a second witness of distance, beside the depth."""
    shift_std: float = 0.0
    """Spread of an affine inverse depth's shift, in 1/m."""
    use_prior: bool = True
    """In "L": whether the own class of the object counts."""
    damage: Damage | None = None
    """What is done to the references. Unless None each target has a fit of its own, by hand."""
    boxes: Boxes = "label"
    fewest: int = 1
    """References that an image must have for each target."""
    pooled: bool = False
    """
    Whether a fit rests on all images of a drive together: "L" then sizes each known object from
    the other parts of its drive, "k" has one answer for each drive.
    """
    tracks: bool = False
    """Whether the library is told which objects of a drive are the same."""
    learned: bool = False
    """Whether each drive is first searched for its depth noise, which then is told."""
    paper: bool = False
    """Whether the paper's estimator answers, instead of the library's best."""

    @property
    def noise(self) -> ims.Noise:
        """What the library is told of the errors."""
        return ims.Noise(
            box_px=_BOX_PX[self.boxes],
            box_rel=_BOX_REL[self.boxes],
            depth_rel=max(self.depth_noise, _LEAST_DEPTH_REL) if self.told else None,
        )

    @property
    def uses_prior(self) -> bool:
        """Whether the object's own class counts."""
        return self.protocol == "L" and self.use_prior and not self.paper

    @property
    def summary(self) -> str:
        """What differs from the plainest run, in words."""
        unusual = [field for field in fields(self) if getattr(self, field.name) != field.default]
        return ", ".join(f"{field.name} {getattr(self, field.name)}" for field in unusual)

    def by_paper(self) -> Run | None:
        """Return the same with the paper's estimator; None where it has no answer."""
        if self.pooled or self.kind in {"affine_inverse", "ground_plane"}:
            return None
        depth = "centre" if self.depth == "corrected" else self.depth
        # of what it ignores only one choice is kept, so that it is run once
        return replace(
            self,
            paper=True,
            told=True,
            use_prior=False,
            depth=depth,
            foot=False,
            learned=False,
        )
