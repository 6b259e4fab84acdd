"""What the blocks of the embedded scenes look like to a camera and to a LiDAR."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int8

from sightline.simulation.block_rays import Block
from sightline.simulation.block_scene import CENTRE_LINE_Y, CROSSING_X, KERBS_Y

GLASS_REFLECTANCE = 0.04
"""The lowest of all surfaces."""

_GLASS = np.array([0.13, 0.17, 0.22], np.float32)
_LINE = np.array([0.64, 0.64, 0.62], np.float32)
_REFLECTANCE = {
    "plain": 0.40,
    "car": 0.45,
    "cabin": 0.40,
    "wheel": 0.08,
    "pavement": 0.34,
    "facade": 0.42,
    "roof": 0.25,
    "leaves": 0.36,
}
_ROAD_REFLECTANCE, _LINE_REFLECTANCE = 0.24, 0.62
_PLATE_REFLECTANCE = 0.97


class Paint(NamedTuple):
    """How a surface answers to light."""

    albedo: Float32[np.ndarray, "num_points 3"]
    """Share of red, green and blue thrown back."""
    reflectance: Float32[np.ndarray, " num_points"]
    """As the LiDAR reports it at a right angle, 0 to 1."""


class _Face(NamedTuple):
    """Where points lie on the faces of a block."""

    across: Float32[np.ndarray, " num_points"]
    """Along the face, from its middle [m]."""
    up: Float32[np.ndarray, " num_points"]
    """Above the block's bottom [m]."""
    is_end: Bool[np.ndarray, " num_points"]
    """On the front or the rear."""
    is_side: Bool[np.ndarray, " num_points"]
    is_top: Bool[np.ndarray, " num_points"]


def paint_ground(x: Float32[np.ndarray, " n"], y: Float32[np.ndarray, " n"]) -> Paint:
    """Asphalt with lane marks and a zebra crossing, in the LiDAR frame."""
    albedo = np.empty((len(x), 3), np.float32)
    patch = _noise(np.floor(x / 2.5), np.floor(y / 1.75))
    albedo[:] = np.array([0.30, 0.30, 0.31], np.float32) * (1 + 0.05 * patch[:, None])
    dashed = (np.abs(y - CENTRE_LINE_Y) < 0.07) & (x % 6 < 3)
    bays = np.minimum(np.abs(y - KERBS_Y[0] - 2.25), np.abs(y - KERBS_Y[1] + 2.25)) < 0.06
    in_road = (y > KERBS_Y[0] + 0.3) & (y < KERBS_Y[1] - 0.3)
    on_crossing = (x > CROSSING_X[0]) & (x < CROSSING_X[1]) & in_road
    marked = np.where(on_crossing, (y - KERBS_Y[0]) % 1.0 < 0.5, dashed | bays)
    albedo[marked] = _LINE
    return Paint(albedo, np.where(marked, _LINE_REFLECTANCE, _ROAD_REFLECTANCE).astype(np.float32))


def paint_block(
    block: Block, local: Float32[np.ndarray, "3 n"], faces: Int8[np.ndarray, " n"]
) -> Paint:
    """The block's surface at points of its own frame."""
    albedo = np.tile(np.array(block.color, np.float32), (local.shape[1], 1))
    reflectance = np.full(local.shape[1], _REFLECTANCE[block.surface], np.float32)
    paint = Paint(albedo, reflectance)
    on_side = (faces == 2) | (faces == 3)
    face = _Face(
        across=np.where(on_side, local[0], local[1]),
        up=local[2] + np.float32(block.size[2] / 2),
        is_end=faces < 2,
        is_side=on_side,
        is_top=faces == 4,
    )
    if block.surface == "facade":
        _paint_facade(block, face, paint)
    elif block.surface == "car":
        _paint_car(block, face, faces, paint)
    elif block.surface == "cabin":
        _paint_cabin(block, face, paint)
    elif block.surface == "wheel":
        hub = face.is_side & (np.hypot(face.across, face.up - block.size[2] / 2) < 0.17)
        albedo[hub] = (0.42, 0.43, 0.45)
    elif block.surface == "pavement":
        kerb = np.abs(local[1]) > block.size[1] / 2 - 0.16
        albedo[kerb] = (0.66, 0.65, 0.62)
        slab = _noise(np.floor(local[0]), np.floor(local[1]))
        albedo[:] *= 1 + 0.04 * slab[:, None] * ~kerb[:, None]
    elif block.surface == "leaves":
        tuft = _noise(*(np.floor(axis / 0.22) for axis in local))
        albedo[:] *= 1 + 0.25 * tuft[:, None]
    elif block.surface == "roof":
        albedo[:] *= np.where(face.up % 0.35 < 0.06, 0.8, 1.0)[:, None]
    return paint


