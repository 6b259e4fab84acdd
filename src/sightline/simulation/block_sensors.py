"""A camera and a spinning LiDAR that look at scenes of blocks."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from sightline.simulation.block_rays import (
    GROUND,
    NOTHING,
    Block,
    Hits,
    cast_rays,
    to_block_frame,
)
from sightline.simulation.block_scene import GROUND_Z, Thing
from sightline.simulation.block_surfaces import (
    GLASS_REFLECTANCE,
    Paint,
    paint_block,
    paint_ground,
)

LIDAR_RANGE_M = 80.0
_RANGE_NOISE_M = 0.02
_DROP_OUT = 0.04
_GLASS_ECHOES = 0.3  # glass lets most of the light through
# Lasers of an HDL-64E from the top: an upper half that stands closer together than the lower.
_ELEVATIONS_DEG = np.concatenate((np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.8, 32)))
_AZIMUTH_STEP_DEG = 0.1728

_TO_SUN = np.array([-0.62, 0.36, 0.70], np.float32)  # behind the camera, on its left, high
_SUNLIGHT = np.array([0.98, 0.92, 0.80], np.float32)
_SKYLIGHT = np.array([0.52, 0.58, 0.68], np.float32)
_HORIZON = np.array([0.80, 0.86, 0.92], np.float32)
_ZENITH = np.array([0.36, 0.56, 0.84], np.float32)
_HAZE_M = 450.0
_GAMMA = 1 / 1.35
_EDGE_CONTRAST = 24  # of 255: pixels that differ so much from a neighbour are sampled finer
_FINE_SAMPLES = ((-0.34, 0.22), (0.34, -0.22))  # besides the one in the pixel's centre


class CameraView(NamedTuple):
    """What the camera sees, pixel by pixel (row by row in `hits`)."""

    image: UInt8[np.ndarray, "height width 3"]
    hits: Hits
    """Distances are depths [m] along the optical axis."""


class _Met(NamedTuple):
    """The surfaces that rays met, for those that met any."""

    rays: Bool[np.ndarray, " num_rays"]
    points: Float32[np.ndarray, "3 num_met"]
    normals: Float32[np.ndarray, "3 num_met"]
    paint: Paint


def camera_rays(
    image_from_lidar: Float64[np.ndarray, "3 4"], pixels: Float64[np.ndarray, "2 num_pixels"]
) -> tuple[Float32[np.ndarray, "3 1"], Float32[np.ndarray, "3 num_pixels"]]:
    """Origin and directions in the LiDAR frame; a length of 1 along a ray is 1 m of depth."""
    lidar_from_ray = np.linalg.inv(image_from_lidar[:, :3])
    origin = -lidar_from_ray @ image_from_lidar[:, 3:]
    directions = lidar_from_ray @ np.concatenate((pixels, np.ones_like(pixels[:1])))
    return origin.astype(np.float32), directions.astype(np.float32)


def pixel_grid(image_size: tuple[int, int]) -> Float64[np.ndarray, "2 num_pixels"]:
    """Centres (x, y) of all pixels of an image of (height, width), row by row."""
    rows, columns = np.indices(image_size, dtype=np.float64)
    return np.stack((columns.ravel(), rows.ravel()))


def take_image(
    things: Sequence[Thing],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int],
) -> CameraView:
    """Renders in daylight; one sample for a pixel, three where an edge runs through it."""
    pixels = pixel_grid(image_size)
    origin, directions = camera_rays(image_from_lidar, pixels)
    hits = _cast(things, origin, directions)
    image = _light(things, origin, directions, hits).reshape(*image_size, 3)
    edges = _edges(image).ravel()
    fine = image.reshape(-1, 3)[edges]
    for shift in _FINE_SAMPLES:
        origin, directions = camera_rays(image_from_lidar, pixels[:, edges] + np.array([shift]).T)
        fine += _light(things, origin, directions, _cast(things, origin, directions))
    image.reshape(-1, 3)[edges] = fine / (1 + len(_FINE_SAMPLES))
    return CameraView(np.rint(255 * image).astype(np.uint8), hits)


def take_sweep(
    things: Sequence[Thing], rng: np.random.Generator
) -> Float32[np.ndarray, "num_points 4"]:
    """A whole turn of a 64-beam LiDAR: x, y, z [m], reflectance, in the order of KITTI's files.

    Ring by ring from the top, each from straight ahead counter-clockwise. Echoes have noise along
    the ray and are lost by chance, more often the weaker they are: dark, slanted or far surfaces.
    """
    azimuths = np.deg2rad(np.arange(_AZIMUTH_STEP_DEG / 2, 360, _AZIMUTH_STEP_DEG))
    elevation, azimuth = np.meshgrid(np.deg2rad(_ELEVATIONS_DEG), azimuths, indexing="ij")
    directions = np.stack(
        (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        )
    )
    directions = directions.reshape(3, -1).astype(np.float32)
    origin = np.zeros((3, 1), np.float32)
    hits = _cast(things, origin, directions)
    met = _meet(things, origin, directions, hits)
    directions, ranges = directions[:, met.rays], hits.distances[met.rays]
    slant = np.abs((directions * met.normals).sum(axis=0))
    echo = met.paint.reflectance * (0.15 + slant) / (ranges / 40) ** 2
    chance = (1 - _DROP_OUT) * np.minimum(echo / 0.05, 1)
    chance *= np.where(met.paint.reflectance <= GLASS_REFLECTANCE, _GLASS_ECHOES, 1)
    kept = (rng.random(len(ranges)) < chance) & (ranges < LIDAR_RANGE_M)
    noisy = ranges + rng.normal(0, _RANGE_NOISE_M, len(ranges))
    reflectance = met.paint.reflectance * (0.6 + 0.4 * slant) + rng.normal(0, 0.02, len(ranges))
    points = np.concatenate(
        (
            np.round(directions * noisy, 3),
            np.round(np.clip(reflectance, 0, 0.99), 2)[None],
        )
    )
    return np.ascontiguousarray(points.T[kept], np.float32)


def _cast(
    things: Sequence[Thing],
    origins: Float32[np.ndarray, "3 #num_rays"],
    directions: Float32[np.ndarray, "3 #num_rays"],
) -> Hits:
    return cast_rays([thing.blocks for thing in things], origins, directions, ground_z=GROUND_Z)


def _meet(
    things: Sequence[Thing],
    origin: Float32[np.ndarray, "3 1"],
    directions: Float32[np.ndarray, "3 num_rays"],
    hits: Hits,
) -> _Met:
    rays = hits.blocks != NOTHING
    points = origin + hits.distances[rays] * directions[:, rays]
    numbers, faces = hits.blocks[rays], hits.faces[rays]
    normals = np.zeros_like(points)
    albedo = np.zeros((points.shape[1], 3), np.float32)
    reflectance = np.zeros(points.shape[1], np.float32)
    blocks = [block for thing in things for block in thing.blocks]
    order = np.argsort(numbers, kind="stable")
    starts = np.flatnonzero(np.diff(numbers[order], prepend=NOTHING))
    for some in np.split(order, starts[1:]):
        number = int(numbers[some[0]]) if len(some) else GROUND
        if number == GROUND:
            normals[2, some] = 1
            paint = paint_ground(points[0, some], points[1, some])
        else:
            normals[:, some] = _normals(blocks[number])[:, faces[some]]
            paint = paint_block(
                blocks[number], _local(blocks[number], points[:, some]), faces[some]
            )
        albedo[some], reflectance[some] = paint
    return _Met(rays, points, normals, Paint(albedo, reflectance))


def _local(
    block: Block, points: Float32[np.ndarray, "3 num_points"]
) -> Float32[np.ndarray, "3 num_points"]:
    return to_block_frame(block, points - np.array(block.center, np.float32)[:, None])


def _normals(block: Block) -> Float32[np.ndarray, "3 6"]:
    """Outward normals of the faces, in their order."""
    axes = to_block_frame(block, np.eye(3, dtype=np.float32))
    return np.stack((axes, -axes), axis=1).reshape(6, 3).T


def _light(
    things: Sequence[Thing],
    origin: Float32[np.ndarray, "3 1"],
    directions: Float32[np.ndarray, "3 num_rays"],
    hits: Hits,
) -> Float32[np.ndarray, "num_rays 3"]:
    """The colour that comes along each ray, 0 to 1."""
    height = directions[2] / np.linalg.norm(directions, axis=0)
    share = np.clip(height / 0.45, 0, 1)[:, None] ** 0.7
    colors: Float32[np.ndarray, "num_rays 3"] = _HORIZON + share * (_ZENITH - _HORIZON)
    met = _meet(things, origin, directions, hits)
    towards = (met.normals * _TO_SUN[:, None]).sum(axis=0)
    lit = np.zeros(len(towards), bool)
    facing = towards > 0
    # Start a little off the surface, or it would shade itself.
    starts = (met.points + 0.003 * met.normals)[:, facing]
    to_sun = cast_rays([thing.blocks for thing in things], starts, _TO_SUN[:, None], ground_z=None)
    lit[facing] = to_sun.blocks == NOTHING
    sun = np.where(lit, towards, 0.0)[:, None] * _SUNLIGHT
    openness = 0.72 + 0.28 * met.normals[2]  # walls and undersides see less of the sky
    above = np.clip((met.points[2] - GROUND_Z) / 1.2, 0, 1)
    openness *= np.where(met.normals[2] > 0.5, 1.0, 0.72 + 0.28 * above)
    surface = met.paint.albedo * (sun + openness[:, None] * _SKYLIGHT)
    haze = (1 - np.exp(-hits.distances[met.rays] / _HAZE_M))[:, None]
    colors[met.rays] = np.clip(surface, 0, 1) ** _GAMMA * (1 - haze) + haze * _HORIZON
    return colors


def _edges(image: Float32[np.ndarray, "height width 3"]) -> Bool[np.ndarray, "height width"]:
    """Pixels that differ from a neighbour."""
    edges = np.zeros(image.shape[:2], bool)
    rows = np.abs(np.diff(image, axis=0)).max(axis=2) > _EDGE_CONTRAST / 255
    columns = np.abs(np.diff(image, axis=1)).max(axis=2) > _EDGE_CONTRAST / 255
    edges[1:] |= rows
    edges[:-1] |= rows
    edges[:, 1:] |= columns
    edges[:, :-1] |= columns
    return edges
