"""Formats of single files: images, maps, point clouds, calibrations, labels."""
