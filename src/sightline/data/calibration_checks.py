"""Plausibility checks of calibrations of sensors on a vehicle."""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.calibration_text import CalibrationMatrices
from sightline.files.problem import Problem
from sightline.geometry.mount import (
    MAX_OFFSET_M,
    focal_fault,
    mount_doubt,
    resolution_doubt,
    stretch_doubt,
)

_MAX_SKEW_SHARE: Final = 0.01
"""Largest share of the focal length; KITTI has 0, and this moves no pixel of it by over 2 px."""
_MIN_CENTRE_SHARES: Final = (0.3, 0.2)
"""Smallest shares of width and height from an edge to the principal point; KITTI's have 0.48 and
0.46, nuScenes' 0.48 and 0.42, KITTI's depth benchmark, cropped at the top, 0.49 and 0.42."""
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
            f"has a camera {offset_m:.4g} m from the rectified origin, expected at most "
            f"{MAX_OFFSET_M:.0f} m"
        )
    mount = mount_doubt(matrices.camera_from_lidar)
    if mount is not None:
        doubts.append(f"holds a transform from LiDAR to camera that {mount}")
    found = check_intrinsics(intrinsics, size, path)
    resolution = None if size is None else resolution_doubt(matrices.image_from_camera, size)
    if resolution is not None and not found:
        doubts.append(f"holds a camera matrix that {resolution}")
    return found + _problems(doubts, path)


def check_intrinsics(
    intrinsics: Float64[np.ndarray, "3 3"], size: tuple[int, int] | None, path: Path
) -> list[Problem]:
    """Find implausible focal lengths and principal points; arguments as in `check_matrices`."""
    focal_px, principal_px = np.diag(intrinsics)[:2], intrinsics[:2, 2]
    doubts = []
    doubt = focal_fault(intrinsics) or stretch_doubt(intrinsics)
    if doubt:
        doubts.append(doubt)
    skews_px = intrinsics[(0, 1), (1, 0)]
    if (np.abs(skews_px) > _MAX_SKEW_SHARE * np.abs(focal_px)).any():
        doubts.append(
            f"has skewed pixel axes ({skews_px[0]:.6g} and {skews_px[1]:.6g} px), expected 0 for a "
            "rectified camera"
        )
    if size is not None:
        width_height = np.array(size[::-1])
        if (np.abs(focal_px) > 100 * width_height).any() or (100 * focal_px < width_height).any():
            doubts.append(
                f"has focal lengths of {focal_px[0]:.6g} and {focal_px[1]:.6g} px, which do not "
                f"fit an image of {size[0]}x{size[1]} (height x width)"
            )
        # The principal point of a cropped camera stays within a few image sizes.
        if (np.abs(principal_px - width_height / 2) > 3 * width_height).any():
            doubts.append(
                f"has its principal point at ({principal_px[0]:.6g}, {principal_px[1]:.6g}), far "
                f"from an image of {size[0]}x{size[1]} (height x width)"
            )
        shares = principal_px / width_height
        is_off_centre = (np.minimum(shares, 1 - shares) < _MIN_CENTRE_SHARES).any()
        if is_off_centre and resolution_doubt(intrinsics, size) is None:
            doubts.append(
                f"has its principal point at ({principal_px[0]:.6g}, {principal_px[1]:.6g}), away "
                f"from the centre of an image of {size[0]}x{size[1]} (height x width), probably "
                "because images were resized or cropped without it"
            )
    return _problems(doubts[:1], path)


def _problems(doubts: list[str], path: Path) -> list[Problem]:
    return [Problem(path=path, problem=doubt, remedy=_REMEDY) for doubt in doubts]
