"""Vectors of three numbers for the compiled kernels."""

import math

import numpy as np
from jaxtyping import Float32

from sightline.ops.compiled import compiled

Vector = tuple[float, float, float]


@compiled
def row_of(rows: Float32[np.ndarray, "n 3"], row: int) -> Vector:
    """Read a row of an array as three numbers."""
    # numba's float() keeps float32; the kernels work in float64.
    return np.float64(rows[row, 0]), np.float64(rows[row, 1]), np.float64(rows[row, 2])


@compiled
def store_row(rows: Float32[np.ndarray, "n 3"], row: int, vector: Vector) -> None:
    """Write a row of an array."""
    rows[row, 0], rows[row, 1], rows[row, 2] = vector


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Compute the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Compute the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def plus(a: Vector, b: Vector) -> Vector:
    """Compute the sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a: Vector, b: Vector) -> Vector:
    """Compute the difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def scaled(a: Vector, factor: float) -> Vector:
    """Compute the product with a number."""
    return a[0] * factor, a[1] * factor, a[2] * factor


@compiled
def weighted(weights: Vector, a: Vector, b: Vector, c: Vector) -> Vector:
    """Compute the weighted sum of three vectors."""
    return plus(plus(scaled(a, weights[0]), scaled(b, weights[1])), scaled(c, weights[2]))


@compiled
def normalized(a: Vector, otherwise: Vector) -> Vector:
    """Scale to unit length; `otherwise` if the length is zero."""
    squared = dot(a, a)
    if squared < 1e-16:
        return otherwise
    return scaled(a, 1.0 / math.sqrt(squared))


@compiled
def luminance(color: Vector) -> float:
    """Compute the brightness of linear RGB (Rec. 709)."""
    return 0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2]
