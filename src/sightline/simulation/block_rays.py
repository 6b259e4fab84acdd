"""Rays against upright blocks, in plain numpy: enough for the small embedded scenes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int8, Int16, Int64

_TOP = 4  # of the faces, see Hits

GROUND = -1
NOTHING = -2

Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Block:
    """A box that stands upright, with the looks of one surface.

    LiDAR frame, metres; yaw is counter-clockwise from above.
    """

    center: Vector
    size: Vector
    yaw: float
    surface: str
    """How it looks: a key of `block_surfaces.paint`."""
    color: Vector
    """Share of red, green and blue light that it throws back."""


class Hits(NamedTuple):
    """The first surface that each ray meets."""

    distances: Float32[np.ndarray, " num_rays"]
    """In lengths of the ray's direction; infinite where there is nothing."""
    blocks: Int16[np.ndarray, " num_rays"]
    """Index of the block, or GROUND, or NOTHING."""
    faces: Int8[np.ndarray, " num_rays"]
    """Face of the block: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z, in its own frame."""


class _Rays(NamedTuple):
    """Rays and the products of theirs that every culling test needs."""

    origins: Float32[np.ndarray, "3 #num_rays"]
    directions: Float32[np.ndarray, "3 #num_rays"]
    origin_by_origin: Float32[np.ndarray, " #num_rays"]
    origin_by_direction: Float32[np.ndarray, " #num_rays"]
    direction_by_direction: Float32[np.ndarray, " #num_rays"]
    lowest_direction: Float32[np.ndarray, "3"]
    highest_direction: Float32[np.ndarray, "3"]


