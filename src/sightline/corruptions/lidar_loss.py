"""Lost LiDAR returns: beams, random points, the sides of the view, wedges, blobs."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from sightline.corruptions.corruption import (
    LidarCorruption,
    PointsChange,
    Sweep,
    everywhere,
    region_of,
)
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.corruptions.sweep_beams import beams_of
from sightline.geometry.projection import unproject_pixels
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample

_FAR_M = 1e5  # where the offset of camera and LiDAR is negligible


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarBeams(LidarCorruption):
    """Loss of whole beams; the kept beams are spread over the sensor as evenly as possible.

    Beams are those of the sweep (`beams_of`). In one draw, a larger share keeps all the beams of a
    smaller one.
    """

    kind = "lidar_beams"

    kept_share: Annotated[float, Within(0, 1)]
    """Share of the sensor's beams that stay; at least one with points stays."""
    lidar: SpinningLidar = HDL_64E
    """Assumed LiDAR; the rings of a sweep that is not of it are its own."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Remove beams; draws the kept ones with `spread_beams`."""
        sweep = beams_of(sample, self.lidar)
        count = max(1, round(self.kept_share * sweep.num_beams))
        first = int(rng.integers(sweep.num_beams))
        order = (spread_beams(sweep.num_beams) + first) % sweep.num_beams
        beams, with_points = order[:count], order[np.isin(order, sweep.numbers)]
        if not np.isin(beams, with_points).any():
            beams = np.append(beams[1:], with_points[:1])
        kept = np.isin(sweep.numbers, beams)
        left, sources = _only(points, kept)
        return PointsChange(left, sources, everywhere(sample), {"beams": sorted(beams.tolist())})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarPointDrop(LidarCorruption):
    """Loss of random points, all with the same probability; exactly the rounded share of them."""

    kind = "lidar_point_drop"

    share: Annotated[float, Within(0, 1)]

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Remove points; draws their order, in which the first are lost."""
        kept = np.ones(len(points), dtype=np.bool_)
        kept[rng.permutation(len(points))[: round(self.share * len(points))]] = False
        left, sources = _only(points, kept)
        return PointsChange(left, sources, everywhere(sample), {"share": self.share})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarFov(LidarCorruption):
    """Field of view reduced to an angle on either side of the camera's optical axis."""

    kind = "lidar_fov"
    needs_calibration = True
    leaves_nothing = True

    half_angle_deg: Annotated[float, Within(0, 180)]

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Remove points outside the field of view; no random draws."""
        del rng
        x, y, _ = sample.calibration.camera_from_lidar[2, :3].tolist()
        axis_deg = math.degrees(math.atan2(y, x))
        kept = np.abs(_azimuths_beside(points, axis_deg)) <= self.half_angle_deg
        left, sources = _only(points, kept)
        mask = region_of(points.numpy()[~kept], sample)
        return PointsChange(left, sources, mask, {"axis_deg": axis_deg})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarSector(LidarCorruption):
    """Loss of all points of one wedge with its middle in the camera's view."""

    kind = "lidar_sector"
    needs_calibration = True
    leaves_nothing = True

    width_deg: Annotated[float, Within(0, 360)]

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Remove a wedge; draws the image column of its middle at a large distance."""
        height, width = sample.image_size
        pixel = torch.tensor([[rng.uniform(-0.5, width - 0.5), (height - 1) / 2]])
        x, y, _ = unproject_pixels(
            pixel.double(), torch.tensor([_FAR_M]).double(), sample.calibration
        )[0].tolist()
        centre_deg = math.degrees(math.atan2(y, x))
        kept = np.abs(_azimuths_beside(points, centre_deg)) > self.width_deg / 2
        left, sources = _only(points, kept)
        mask = region_of(points.numpy()[~kept], sample)
        return PointsChange(left, sources, mask, {"centre_deg": centre_deg})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarCutout(LidarCorruption):
    """Loss of blobs: a random remaining point each, with its nearest remaining neighbours."""

    kind = "lidar_cutout"
    leaves_nothing = True

    num_blobs: Annotated[int, Within(0)]
    share_of_each: Annotated[float, Within(0, 1)] = 0.02
    """Share of the sweep's points, rounded up."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Remove blobs, drawn in sequence: in one draw, more blobs include all of fewer."""
        size = math.ceil(self.share_of_each * len(points))
        places = points[:, :3].numpy()
        rows = np.arange(len(points))
        for _ in range(self.num_blobs):
            if len(rows) <= size:
                rows = rows[:0]
                break
            centre = places[rows[rng.integers(len(rows))]]
            distances = np.square(places[rows] - centre).sum(axis=1)
            rows = np.delete(rows, np.argpartition(distances, size)[:size])
        kept = np.zeros(len(points), dtype=np.bool_)
        kept[rows] = True
        left, sources = _only(points, kept)
        mask = region_of(points.numpy()[~kept], sample)
        return PointsChange(left, sources, mask, {"num_blobs": self.num_blobs})


def spread_beams(num_beams: int) -> Int64[np.ndarray, " num_beams"]:
    """Order beams so that every prefix is evenly spread over all beams: van der Corput 1935.

    The bits of 0, 1, 2 ... are reversed: for 8 beams 0, 4, 2, 6, 1, 5, 3, 7.
    """
    bits = max(num_beams - 1, 0).bit_length()
    counted = np.arange(1 << bits)
    order = np.zeros_like(counted)
    for bit in range(bits):
        order |= ((counted >> bit) & 1) << (bits - 1 - bit)
    return order[order < num_beams]


def _only(
    points: Sweep, kept: Bool[np.ndarray, " num_points"]
) -> tuple[Float32[Tensor, "num_left 4"], Int64[Tensor, " num_left"]]:
    """Select the kept points, in new memory, and their rows."""
    rows = torch.from_numpy(np.flatnonzero(kept))
    return points[rows], rows


def _azimuths_beside(points: Sweep, centre_deg: float) -> Float64[np.ndarray, " num_points"]:
    """Compute the azimuth of each point relative to a direction, in [-180, 180)."""
    x, y = points[:, :2].double().numpy().T
    beside: Float64[np.ndarray, " num_points"] = np.degrees(np.arctan2(y, x)) - centre_deg
    return (beside + 180) % 360 - 180
