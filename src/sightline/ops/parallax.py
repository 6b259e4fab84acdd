"""Parallax between a LiDAR and a camera: points hidden from the camera behind an edge."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64
from numpy import ndarray

from sightline.geometry.calibration import Calibration
from sightline.ops.compiled import compiled

_RATIO = 1.15  # smallest depth ratio of a hidden return to the one that hides it
_SLACK_ROWS, _SLACK_COLUMNS = 3.0, 2.0  # shift of an edge by rounding and sampling [px]
_MIN_SHIFT_PX = 1.0  # smaller shifts hide returns only by rounding
_BEHIND_ROWS, _BEHIND_COLUMNS = 7.0, 4.0  # search range beyond a return for the hiding surface


@dataclass(frozen=True, kw_only=True, slots=True)
class Parallax:
    """Image offset between two points of one LiDAR ray, by their inverse depths.

    For a point in pixel p at depth z, a nearer point of the same LiDAR ray at depth y is in pixel p
    + (1 / y - 1 / z) (base + growth p) / (1 + growth / z): radial about the LiDAR's place in the
    image.
    """

    base_px_m: tuple[float, float]
    """Base of the offset: x, y."""
    growth_m: float
    """Distance of the LiDAR behind the camera."""

    @classmethod
    def from_calibration(cls, calibration: Calibration) -> "Parallax":
        """Compute the parallax of a calibration."""
        image_from_camera = calibration.image_from_camera.numpy()
        intrinsics = image_from_camera[:, :3]
        origin = calibration.camera_from_lidar.numpy()[:3, 3]
        # The last column of a projection is the offset of its own centre from the frame's.
        x, y, z = (intrinsics @ origin + image_from_camera[:, 3]).tolist()
        return cls(base_px_m=(x, y), growth_m=-z)


def hidden_by_parallax(
    sweep_m: Float32[ndarray, "height width"],
    pixels: Int64[ndarray, "n 2"],
    depths_m: Float32[ndarray, " n"],
    parallax: Parallax,
) -> Bool[ndarray, " n"]:
    """Find the returns that an edge hides from the camera but not from the LiDAR.

    The hiding surface covers a return's pixel and ends before the place where it would meet the
    return's own LiDAR ray. So a nearer return must lie on the way there, within 3 rows and 2
    columns, and another on the other side, within 7 rows and 4 columns: the sweep samples a surface
    a few rows apart. Where the way is shorter than a pixel, nothing is hidden. On simulated streets
    with ground truth, this finds 57 % of such returns and has 0.6 % false positives among other
    returns (2.3 % beyond 40 m); a window of 15 rows and 7 columns finds 85 % with 4 % false
    positives (23 %).

    Args:
        sweep_m: Sparse depth map of all returns that may hide one; 0 = none.
        pixels: Rows and columns of the returns to judge.
        depths_m: Depths of these returns.
        parallax: Parallax between the sweep's LiDAR and the map's camera.
    """
    inverse_depth = np.zeros_like(sweep_m)
    np.divide(1, sweep_m, out=inverse_depth, where=sweep_m > 0)
    own = 1 / depths_m
    nearest = float(inverse_depth.max(initial=0))
    return _hidden(inverse_depth, pixels, own, nearest, *parallax.base_px_m, parallax.growth_m)


@compiled
def _hidden(
    inverse_depth: Float32[ndarray, "height width"],
    pixels: Int64[ndarray, "n 2"],
    own_inverse_depth: Float32[ndarray, " n"],
    nearest: float,
    base_x: float,
    base_y: float,
    growth: float,
) -> Bool[ndarray, " n"]:
    height, width = inverse_depth.shape
    hidden = np.zeros(len(pixels), dtype=np.bool_)
    for i in range(len(pixels)):
        row, column = pixels[i]
        own = own_inverse_depth[i]
        max_nearness = max(nearest - own, 0.0)
        scale = 1 + growth * own
        shift_x, shift_y = (base_x + growth * column) / scale, (base_y + growth * row) / scale
        top = int(max(row - max(_BEHIND_ROWS, _SLACK_ROWS - min(shift_y, 0.0) * max_nearness), 0))
        bottom = int(
            min(
                row + max(_BEHIND_ROWS, _SLACK_ROWS + max(shift_y, 0.0) * max_nearness),
                height - 1,
            )
        )
        left = int(
            max(
                column - max(_BEHIND_COLUMNS, _SLACK_COLUMNS - min(shift_x, 0.0) * max_nearness),
                0,
            )
        )
        right = int(
            min(
                column + max(_BEHIND_COLUMNS, _SLACK_COLUMNS + max(shift_x, 0.0) * max_nearness),
                width - 1,
            )
        )
        ahead, behind = False, False
        for at_row in range(top, bottom + 1):
            for at_column in range(left, right + 1):
                value = inverse_depth[at_row, at_column]
                if value <= _RATIO * own:
                    continue
                off_x, off_y = at_column - column, at_row - row
                move_x, move_y = shift_x * (value - own), shift_y * (value - own)
                along = off_x * move_x + off_y * move_y
                if (
                    along >= 0
                    and move_x**2 + move_y**2 >= _MIN_SHIFT_PX**2
                    and min(move_x, 0.0) - _SLACK_COLUMNS <= off_x
                    and off_x <= max(move_x, 0.0) + _SLACK_COLUMNS
                    and min(move_y, 0.0) - _SLACK_ROWS <= off_y
                    and off_y <= max(move_y, 0.0) + _SLACK_ROWS
                ):
                    ahead = True
                if along <= 0 and abs(off_x) <= _BEHIND_COLUMNS and abs(off_y) <= _BEHIND_ROWS:
                    behind = True
            if ahead and behind:
                break
        hidden[i] = ahead and behind
    return hidden
