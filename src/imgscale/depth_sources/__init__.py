"""
Depth out of files, sensors, stereo pairs and networks; one module per source.

A `DepthSource` is called with a picture and returns its depth; `read_depth` and `depth_from_points`
give the depth of one picture.
"""

from __future__ import annotations

from imgscale.depth_sources.assumed import OneDistance, OnGround
from imgscale.depth_sources.files import read_depth, read_values
from imgscale.depth_sources.lidar import LidarDepth, depth_from_points
from imgscale.depth_sources.stereo import StereoDepth, stereo_disparity
from imgscale.depth_sources.supervision import from_supervision, to_supervision
from imgscale.depth_sources.transformers import TransformersDepth, from_transformers, kind_of

__all__ = [
    "LidarDepth",
    "OnGround",
    "OneDistance",
    "StereoDepth",
    "TransformersDepth",
    "depth_from_points",
    "from_supervision",
    "from_transformers",
    "kind_of",
    "read_depth",
    "read_values",
    "stereo_disparity",
    "to_supervision",
]
