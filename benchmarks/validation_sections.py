"""The sections of the validation: groups of rows, and what they show."""

from __future__ import annotations

from typing import NamedTuple


class Section(NamedTuple):
    """A group of rows and what they show."""

    name: str
    title: str


NOISE = Section(
    "noise",
    "Depth noise of 0 to 20 %, of which the library is told or not. L: each known object from the "
    "others of\nits image and from its class. U: objects of unknown class from Car, Pedestrian, "
    "Cyclist.",
)
CENTRE = Section(
    "centre", "The depth of objects' centres instead of their near faces, uncorrected and declared."
)
KINDS = Section(
    "kinds",
    "Depth with an unknown factor per image; affine also with an unknown shift of the inverse "
    "depth, of\nspread .03 or .1 1/m. 'unfused': without the class of the object itself.",
)
DAMAGE = Section(
    "damage",
    "One reference in five damaged: cut by 40 % from above or below, of a wrong class, or either "
    "(mixed);\nobjects to be sized whole. x: ratio to the same run with sound references.",
)
COUNT = Section("references", "By the number of references, at 5 % depth noise.")
DETECTORS = Section(
    "detectors",
    "Boxes and classes of detectors (score >= 0.5, overlap with a label >= 0.5); the labels' depth "
    "+ 5 %.",
)
LIDAR = Section(
    "lidar",
    "Depth maps (KITTI: from LiDAR) end to end; few, to be read with care. lidar-k: log(k f), its "
    "error and coverage.",
)
FOOT = Section(
    "foot",
    "The foot row as a second witness of distance beside the depth, whose noise is told or not; "
    "then with\nboxes and classes of detectors, at 5 % depth noise.",
)
GROUND = Section(
    "ground",
    "The ground plane without any depth: known objects from two others of their image or more. "
    "ground-camera:\nthe camera's height (log, in %) and the horizon (in pixels, not in %), from "
    "two known objects or more.",
)
POOLED = Section(
    "pooled",
    "All images of a drive together, in drives of ten or more. pooled-k: log(k f) of each drive; "
    "'tracks': told\nwhich objects are the same. pooled-height, -ground: known objects from the "
    "other four fifths of the drive.\npooled-camera: height (log, in %) and horizon (in pixels, "
    "not in %) of each drive.",
)
LEARNED = Section(
    "learned",
    "Depth noise that is not told but learned over each drive, then told image by image; with and "
    "without the\nfoot row.",
)
SECTIONS = (
    NOISE,
    CENTRE,
    KINDS,
    DAMAGE,
    COUNT,
    DETECTORS,
    LIDAR,
    FOOT,
    GROUND,
    POOLED,
    LEARNED,
)
