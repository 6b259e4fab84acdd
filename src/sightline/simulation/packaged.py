"""The frames that come with the package, so that everything can be tried without a download."""

from pathlib import Path
from typing import Final

PACKAGED_FRAMES: Final = Path(__file__).with_name("frames")
"""KITTI object tree of two simulated frames (`make frames` makes them anew): `training/` with
image_2, velodyne (cut to what the camera sees), calib, label_2, and dense true `depth`."""
