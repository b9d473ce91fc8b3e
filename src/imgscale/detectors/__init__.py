"""Detections out of what detectors and annotation tools give; one module per backend."""
