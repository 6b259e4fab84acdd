"""Frames, boxes, calibration and projection: the mathematics that everything else stands on."""
