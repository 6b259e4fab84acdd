"""Calibration of a frame of KITTI's object benchmark, for a LiDAR that faces ahead."""

import sys
from pathlib import Path

import numpy as np

MOST_ASIDE_DEG = 5  # Sightline turns clouds of a LiDAR beyond it; the scripts here do not


def read_calibration(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Read calib/N.txt: P2, and the camera's frame from the LiDAR's, R0_rect @ Tr_velo_to_cam."""
    lines = [line.partition(":") for line in Path(path).read_text().splitlines()]
    values = {name: np.array(text.split(), np.float64) for name, _, text in lines}
    camera, rectification, mounting = values["P2"].reshape(3, 4), np.eye(4), np.eye(4)
    rectification[:3, :3] = values["R0_rect"].reshape(3, 3)
    mounting[:3] = values["Tr_velo_to_cam"].reshape(3, 4)
    mounting = rectification @ mounting
    aside_deg = np.degrees(np.arctan2(mounting[2, 1], mounting[2, 0]))
    if abs(aside_deg) > MOST_ASIDE_DEG:
        side = "left" if aside_deg > 0 else "right"
        sys.exit(
            f"{path}: the camera faces {abs(aside_deg):.1f} degrees to the {side} of the LiDAR's "
            f"x axis, expected up to {MOST_ASIDE_DEG}; turn the points by {-aside_deg:.1f} degrees "
            "about z, and multiply Tr_velo_to_cam by the inverse of that"
        )
    return camera, mounting