def _paint_facade(block: Block, face: _Face, paint: Paint) -> None:
    length = np.where(face.is_side, block.size[0], block.size[1])
    bays = np.maximum(np.floor((length - 0.6) / 2.6), 1)
    bay = (face.across / length + 0.5) * bays % 1 * (length / bays) - length / bays / 2
    storey, above = np.floor(face.up / 3.2), face.up % 3.2
    regular = ~face.is_top & (face.up < block.size[2] - 1.0)
    frame = regular & (np.abs(bay) < 0.66) & (above > 0.9) & (above < 2.55)
    glass = regular & (np.abs(bay) < 0.55) & (above > 1.0) & (above < 2.45)
    bar = np.abs(bay) < 0.035
    paint.albedo[(storey == 0) & (face.up < 0.6)] *= 0.72
    paint.albedo[face.up > block.size[2] - 0.35] *= 0.82
    paint.albedo[frame] = (0.86, 0.85, 0.82)
    paint.albedo[glass & ~bar] = _GLASS
    paint.reflectance[glass & ~bar] = GLASS_REFLECTANCE


def _paint_car(block: Block, face: _Face, faces: Int8[np.ndarray, " n"], paint: Paint) -> None:
    height, half = block.size[2], block.size[1] / 2
    lamp = face.is_end & (np.abs(face.across) > 0.58 * half) & (np.abs(face.across) < 0.94 * half)
    lamp &= (face.up > 0.58 * height) & (face.up < 0.84 * height)
    paint.albedo[lamp & (faces == 0)] = (0.90, 0.90, 0.82)
    paint.albedo[lamp & (faces == 1)] = (0.62, 0.05, 0.05)
    paint.albedo[(face.up < 0.18) & ~face.is_top] *= 0.35
    plate = face.is_end & (np.abs(face.across) < 0.27) & (np.abs(face.up - 0.3) < 0.07)
    paint.albedo[plate] = (0.88, 0.88, 0.84)
    paint.reflectance[plate] = _PLATE_REFLECTANCE
    seam = face.is_side & (np.abs(np.abs(face.across + 0.2) - 0.55) < 0.012)
    paint.albedo[seam] *= 0.45


def _paint_cabin(block: Block, face: _Face, paint: Paint) -> None:
    half = np.where(face.is_side, block.size[0], block.size[1]) / 2
    glass = ~face.is_top & (face.up > 0.05) & (face.up < block.size[2] - 0.10)
    glass &= np.abs(face.across) < half - 0.09
    glass &= ~(face.is_side & (np.abs(face.across + 0.05) < 0.05))
    paint.albedo[glass] = _GLASS
    paint.reflectance[glass] = GLASS_REFLECTANCE


def _noise(*cells: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """A fixed number in [-1, 1] for each cell of a grid, without a random state."""
    key = np.zeros(len(cells[0]), np.int64)
    for cell, factor in zip(cells, (73_856_093, 19_349_663, 83_492_791), strict=False):
        key ^= cell.astype(np.int64) * factor
    return ((key ^ (key >> 13)) * 1_274_126_177 % 2048 / 1023.5 - 1).astype(np.float32)
