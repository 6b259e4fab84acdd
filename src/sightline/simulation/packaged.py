"""Frames included in the package, for trials without a download."""

from pathlib import Path
from typing import Final

PACKAGED_FRAMES: Final = Path(__file__).with_name("frames")
"""KITTI object tree of two simulated frames (`make frames` makes them again): `training/` with
image_2, velodyne (only points in the camera's view), calib, label_2, and dense true `depth`."""
