"""Depth out of files, sensors, stereo pairs and networks; one module per source."""
