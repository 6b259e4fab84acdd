"""Coordinate frames: chains of transforms between sensors."""

from collections import deque
from collections.abc import Collection, Mapping
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

Rigid = Float64[np.ndarray, "4 4"]

_LENGTH_TOLERANCE: Final = 0.05  # rounding error of quaternions with two digits
_MAX_TRANSLATION_M: Final = 1e9


def rigid_from_quaternion(
    quaternion_xyzw: Float64[np.ndarray, "4"], translation: Float64[np.ndarray, "3"]
) -> Rigid:
    """4x4 matrix of a rotation by a quaternion, then a translation [m].

    Raises:
        ValueError: A number is not finite or implausibly large, or the quaternion's length is not
            1; the message continues a sentence that begins with the transform.
    """
    rigid = np.eye(4)
    if not (np.isfinite(quaternion_xyzw).all() and np.isfinite(translation).all()):
        raise ValueError("holds NaN or infinite values; calibrate again")
    length = float(np.linalg.norm(quaternion_xyzw))
    if not length:
        raise ValueError("has the quaternion 0 0 0 0, which is no rotation; calibrate again")
    if abs(length - 1) > _LENGTH_TOLERANCE:
        raise ValueError(f"has a quaternion of length {length:.4g}, expected 1; calibrate again")
    if np.abs(translation).max() > _MAX_TRANSLATION_M:
        raise ValueError(
            f"has a translation of more than {_MAX_TRANSLATION_M:g} m; calibrate again"
        )
    rigid[:3, :3] = Rotation.from_quat(quaternion_xyzw).as_matrix()
    rigid[:3, 3] = translation
    return rigid


def find_transform(
    parent_from_child: Mapping[tuple[str, str], Rigid], target: str, source: str
) -> Rigid | None:
    """Compute target_from_source along the shortest chain of transforms; None: there is no chain.

    Args:
        parent_from_child: Transforms by (parent, child).
        target: Name of a frame.
        source: Name of a frame.
    """
    chain = find_chain(parent_from_child, target, source)
    if chain is None:
        return None
    target_from_source = np.eye(4)
    for previous, frame in pairwise(chain):
        frame_from_previous = parent_from_child.get((frame, previous))
        if frame_from_previous is None:
            frame_from_previous = np.linalg.inv(parent_from_child[previous, frame])
        target_from_source = frame_from_previous @ target_from_source
    return target_from_source


def find_chain(pairs: Collection[tuple[str, str]], target: str, source: str) -> list[str] | None:
    """Find the frames on the shortest chain from source to target; None: there is no chain.

    Args:
        pairs: (parent, child) of each known transform.
        target: Name of a frame.
        source: Name of a frame.
    """
    neighbours: dict[str, dict[str, None]] = {}
    for parent, child in pairs:
        neighbours.setdefault(child, {})[parent] = None
        neighbours.setdefault(parent, {})[child] = None
    predecessor = {source: source}
    queue = deque([source])
    while queue and target not in predecessor:
        at = queue.popleft()
        for frame in neighbours.get(at, {}):
            if frame not in predecessor:
                predecessor[frame] = at
                queue.append(frame)
    if target not in predecessor:
        return None
    chain = [target]
    while chain[-1] != source:
        chain.append(predecessor[chain[-1]])
    return chain[::-1]
