"""Coordinate frames: chains of transforms between sensors."""

from collections import deque
from collections.abc import Mapping
from typing import Final

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

Rigid = Float64[np.ndarray, "4 4"]

_ROUNDING: Final = 0.05  # of a quaternion that was written with two digits
_FARTHEST_M: Final = 1e9


def rigid_from_quaternion(
    quaternion_xyzw: Float64[np.ndarray, "4"], translation: Float64[np.ndarray, "3"]
) -> Rigid:
    """The 4x4 matrix that rotates by a quaternion, then moves [m].

    Raises:
        ValueError: A number is not finite or absurdly large, or the quaternion's length is not 1;
            the rest of a sentence that begins with the transform.
    """
    rigid = np.eye(4)
    if not (np.isfinite(quaternion_xyzw).all() and np.isfinite(translation).all()):
        raise ValueError("holds NaN or infinite values; calibrate again")
    length = float(np.linalg.norm(quaternion_xyzw))
    if not length:
        raise ValueError("has the quaternion 0 0 0 0, which is no rotation; calibrate again")
    if abs(length - 1) > _ROUNDING:
        raise ValueError(f"has a quaternion of length {length:.4g}, expected 1; calibrate again")
    if np.abs(translation).max() > _FARTHEST_M:
        raise ValueError(f"moves by more than {_FARTHEST_M:g} m; calibrate again")
    rigid[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    rigid[:3, 3] = translation
    return rigid


def find_transform(
    parent_from_child: Mapping[tuple[str, str], Rigid], target: str, source: str
) -> Rigid | None:
    """target_from_source along the fewest known transforms; None where no way leads there.

    Args:
        parent_from_child: Transforms by (parent, child).
        target: Name of a frame.
        source: Name of a frame.
    """
    steps: dict[str, dict[str, Rigid]] = {}
    for (parent, child), rigid in parent_from_child.items():
        steps.setdefault(child, {})[parent] = rigid
        steps.setdefault(parent, {})[child] = np.linalg.inv(rigid)
    reached = {source: np.eye(4)}
    waiting = deque([source])
    while waiting and target not in reached:
        at = waiting.popleft()
        for frame, frame_from_at in steps.get(at, {}).items():
            if frame not in reached:
                reached[frame] = frame_from_at @ reached[at]
                waiting.append(frame)
    return reached.get(target)
