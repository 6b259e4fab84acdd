"""Camera viewpoint, and the rays that sample its pixels and their edges."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.pixels import unproject_pixels
from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayRows, RayValues, Vector3
from sightline.simulation.camera.shading import SUN_QUARTERS, LitWorld
from sightline.simulation.rays.kernels import Vector, dot, minus, plus, row_of, scaled
from sightline.simulation.rays.raycast import Hits
from sightline.simulation.rays.surfaces import MeshTables, Rays, cast_through_foliage, face_normal
from sightline.simulation.scene import Material, Pose, world_from_footprint

LEVEL_CAMERA_AXES: Final = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Rotation from a level LiDAR (x forward, y left, z up) to a level camera that looks ahead."""
_LEAF: Final = int(Material.LEAF)
_BEND: Final = 1.5e-3
"""Relative change of slope of 1 / depth over three pixels above which there is an edge.

The inverse depth of a plane is linear over the image, so only bends and steps change its slope.
"""
_COLOR_STEP: Final = 0.04
_SAME_CROWN_M: Final = 0.5
_SAME_DIRECTION: Final = 0.9  # minimum cosine between the normals of one surface
_SAME_PLANE: Final = 0.004
"""Maximum distance of a point from a plane that contains it, as a share of the depth."""


@compiled
def edge_pixels(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    faces: Int32[np.ndarray, "height width"],
    depths: Float32[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Mark pixels at edges, where a neighbour may show something else.

    `depths` are those of the hits along the optical axis.
    """
    height, width = faces.shape
    is_edge = np.zeros((height, width), np.bool_)
    for row in range(height):
        for column in range(width):
            face, depth = faces[row, column], depths[row, column]
            for down in range(2):
                next_row, next_column = row + down, column + 1 - down
                if next_row >= height or next_column >= width:
                    continue
                other = faces[next_row, next_column]
                if other == face or _both_leaves(mesh, face, other):
                    continue
                differs = _differ(mesh, owners, face, other)
                last_row, last_column = row - down, column - 1 + down
                if not differs and last_row >= 0 and last_column >= 0:
                    near, far = depths[last_row, last_column], depths[next_row, next_column]
                    differs = abs(depth / near + depth / far - 2.0) > _BEND
                if differs:
                    is_edge[row, column] = True
                    is_edge[next_row, next_column] = True
    return is_edge


@compiled
def _both_leaves(mesh: MeshTables, face: int, other: int) -> bool:
    """Test for two leaves, between which edges are ignored to save time: foliage is all edges."""
    if face < 0 or other < 0:
        return False
    return bool(mesh.materials[face] == _LEAF and mesh.materials[other] == _LEAF)


@compiled
def _differ(
    mesh: MeshTables, owners: Int32[np.ndarray, " num_faces"], face: int, other: int
) -> bool:
    """Test whether two faces belong to different objects or differ in material or colour."""
    if face < 0 or other < 0:
        return face != other
    if owners[face] != owners[other] or mesh.materials[face] != mesh.materials[other]:
        return True
    step = 0.0
    for channel in range(3):
        step = max(step, abs(mesh.colors[face, channel] - mesh.colors[other, channel]))
    return step > _COLOR_STEP


@compiled
def lenders(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    faces: Int32[np.ndarray, "height width"],
    more_rays: Rays,
    more_hits: Hits,
    pixels: Int32[np.ndarray, " num_more"],
) -> Int32[np.ndarray, " num_more"]:
    """Find a pixel on the same surface for each additional ray; -1 if there is none.

    `faces` are those of the pixels; `pixels` holds the flat index of each additional ray's pixel.
    """
    found = np.empty(pixels.shape[0], np.int32)
    height, width = faces.shape
    for ray in range(pixels.shape[0]):
        face = more_hits.faces[ray]
        way = scaled(row_of(more_rays.directions, ray), more_hits.distances[ray])
        reached = plus(row_of(more_rays.origins, ray), way)
        found[ray] = -1
        # The pixel itself, then its neighbours in reading order.
        for place in range(-1, 9):
            place_or_center = 4 if place < 0 else place
            row = pixels[ray] // width + place_or_center // 3 - 1
            column = pixels[ray] % width + place_or_center % 3 - 1
            if not (0 <= row < height and 0 <= column < width):
                continue
            other = faces[row, column]
            if other == face or (
                face >= 0
                and other >= 0
                and _same_surface(mesh, owners, face, other, reached, more_hits.distances[ray])
            ):
                found[ray] = row * width + column
                break
    return found


@compiled
def _same_surface(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    face: int,
    other: int,
    reached: Vector,
    depth: float,
) -> bool:
    """Test whether a point on one face can take the radiance of the other face."""
    if _differ(mesh, owners, face, other):
        return False
    apart = minus(reached, row_of(mesh.vertices, mesh.faces[other, 0]))
    if mesh.materials[face] == _LEAF:
        return dot(apart, apart) < _SAME_CROWN_M * _SAME_CROWN_M
    normal = face_normal(mesh, other)
    if abs(dot(normal, face_normal(mesh, face))) < _SAME_DIRECTION:
        return False
    return abs(dot(normal, apart)) < _SAME_PLANE * depth


EDGE_OFFSETS: Final = ((0.33, -0.26), (-0.33, 0.26))
"""Extra samples (x, y) [px] of a pixel at an edge, relative to its centre."""


class View(NamedTuple):
    """Camera position and pixel directions; world frame.

    The direction of pixel (x, y) is `corner + x * right + y * down`. It is scaled to advance one
    metre along the optical axis, so that distances along it are depths.
    """

    center: Vector3
    corner: Vector3
    right: Vector3
    down: Vector3

    @property
    def pixel_angle(self) -> float:
        """Approximate angle between neighbouring pixels [rad]."""
        return float(np.sqrt(np.linalg.norm(self.right) * np.linalg.norm(self.down)))

    def rays(self, columns: RayValues, rows: RayValues) -> Rays:
        """Build rays through image positions [px]."""
        return _aimed(self, columns, rows)


class RollingView(NamedTuple):
    """View of a moving camera that exposes its rows one after the other."""

    first: View
    """View at the first row's time."""
    last: View
    """View at the last row's time."""
    num_rows: int

    @property
    def pixel_angle(self) -> float:
        """Approximate angle between neighbouring pixels [rad]."""
        return self.first.pixel_angle

    def rays(self, columns: RayValues, rows: RayValues) -> Rays:
        """Build rays through image positions [px]; between the two times, motion is steady."""
        early, late = self.first.rays(columns, rows), self.last.rays(columns, rows)
        share = (rows / np.float32(max(self.num_rows - 1, 1)))[:, None]
        return Rays(*(old + share * (new - old) for old, new in zip(early, late, strict=True)))


class Samples(NamedTuple):
    """Rays of an image: one through each pixel, then more through the pixels at edges."""

    image_size: tuple[int, int]  # (height, width)
    rays: Rays
    hits: Hits  # hits of the rays; their distances are depths
    columns: RayValues
    rows: RayValues
    """Image position of each ray [px], relative to the ray through the first pixel."""
    strata: RayRows
    """Part of the sun's disc sampled by each ray's first shadow ray."""
    edges: Int32[np.ndarray, " num_edges"]  # flat indices of the pixels at edges
    sample_rows: Int32[np.ndarray, "num_offsets num_edges"]
    """Row of the ray that gives an edge pixel its radiance at each of EDGE_OFFSETS."""


@compiled
def _aimed(view: View, columns: RayValues, rows: RayValues) -> Rays:
    count = columns.shape[0]
    rays = Rays(np.empty((count, 3), np.float32), np.empty((count, 3), np.float32))
    for ray in range(count):
        for axis in range(3):
            rays.origins[ray, axis] = view.center[axis]
            across, along = columns[ray] * view.right[axis], rows[ray] * view.down[axis]
            rays.directions[ray, axis] = view.corner[axis] + across + along
    return rays


def camera_view(calibration: CalibrationMatrices, ego: Pose, lidar_height_m: float) -> View:
    """Compute the view from a calibration whose LiDAR is `lidar_height_m` above the footprint."""
    pixels = np.array([[0, 0], [0, 0], [1, 0], [0, 1]], dtype=np.float64)
    depths = np.array([0, 1, 1, 1], dtype=np.float64)
    points = unproject_pixels(pixels, depths, calibration)
    world_from_lidar = world_from_footprint(ego, lidar_height_m)
    center, ahead, right, down = points @ world_from_lidar[:3, :3].T + world_from_lidar[:3, 3]
    return View(
        center=np.ascontiguousarray(center),
        corner=ahead - center,
        right=right - ahead,
        down=down - ahead,
    )


def pixel_samples(
    world: LitWorld,
    view: View | RollingView,
    image_size: tuple[int, int],
    offset: tuple[float, float],
) -> Samples:
    """Cast one ray per pixel, offset by (x, y) pixels from its centre."""
    height, width = image_size
    y, x = np.divmod(np.arange(height * width), width)
    columns, rows = x.astype(np.float32), y.astype(np.float32)
    rays = view.rays(columns + np.float32(offset[0]), rows + np.float32(offset[1]))
    return Samples(
        image_size=image_size,
        rays=rays,
        hits=cast_through_foliage(world.raycaster, world.mesh, rays),
        columns=columns,
        rows=rows,
        strata=(x % 2 + 2 * (y % 2)).astype(np.int32),
        edges=np.zeros(0, np.int32),
        sample_rows=np.zeros((0, 0), np.int32),
    )


def add_edge_samples(
    world: LitWorld,
    view: View | RollingView,
    samples: Samples,
    owners: Int32[np.ndarray, " num_faces"],
) -> Samples:
    """Add samples at edges between neighbouring pixels."""
    faces = samples.hits.faces.reshape(samples.image_size)
    depths = samples.hits.distances.reshape(samples.image_size)
    is_edge = edge_pixels(world.mesh, owners, faces, depths)
    edges = np.flatnonzero(is_edge).astype(np.int32)
    pixels = np.tile(edges, len(EDGE_OFFSETS))
    shifts = np.repeat(np.array(EDGE_OFFSETS, np.float32), len(edges), axis=0)
    columns, rows = samples.columns[pixels] + shifts[:, 0], samples.rows[pixels] + shifts[:, 1]
    rays = view.rays(columns, rows)
    hits = cast_through_foliage(world.raycaster, world.mesh, rays)
    sample_rows = lenders(world.mesh, owners, faces, rays, hits, pixels)
    own = np.flatnonzero(sample_rows < 0)
    sample_rows[own] = len(samples.columns) + np.arange(len(own))
    return Samples(
        image_size=samples.image_size,
        rays=Rays(*(np.concatenate((a, b[own])) for a, b in zip(samples.rays, rays, strict=True))),
        hits=Hits(*(np.concatenate((a, b[own])) for a, b in zip(samples.hits, hits, strict=True))),
        columns=np.concatenate((samples.columns, columns[own])),
        rows=np.concatenate((samples.rows, rows[own])),
        strata=np.concatenate((samples.strata, own.astype(np.int32) % np.int32(SUN_QUARTERS))),
        edges=edges,
        sample_rows=sample_rows.reshape(len(EDGE_OFFSETS), len(edges)),
    )
