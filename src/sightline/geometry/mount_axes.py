"""Detection of clouds with other axes than x forward, y left, z up, by their road.

Without PyTorch.
"""

from collections.abc import Sequence

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
    problem = (
        f"has its road in the direction {_axis(-turn[2])}, so that {_axis(turn[2])} points up: "
        "expected x forward, y left, z up"
    )
    converted = f"points x, y, z become {', '.join(map(_axis, turn))}"
    rigid = _rigid(turn)
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


def turn_upright(
    clouds: Sequence[Float[np.ndarray, "_num_points fields"]],
    camera_from_lidar: Float64[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "4 4"]:
    """Find the turn by right angles after which z points up, by both the road and the camera.

    It is for LiDARs that are mounted upside down or on their side, with a calibration that says so.

    Args:
        clouds: Some clouds of a drive: x, y, z first [m].
        camera_from_lidar: Extrinsics of these points; the camera is upright.

    Returns:
        new_from_old; the identity if z points up already, or road and camera disagree.
    """
    if mount_doubt(camera_from_lidar) is not None:
        for turn in map(upright_turn, clouds):
            if turn is not None and mount_doubt(camera_from_lidar @ _rigid(turn).T) is None:
                return _rigid(turn)
    return np.eye(4)


def describe_upright_turn(new_from_old: Float64[np.ndarray, "4 4"]) -> tuple[str, ...]:
    """Describe the turn of clouds by `turn_upright` in a clause; empty: the identity."""
    turn = new_from_old[:3, :3]
    if (turn == np.eye(3)).all():
        return ()
    return (
        f"the LiDAR's {_axis(turn[2])} points up, by its calibration and the road: clouds are "
        f"written turned, points x, y, z become {', '.join(map(_axis, turn))}",
    )


def _rigid(turn: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "4 4"]:
    rigid = np.eye(4)
    rigid[:3, :3] = turn
    return rigid


def _axis(row: Float64[np.ndarray, "3"]) -> str:
    """Format the axis that a row of an axis rotation selects, with its sign."""
    place = int(np.abs(row).argmax())
    return f"{'-' if row[place] < 0 else ''}{_NAMES[place]}"
