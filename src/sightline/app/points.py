"""Sweeps packed for the page: eight bytes a point."""

import struct
from typing import Final

import numpy as np
from jaxtyping import Float32
from torch import Tensor

MAX_POINTS: Final = 400_000
"""Most points of a packed sweep; of more, every nth is kept."""
STEP_M: Final = 0.01
"""Smallest step of coordinates."""

_HEADER: Final = struct.Struct("<If")
_POINT: Final = np.dtype([("xyz", "<i2", 3), ("reflectance", "u1"), ("fault", "u1")])
_MOST_STEPS: Final = 32767


def pack_points(
    points: Float32[Tensor, "num_points 4"] | None,
    sound: Float32[Tensor, "num_sound 4"] | None = None,
) -> bytes:
    """Pack a sweep: the number of points, the step [m], then each point.

    A point is x, y, z in steps (int16), its reflectance times 255, and 1 if the sound sweep has
    another point, else 0. Points farther than 32,767 steps of 1 cm make the steps larger.

    Args:
        points: The sweep; None: the LiDAR delivered nothing.
        sound: The sweep of the sound sensor; None: no point counts as changed.
    """
    if points is None:
        return _HEADER.pack(0, STEP_M)
    rows = points.numpy()
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[:: -(-len(rows) // MAX_POINTS) or 1]
    farthest_m = float(np.abs(rows[:, :3]).max(initial=0.0))
    step_m = max(STEP_M, farthest_m / _MOST_STEPS)
    packed = np.zeros(len(rows), dtype=_POINT)
    packed["xyz"] = np.rint(rows[:, :3] / step_m).clip(-_MOST_STEPS, _MOST_STEPS)
    packed["reflectance"] = np.rint(255 * rows[:, 3].clip(0, 1))
    if sound is not None and sound is not points:
        packed["fault"] = ~np.isin(_as_single(rows), _as_single(sound.numpy()))
    return _HEADER.pack(len(rows), step_m) + packed.tobytes()


def _as_single(rows: Float32[np.ndarray, "num_rows 4"]) -> np.ndarray:
    """View each row as one value, for comparisons of whole rows."""
    return np.ascontiguousarray(rows).view(np.dtype((np.void, rows.dtype.itemsize * 4)))[:, 0]
