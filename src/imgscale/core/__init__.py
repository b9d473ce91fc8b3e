"""The numerical core: arrays of many images at once; no detections, no images, no files."""
