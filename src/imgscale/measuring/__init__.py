"""
Measure anything in the picture: the distance of two pixels in space, the extents of a region.

`predict` sizes detections; these verbs take what a person points at: two pixels, a mask, a
polygon, a label image. Where the model has the errors of a camera, a shift or a ground plane, so
have their intervals.
"""

from __future__ import annotations

from imgscale.measuring.distances import distance
from imgscale.measuring.extents import extent
from imgscale.measuring.tables import regionprops_table
from imgscale.quantity import Extent, Quantity

__all__ = ["Extent", "Quantity", "distance", "extent", "regionprops_table"]
