"""Camera viewpoint and the rays that sample its pixels."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.pixels import unproject_pixels
from sightline.ops.compiled import compiled
from sightline.simulation.antialiasing import edge_pixels, lenders
from sightline.simulation.foliage import cast_through_foliage
from sightline.simulation.raycast import Hits
from sightline.simulation.scene import Pose, world_from_footprint
from sightline.simulation.shading import SUN_QUARTERS, LitWorld
from sightline.simulation.surfaces import Rays

EDGE_OFFSETS: Final = ((0.33, -0.26), (-0.33, 0.26))
"""Extra samples (x, y) [px] of a pixel at an edge, relative to its centre."""


class View(NamedTuple):
    """Camera position and pixel directions; world frame.

    The direction of pixel (x, y) is `corner + x * right + y * down`. It is scaled to advance one
    metre along the optical axis, so that distances along it are depths.
    """

    center: Float64[np.ndarray, "3"]
    corner: Float64[np.ndarray, "3"]
    right: Float64[np.ndarray, "3"]
    down: Float64[np.ndarray, "3"]

    @property
    def pixel_angle(self) -> float:
        """Approximate angle between neighbouring pixels [rad]."""
        return float(np.sqrt(np.linalg.norm(self.right) * np.linalg.norm(self.down)))

    def rays(
        self, columns: Float32[np.ndarray, " num_rays"], rows: Float32[np.ndarray, " num_rays"]
    ) -> Rays:
        """Build rays through image positions [px]."""
        rays = Rays(np.empty((len(columns), 3), np.float32), np.empty((len(rows), 3), np.float32))
        _aim(self, columns, rows, rays)
        return rays


class Samples(NamedTuple):
    """Rays of an image: one through each pixel, then more through the pixels at edges."""

    image_size: tuple[int, int]
    """(height, width)."""
    rays: Rays
    hits: Hits
    """Hits of the rays; their distances are depths."""
    columns: Float32[np.ndarray, " num_rays"]
    rows: Float32[np.ndarray, " num_rays"]
    """Image position of each ray [px], relative to the ray through the first pixel."""
    strata: Int32[np.ndarray, " num_rays"]
    """Part of the sun's disc sampled by each ray's first shadow ray."""
    edges: Int32[np.ndarray, " num_edges"]
    """Flat indices of the pixels at edges."""
    shown: Int32[np.ndarray, "num_offsets num_edges"]
    """Row of the ray that gives an edge pixel its radiance at each of EDGE_OFFSETS."""


@compiled
def _aim(
    view: View,
    columns: Float32[np.ndarray, " num_rays"],
    rows: Float32[np.ndarray, " num_rays"],
    rays: Rays,
) -> None:
    for ray in range(columns.shape[0]):
        for axis in range(3):
            rays.origins[ray, axis] = view.center[axis]
            across, along = columns[ray] * view.right[axis], rows[ray] * view.down[axis]
            rays.directions[ray, axis] = view.corner[axis] + across + along


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
    world: LitWorld, view: View, image_size: tuple[int, int], offset: tuple[float, float]
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
        shown=np.zeros((0, 0), np.int32),
    )


def with_edge_samples(
    world: LitWorld, view: View, samples: Samples, owners: Int32[np.ndarray, " num_faces"]
) -> Samples:
    """Add samples at edges between neighbouring pixels."""
    edges = edge_pixels(world.mesh, owners, samples.hits, samples.image_size)
    pixels = np.tile(edges, len(EDGE_OFFSETS))
    shifts = np.repeat(np.array(EDGE_OFFSETS, np.float32), len(edges), axis=0)
    columns, rows = samples.columns[pixels] + shifts[:, 0], samples.rows[pixels] + shifts[:, 1]
    rays = view.rays(columns, rows)
    hits = cast_through_foliage(world.raycaster, world.mesh, rays)
    shown = lenders(world.mesh, owners, samples.hits, samples.image_size, rays, hits, pixels)
    own = np.flatnonzero(shown < 0)
    shown[own] = len(samples.columns) + np.arange(len(own))
    return Samples(
        image_size=samples.image_size,
        rays=Rays(*(np.concatenate((a, b[own])) for a, b in zip(samples.rays, rays, strict=True))),
        hits=Hits(*(np.concatenate((a, b[own])) for a, b in zip(samples.hits, hits, strict=True))),
        columns=np.concatenate((samples.columns, columns[own])),
        rows=np.concatenate((samples.rows, rows[own])),
        strata=np.concatenate((samples.strata, own.astype(np.int32) % np.int32(SUN_QUARTERS))),
        edges=edges,
        shown=shown.reshape(len(EDGE_OFFSETS), len(edges)),
    )