def cast_rays(
    things: Sequence[Sequence[Block]],
    origins: Float32[np.ndarray, "3 #num_rays"],
    directions: Float32[np.ndarray, "3 #num_rays"],
    *,
    ground_z: float | None,
) -> Hits:
    """Follows rays to the nearest block or the ground; blocks are numbered through all things.

    Args:
        things: Blocks that stand together: rays that pass the sphere around them are spared.
        origins: One for all rays or one for each; what begins within a block does not see it.
        directions: Likewise; of any length.
        ground_z: Height of the ground plane; None leaves it out.
    """
    num_rays = directions.shape[1] if origins.shape[1] == 1 else origins.shape[1]
    distances = np.full(num_rays, np.inf, np.float32)
    blocks = np.full(num_rays, NOTHING, np.int16)
    faces = np.full(num_rays, _TOP, np.int8)
    if num_rays == 0:
        return Hits(distances, blocks, faces)
    rays = _Rays(
        origins,
        directions,
        (origins * origins).sum(axis=0),
        (origins * directions).sum(axis=0),
        (directions * directions).sum(axis=0),
        directions.min(axis=1),
        directions.max(axis=1),
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        if ground_z is not None:
            to_ground = np.broadcast_to((ground_z - origins[2]) / directions[2], (num_rays,))
            distances = np.where(to_ground > 0, to_ground, distances).astype(np.float32)
            blocks[to_ground > 0] = GROUND
        firsts = np.cumsum([0, *(len(thing) for thing in things)]).tolist()
        for thing, first in zip(things, firsts, strict=False):
            near = _passing_near(thing, rays)
            if len(near) == 0:
                continue
            some_origins = origins if origins.shape[1] == 1 else origins.take(near, axis=1)
            some = directions if directions.shape[1] == 1 else directions.take(near, axis=1)
            for number, block in enumerate(thing, start=first):
                entries = _enter(block, some_origins, some)
                entry = np.maximum(np.maximum(entries[0], entries[1]), entries[2])
                closer = np.flatnonzero(entry < distances[near])
                hit = near[closer]
                distances[hit] = entry[closer]
                faces[hit] = _met_faces(block, entries.take(closer, axis=1), some, closer)
                blocks[hit] = number
    return Hits(distances, blocks, faces)


def to_block_frame(
    block: Block, vectors: Float32[np.ndarray, "3 num_vectors"]
) -> Float32[np.ndarray, "3 num_vectors"]:
    """Turns vectors of the LiDAR frame by the block's heading, into its own."""
    if block.yaw == 0:
        return vectors
    cos, sin = np.float32(np.cos(block.yaw)), np.float32(np.sin(block.yaw))
    x, y, z = vectors
    return np.stack((cos * x + sin * y, cos * y - sin * x, z))


def _passing_near(thing: Sequence[Block], rays: _Rays) -> Int64[np.ndarray, " num_near"]:
    """Which rays come within the sphere around a thing."""
    centers = np.array([block.center for block in thing])
    reaches = np.array([np.linalg.norm(block.size) / 2 for block in thing])
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    # A little more, because the products below lose digits.
    radius = 1.01 * (np.linalg.norm(centers - middle, axis=1) + reaches).max() + 0.05
    center = middle.astype(np.float32)
    if rays.origins.shape[1] == 1:
        # Most of a scene lies behind a camera: no ray of its goes there.
        ahead = center - rays.origins[:, 0]
        farthest = np.maximum(ahead * rays.lowest_direction, ahead * rays.highest_direction)
        if farthest.sum() < 0 and ahead @ ahead > radius**2:
            return np.zeros(0, np.int64)
    along = _dot(center, rays.directions) - rays.origin_by_direction
    distance2 = rays.origin_by_origin - 2 * _dot(center, rays.origins) + center @ center
    outside2 = distance2 - np.float32(radius**2)
    passing = along * along >= outside2 * rays.direction_by_direction
    return np.flatnonzero(passing & ((along > 0) | (outside2 < 0)))


def _dot(
    vector: Float32[np.ndarray, "3"], vectors: Float32[np.ndarray, "3 num_vectors"]
) -> Float32[np.ndarray, " num_vectors"]:
    # Not `@`: what BLAS answers depends on the machine and on its number of threads.
    product: Float32[np.ndarray, " num_vectors"]
    product = vector[0] * vectors[0] + vector[1] * vectors[1] + vector[2] * vectors[2]
    return product


def _enter(
    block: Block,
    origins: Float32[np.ndarray, "3 #num_rays"],
    directions: Float32[np.ndarray, "3 #num_rays"],
) -> Float32[np.ndarray, "3 num_rays"]:
    """Distances at which rays pass the near plane of each axis; all infinite if they miss.

    The slab method of Kay and Kajiya 1986: a ray is inside where it is between all pairs of faces.
    """
    half = np.array(block.size, np.float32) / 2
    starts = to_block_frame(block, origins - np.array(block.center, np.float32)[:, None])
    steps = to_block_frame(block, directions)
    num_rays = max(origins.shape[1], directions.shape[1])
    entries = np.empty((3, num_rays), np.float32)
    leave = np.full(num_rays, np.inf, np.float32)
    for axis in range(3):
        inverse = 1 / steps[axis]
        first = (-half[axis] - starts[axis]) * inverse
        second = (half[axis] - starts[axis]) * inverse
        entries[axis] = np.minimum(first, second)
        leave = np.minimum(leave, np.maximum(first, second))
    entry = np.maximum(np.maximum(entries[0], entries[1]), entries[2])
    entries[:, ~((entry < leave) & (entry > 0))] = np.inf  # NaN, too: along a face
    return entries


def _met_faces(
    block: Block,
    entries: Float32[np.ndarray, "3 num_hits"],
    directions: Float32[np.ndarray, "3 #num_rays"],
    hits: Int64[np.ndarray, " num_hits"],
) -> Int8[np.ndarray, " num_hits"]:
    """The face through which each ray comes in: that of the plane it passes last."""
    axis = entries.argmax(axis=0)
    some = directions if directions.shape[1] == 1 else directions.take(hits, axis=1)
    steps = np.broadcast_to(to_block_frame(block, some), entries.shape)
    forwards = np.take_along_axis(steps, axis[None], axis=0)[0] > 0
    faces: Int8[np.ndarray, " num_hits"] = (2 * axis + forwards).astype(np.int8)
    return faces
