"""Glare of a low sun in the camera and the LiDAR."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from sightline.corruptions.corruption import (
    Corrupted,
    Corruption,
    Parameter,
    PointsChange,
    Sweep,
    everywhere,
    nowhere,
    record_of,
    region_of,
)
from sightline.corruptions.exposure import disc_mask
from sightline.corruptions.haze import to_levels
from sightline.corruptions.scene_depth import scene_horizon
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.corruptions.sweep_beams import view_of
from sightline.geometry.projection import project_points, unproject_pixels
from sightline.geometry.ranges import Within
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.sample import CameraLidarSample

_FAR_M: Final = 1e5
_HALO_LEVELS: Final = (255.0, 245.0, 220.0)  # added at the disc's rim, RGB
_GHOST_REFLECTANCE: Final = 0.1  # at most


@dataclass(frozen=True, kw_only=True, slots=True)
class SunGlare(Corruption):
    """Low sun: a white disc with a halo in the image, and a blind direction of the LiDAR.

    Points in the disc are lost, and the sunlight causes ghosts: points of random ranges in its
    direction, within the LiDAR's own field of view. After the sunlight of Dong et al. 2023.
    """

    kind = "sun_glare"
    sensors = ("camera", "lidar")

    radius_px: Annotated[float, Within(0, 10000)]
    """Radius of the all-white disc."""
    ghost_share: Annotated[float, Within(0, 1)]
    """Number of ghosts relative to the sweep's points, rounded."""
    ghost_range_m: Annotated[tuple[float, float], Within(0.1, 1000)] = (1.5, 80.0)
    """Range of ghosts; uniform distribution."""
    lidar: SpinningLidar = HDL_64E

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Apply `shine`; the sun's centre is drawn from the top of the image to the horizon."""
        height, width = sample.image_size
        horizon = min(max(scene_horizon(sample), 0), height - 1)
        centre_px = rng.uniform(-0.5, width - 0.5), rng.uniform(-0.5, horizon)
        found = Corrupted(
            sample=sample,
            record=record_of(self, {}),
            camera_mask=nowhere(sample),
            lidar_mask=nowhere(sample),
        )
        drawn: dict[str, Parameter] = {"centre_px": centre_px, "radius_px": self.radius_px}
        if sample.image is not None:
            found = replace(
                found,
                sample=replace(sample, image=shine(sample.image, centre_px, self.radius_px)),
                record=record_of(self, drawn),
                camera_mask=everywhere(sample),
            )
        if sample.points is not None:
            change = self._blind(sample.points, sample, centre_px, rng)
            found = replace(
                found,
                sample=replace(found.sample, points=change.points),
                record=record_of(self, {**drawn, **change.parameters}),
                lidar_mask=change.mask,
                broken_points=change.broken(sample.points),
                point_sources=change.sources,
            )
        return found

    def _blind(
        self,
        points: Sweep,
        sample: CameraLidarSample,
        centre_px: tuple[float, float],
        rng: np.random.Generator,
    ) -> PointsChange:
        """Remove the points in the disc and append the ghosts."""
        pixels = project_points(points[:, :3].double(), sample.calibration).pixels
        distances = torch.linalg.vector_norm(pixels - pixels.new_tensor(centre_px), dim=1)
        # NaN, the pixel of a point not in front of the camera, fails the comparison.
        lost = distances <= self.radius_px
        rows = (~lost).nonzero()[:, 0]
        ghosts = self._ghosts(round(self.ghost_share * len(points)), sample, centre_px, rng)
        changed = torch.cat((points[lost], ghosts)).numpy()
        mask = region_of(changed, sample)
        if len(points):
            mask |= disc_mask(sample.image_size, centre_px, self.radius_px)
        parameters = {"num_lost": int(lost.sum()), "num_ghosts": len(ghosts)}
        sources = torch.cat((rows, torch.full((len(ghosts),), -1)))
        return PointsChange(torch.cat((points[rows], ghosts)), sources, mask, parameters)

    def _ghosts(
        self,
        count: int,
        sample: CameraLidarSample,
        centre_px: tuple[float, float],
        rng: np.random.Generator,
    ) -> Sweep:
        """Draw points in the sun's direction, at elevations of the LiDAR's beams."""
        radii_px = self.radius_px * np.sqrt(rng.random(count))
        angles = rng.uniform(0, 2 * math.pi, count)
        pixels = np.array(centre_px) + radii_px[:, None] * np.stack(
            (np.cos(angles), np.sin(angles)), axis=1
        )
        far = unproject_pixels(
            torch.from_numpy(pixels), torch.full((count,), _FAR_M).double(), sample.calibration
        ).numpy()
        azimuths = np.arctan2(far[:, 1], far[:, 0])
        elevations = np.arctan2(far[:, 2], np.hypot(far[:, 0], far[:, 1]))
        lowest, highest = np.radians(view_of(sample, self.lidar))
        elevations = np.clip(elevations, lowest, highest)
        ranges_m = rng.uniform(*self.ghost_range_m, count)
        flat_m = ranges_m * np.cos(elevations)
        columns = (
            flat_m * np.cos(azimuths),
            flat_m * np.sin(azimuths),
            ranges_m * np.sin(elevations),
            _GHOST_REFLECTANCE * rng.random(count),
        )
        return torch.from_numpy(np.stack(columns, axis=1).astype(np.float32))


def shine(
    image: UInt8[Tensor, "3 height width"], centre_px: tuple[float, float], radius_px: float
) -> UInt8[Tensor, "3 height width"]:
    """Add a white disc and a halo that decreases with the square of the distance.

    The halo is like the scattered light of an eye or a lens: Vos 1984. It is added, up to 255.
    """
    height, width = image.shape[1:]
    x = (np.arange(width, dtype=np.float32) - centre_px[0]) ** 2
    y = (np.arange(height, dtype=np.float32) - centre_px[1]) ** 2
    shares = radius_px**2 / np.maximum(x + y[:, None], max(radius_px, 1e-3) ** 2)
    shares = shares.astype(np.float32)
    lit = image.numpy().astype(np.float32)
    lit += np.array(_HALO_LEVELS, dtype=np.float32)[:, None, None] * shares
    lit[:, shares >= 1] = 255
    return to_levels(lit)
