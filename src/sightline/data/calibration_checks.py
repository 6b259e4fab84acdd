"""Plausibility checks of calibrations of sensors on a vehicle."""

from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sightline.data.calibration_text import CalibrationMatrices
from sightline.files.problem import Problem
from sightline.geometry.mount import MAX_OFFSET_M, mount_doubt

_REMEDY = "correct it or extract the calibration archive again"


def check_matrices(
    matrices: CalibrationMatrices, size: tuple[int, int] | None, path: Path
) -> list[Problem]:
    """Find implausible values in a calibration of the object benchmark or a raw recording.

    Args:
        matrices: Matrices as read.
        size: Height and width of the image, if known.
        path: File or folder of the matrices.
    """
    intrinsics, column = np.hsplit(matrices.image_from_camera, [3])
    offset_m = float(np.linalg.norm(np.linalg.solve(intrinsics, column[:, 0])))
    doubts = []
    if offset_m > MAX_OFFSET_M:
        doubts.append(
            f"puts the camera {offset_m:.4g} m from the rectified origin, expected up to "
            f"{MAX_OFFSET_M:.0f} m"
        )
    mount = mount_doubt(matrices.camera_from_lidar)
    if mount is not None:
        doubts.append(f"holds a transform from LiDAR to camera that {mount}")
    return check_intrinsics(intrinsics, size, path) + _problems(doubts, path)


def check_intrinsics(
    intrinsics: Float64[np.ndarray, "3 3"], size: tuple[int, int] | None, path: Path
) -> list[Problem]:
    """Find implausible focal lengths and principal points; arguments as in `check_matrices`."""
    focal_px, principal_px = np.diag(intrinsics)[:2], intrinsics[:2, 2]
    doubts = []
    if (focal_px <= 0).any():
        x, y = focal_px
        doubts.append(f"has focal lengths of {x:.6g} and {y:.6g} px, expected both above 0")
    if size is not None:
        width_height = np.array(size[::-1])
        if (np.abs(focal_px) > 100 * width_height).any() or (100 * focal_px < width_height).any():
            doubts.append(
                f"has focal lengths of {focal_px[0]:.6g} and {focal_px[1]:.6g} px, which do not go "
                f"with an image of {size[0]}x{size[1]} (height x width)"
            )
        # The principal point of a cropped camera stays within a few image sizes.
        if (np.abs(principal_px - width_height / 2) > 3 * width_height).any():
            doubts.append(
                f"has its principal point at ({principal_px[0]:.6g}, {principal_px[1]:.6g}), far "
                f"from an image of {size[0]}x{size[1]} (height x width)"
            )
    return _problems(doubts[:1], path)


def _problems(doubts: list[str], path: Path) -> list[Problem]:
    return [Problem(path=path, problem=doubt, remedy=_REMEDY) for doubt in doubts]
