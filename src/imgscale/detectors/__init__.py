"""
Detections out of what detectors and annotation tools give; one module per backend.

Converters, ``from_x(result)``, are pure and import nothing; ``read_x(path)`` opens a file for one.
Runners wrap a backend object that you built and are a `Detector`. None of them downloads anything,
sets a threshold or picks a device.
"""

from __future__ import annotations

from imgscale.detectors.coco import from_coco, read_coco
from imgscale.detectors.face import FaceDetector
from imgscale.detectors.kitti import KittiObject, from_kitti, objects_from_kitti, read_kitti
from imgscale.detectors.megadetector import from_megadetector, read_megadetector
from imgscale.detectors.pascal_voc import from_pascal_voc, read_pascal_voc
from imgscale.detectors.rekognition import RekognitionDetector, from_rekognition
from imgscale.detectors.supervision import from_supervision, to_supervision, with_sizes
from imgscale.detectors.torchvision import from_torchvision
from imgscale.detectors.transformers import TransformersDetector, from_transformers
from imgscale.detectors.ultralytics import UltralyticsDetector, from_ultralytics
from imgscale.detectors.yolo import from_yolo, read_yolo

__all__ = [
    "FaceDetector",
    "KittiObject",
    "RekognitionDetector",
    "TransformersDetector",
    "UltralyticsDetector",
    "from_coco",
    "from_kitti",
    "from_megadetector",
    "from_pascal_voc",
    "from_rekognition",
    "from_supervision",
    "from_torchvision",
    "from_transformers",
    "from_ultralytics",
    "from_yolo",
    "objects_from_kitti",
    "read_coco",
    "read_kitti",
    "read_megadetector",
    "read_pascal_voc",
    "read_yolo",
    "to_supervision",
    "with_sizes",
]
