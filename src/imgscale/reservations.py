"""What a fit must say against itself."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imgscale.camera import Camera
from imgscale.conflicts import Conflict, conflicts
from imgscale.core.solving import Estimate, Problem
from imgscale.depth import GroundPlane
from imgscale.detection import Detection
from imgscale.flags import Flag, flags_where
from imgscale.implied_focal import plausible_focal
from imgscale.observations import Observations
from imgscale.posing import Setting, camera_counts, problem_of, view_of
from imgscale.prior_choice import mean_key
from imgscale.reference import OUTLIER, Reference
from imgscale.standing import scene_of


def reservations(
    detections: Sequence[Detection],
    references: Sequence[Reference],
    obs: Observations,
    found: Estimate,
    setting: Setting,
) -> Flag:
    """
    Collect a model's reservations.

    Parameters
    ----------
    detections : sequence of Detection
        The objects.
    references : sequence of Reference
        What each said.
    obs : Observations
        Their columns.
    found : Estimate
        The estimate.
    setting : Setting
        The options of the fit.

    Returns
    -------
    Flag
        Reservations.
    """
    used = [index for index, ref in enumerate(references) if ref.used]
    labels = {obs.prior[index].key for index in used}
    count = len(used)
    if setting.shared:
        labels.update(
            mean_key(row.label, row.axis, setting.priors) for row in setting.shared.others
        )
        count += len(setting.shared.others)
    has_camera = camera_counts(setting)
    return flags_where(
        {
            Flag.SINGLE_REFERENCE: count == 1 and not has_camera,
            Flag.SINGLE_LABEL: count > 1 and len(labels) == 1 and not has_camera,
            Flag.OUTLIERS: any(ref.reason == OUTLIER for ref in references),
            Flag.INCONSISTENT: (
                bool(found.inconsistent[0]) or bool(setting.shared and setting.shared.inconsistent)
            ),
            Flag.CAMERA_CONFLICT: bool(_conflicts(detections, obs, setting)),
            Flag.IMPLAUSIBLE_FOCAL: _implausible_focal(references, found, setting),
            Flag.ASSUMED_HORIZON: _assumed_horizon(found, setting),
            Flag.MIXED_DEPTH: any(references[index].mixed for index in used),
        }
    )


def _assumed_horizon(found: Estimate, setting: Setting) -> bool:
    """Tell whether nothing but the prior for photos at large fixed the horizon of a plane alone."""
    view = view_of(setting) if found.plane and not setting.shared else None
    if not (view and view.alone and found.plane):
        return False
    scene = scene_of(view)
    return not scene.is_given and float(found.plane.horizon_std[0]) > scene.horizon_std / 2


def _conflicts(
    detections: Sequence[Detection], obs: Observations, setting: Setting
) -> tuple[Conflict, ...]:
    """Compare the camera with what all references say together without it."""
    camera = setting.camera if setting.kind == "metric" else None
    if not (camera or setting.ground) or not (setting.shared or obs.eligible.size):
        return ()

    def pose(camera: Camera | None, ground: GroundPlane | None) -> Problem:
        return problem_of(detections, obs, setting._replace(camera=camera, ground=ground))

    return conflicts(camera, setting.ground, setting.scale_rel_std, setting.method, pose)


def _implausible_focal(references: Sequence[Reference], found: Estimate, setting: Setting) -> bool:
    """Tell whether the implied or the given focal length belongs to no camera that takes photos."""
    low, high = plausible_focal(setting.image_size, references)
    # a camera's may be that of a telephoto or a crop, but never as short as its millimetres
    too_short = setting.camera is not None and setting.camera.focal_px < low
    implied = math.exp(-float(found.log_k[0]))
    return too_short or (setting.kind == "metric" and not low <= implied <= high)
