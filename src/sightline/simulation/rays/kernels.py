"""Small functions of the compiled kernels: vectors, and hashed noise filtered to a pixel."""

import math
from typing import NamedTuple

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


_PER_X, _PER_Y, _PER_SEED = 374761393, 668265263, 974634821
_WOBBLE = 0.16  # wobble of cracks, in units of their noise
_SMALLEST_WIDTH = 1e-5  # metres; keeps divisions by the size of a pixel finite


class Spot(NamedTuple):
    """Footprint of one pixel on a textured surface."""

    u: float
    v: float  # position on the surface [m]
    width_u: float
    width_v: float  # extent of the pixel along either axis [m]
    seed: int  # seed that distinguishes surfaces of otherwise equal texture


@compiled
def hashed(x: int, y: int, seed: int) -> float:
    """Hash three integers to a number in [0, 1), without visible pattern."""
    return _stirred(x * _PER_X + y * _PER_Y + seed * _PER_SEED)


@compiled
def _stirred(key: int) -> float:
    bits = (key ^ (key >> 16)) & 0xFFFFFFFF
    bits = ((bits ^ (bits >> 15)) * 1597334677) & 0xFFFFFFFF
    return (bits ^ (bits >> 16)) * (1.0 / 4294967296.0)


@compiled
def value_noise(x: float, y: float, seed: int) -> float:
    """Compute smooth noise in [-1, 1]: hashed values at integer coordinates, cubic in between."""
    cell_x, cell_y = np.floor(x), np.floor(y)
    along_x, along_y = x - cell_x, y - cell_y
    along_x *= along_x * (3.0 - 2.0 * along_x)
    along_y *= along_y * (3.0 - 2.0 * along_y)
    key = int(cell_x) * _PER_X + int(cell_y) * _PER_Y + seed * _PER_SEED
    low = _stirred(key)
    low += (_stirred(key + _PER_X) - low) * along_x
    high = _stirred(key + _PER_Y)
    high += (_stirred(key + _PER_X + _PER_Y) - high) * along_x
    return float(2.0 * (low + (high - low) * along_y) - 1.0)


@compiled
def grain(spot: Spot, per_metre_u: float, per_metre_v: float, layer: int) -> float:
    """Compute noise in [-1, 1] of a given fineness, which fades if a pixel spans whole grains."""
    periods = max(spot.width_u * per_metre_u, spot.width_v * per_metre_v)
    if periods >= 1.6:
        return 0.0
    strength = min(1.0, 1.2 - 0.75 * periods)
    return strength * value_noise(spot.u * per_metre_u, spot.v * per_metre_v, spot.seed + layer)


@compiled
def speckle(spot: Spot, grain_m: float, layer: int) -> float:
    """Compute the remaining contrast in one pixel of countless grains of a size [m], in [-1, 1].

    The mean of n grains varies as 1 / sqrt(n). Its noise is as fine as the pixel, separately along
    each axis, so that a surface is not smooth at a grazing angle.
    """
    cell_u = _power_above(0.7 * spot.width_u, grain_m)
    cell_v = _power_above(0.7 * spot.width_v, grain_m)
    strength = math.sqrt(grain_m * grain_m / (cell_u * cell_v))
    return strength * value_noise(spot.u / cell_u, spot.v / cell_v, spot.seed + layer)


@compiled
def _power_above(width: float, smallest: float) -> float:
    """Compute the smallest power of two times `smallest` that is not below a width."""
    if width <= smallest:
        return smallest
    _, exponent = math.frexp(width / smallest)
    return smallest * math.ldexp(1.0, exponent)


@compiled
def clouded(spot: Spot, per_metre_u: float, per_metre_v: float, layer: int) -> float:
    """Sum three octaves of `grain`, each half as strong and twice as fine, in [-1, 1]."""
    total = grain(spot, per_metre_u, per_metre_v, layer)
    total += 0.5 * grain(spot, 2.0 * per_metre_u, 2.0 * per_metre_v, layer + 1)
    total += 0.25 * grain(spot, 4.0 * per_metre_u, 4.0 * per_metre_v, layer + 2)
    return total / 1.75


@compiled
def lines(position: float, width: float, period: float, thickness: float) -> float:
    """Compute a pixel's share, `width` wide, on lines that start at every multiple of `period`."""
    width = max(width, _SMALLEST_WIDTH)
    covered = _line_length(position + 0.5 * width, period, thickness)
    return (covered - _line_length(position - 0.5 * width, period, thickness)) / width


@compiled
def grid_lines(spot: Spot, period_u: float, period_v: float, thickness: float) -> float:
    """Compute the share of a pixel on the lines of a grid."""
    free_u = 1.0 - lines(spot.u, spot.width_u, period_u, thickness)
    return 1.0 - free_u * (1.0 - lines(spot.v, spot.width_v, period_v, thickness))


@compiled
def in_bond(spot: Spot, stone_u: float, stone_v: float) -> Spot:
    """Shift every other row of stones by half a stone."""
    row = np.floor(spot.v / stone_v)
    moved = spot.u + stone_u * (0.5 * row - np.floor(0.5 * row))
    return Spot(moved, spot.v, spot.width_u, spot.width_v, spot.seed)


@compiled
def off_center(position: float, period: float) -> float:
    """Compute the position within a tile, relative to its centre: -0.5 to 0.5."""
    return float(position / period - np.floor(position / period) - 0.5)


@compiled
def _line_length(position: float, period: float, thickness: float) -> float:
    """Compute the length on lines between 0 and a position."""
    whole = np.floor(position / period)
    return float(whole * thickness + min(position - whole * period, thickness))


@compiled
def crack(spot: Spot, per_metre: float, thickness: float, layer: int) -> float:
    """Compute the share of a pixel on meandering lines, about `thickness` [m] wide."""
    width = max(spot.width_u, spot.width_v)
    if width * per_metre > 1.0:
        return 0.0
    reach = 0.5 * (thickness + width)
    # Noise changes by about 2 per period; this converts its value to a distance.
    noise_reach = 2.0 * per_metre * reach
    noise = value_noise(spot.u * per_metre, spot.v * per_metre, spot.seed + layer)
    if abs(noise) > _WOBBLE + noise_reach:
        return 0.0
    finer = 5.0 * per_metre
    noise += _WOBBLE * value_noise(spot.u * finer, spot.v * finer, spot.seed + layer + 1)
    share = min(1.0, thickness / max(width, thickness))
    return share * max(0.0, 1.0 - abs(noise) / noise_reach)


@compiled
def per_tile(spot: Spot, tile_u: float, tile_v: float, layer: int) -> float:
    """Compute a number in [-1, 1] for the tile of the given size [m], which fades with distance."""
    tiles = max(spot.width_u / tile_u, spot.width_v / tile_v)
    if tiles >= 1.6:
        return 0.0
    value = hashed(
        int(np.floor(spot.u / tile_u)), int(np.floor(spot.v / tile_v)), spot.seed + layer
    )
    return (2.0 * value - 1.0) * min(1.0, 1.2 - 0.75 * tiles)
