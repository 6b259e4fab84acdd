"""Detection of clouds with other axes than x forward, y left, z up, by their road.

Without PyTorch.
"""

import numpy as np
from jaxtyping import Float, Float64

from sightline.geometry.mount import mount_doubt
from sightline.geometry.road_height import upright_turn

_NAMES = ("x", "y", "z")


def axes_doubt(
    points: Float[np.ndarray, "num_points fields"], camera_from_lidar: Float64[np.ndarray, "4 4"]
) -> tuple[str, str] | None:
    """Find the fault of a cloud whose z axis does not point up, and its conversion.

    The remedy converts the cloud alone, or the calibration too. Mirrored clouds (y right with z up)
    are not detected.

    Args:
        points: x, y, z first [m].
        camera_from_lidar: Given extrinsics of these points.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None if the road lies below, or none
        is visible.
    """
    turn = upright_turn(points)
    if turn is None:
        return None
    up = _axis(turn[2])
    problem = (
        f"has its road in the direction {_axis(-turn[2])}, so that {up} points up: expected x "
        "forward, y left, z up"
    )
    converted = f"points x, y, z become {', '.join(map(_axis, turn))}"
    rigid = np.eye(4)
    rigid[:3, :3] = turn
    fits_after_turn = mount_doubt(camera_from_lidar @ rigid.T) is None
    if not fits_after_turn and mount_doubt(camera_from_lidar) is None:
        return problem, (
            f"convert only the points ({converted}): camera_from_lidar already has z up"
        )
    rows = np.round(rigid.T).astype(int).tolist()
    return problem, (
        f"convert both, points and camera_from_lidar: {converted}, and camera_from_lidar is "
        f"multiplied by the inverse, camera_from_lidar @ {rows}; converting only one turns the "
        "scene over"
    )


def _axis(row: Float64[np.ndarray, "3"]) -> str:
    """Format the axis that a row of an axis rotation selects, with its sign."""
    place = int(np.abs(row).argmax())
    return f"{'-' if row[place] < 0 else ''}{_NAMES[place]}"
