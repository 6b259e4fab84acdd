"""Check of rotation matrices. Without PyTorch, for checks that start at once."""

from typing import Final

import numpy as np
from jaxtyping import Float64

ROTATION_TOLERANCE: Final = 1e-3
"""Largest difference of a rotation times its transpose from the identity, by entry."""


def rotation_fault(matrix: Float64[np.ndarray, "3 3"]) -> str | None:
    """Describe why a matrix is no rotation, in a clause about it; None if it is one."""
    error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    determinant = np.linalg.det(matrix)
    if error <= ROTATION_TOLERANCE and determinant > 0:
        return None
    if error <= ROTATION_TOLERANCE:
        return (
            "its determinant is -1, expected 1: it mirrors, as from a left-handed frame (x "
            "forward, y right, z up); negate y in the points and the y column here"
        )
    return (
        f"its rows are {error:.3g} off orthonormal and its determinant is {determinant:.3g}, "
        "expected 0 and 1"
    )
