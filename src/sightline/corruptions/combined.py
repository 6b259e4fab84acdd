"""Several corruptions of one sample, one after the other."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from sightline.corruptions.corruption import (
    Corrupted,
    Corruption,
    Parameter,
    PointsChange,
    Record,
    Sensor,
    nowhere,
)
from sightline.corruptions.kinds import find_kind
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.structures.sample import CameraLidarSample

JOINED = "+"
"""Sign between the names of kinds that meet a sample together: camera_fog+lidar_fog."""


@dataclass(frozen=True, kw_only=True)
class Combined(Corruption):
    """Corruptions that meet a sample in their order, each with random numbers of its own.

    Raises:
        ValueError: There are fewer than two.
    """

    kind = "combined"
    sensors = ("camera", "lidar")

    parts: tuple[Corruption, ...]

    def __post_init__(self) -> None:
        """Checks the number."""
        if len(self.parts) < 2:
            raise ValueError(f"a combination needs two or more kinds, got {len(self.parts)}")

    def __str__(self) -> str:
        """The kinds."""
        return ", ".join(map(str, self.parts))

    def described(self) -> dict[str, object]:
        """What each part depends on, as JSON types."""
        return {"kind": self.kind, "parts": [part.described() for part in self.parts]}

    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """See `Corruption.corrupt`; parameters are named by kind, as camera_fog.visibility_m."""
        worse, sources = sample, None
        camera_mask, lidar_mask = nowhere(sample), nowhere(sample)
        parameters: dict[str, Parameter] = {}
        for part, own_rng in zip(self.parts, rng.spawn(len(self.parts)), strict=True):
            found = part.corrupt(worse, own_rng)
            worse = found.sample
            camera_mask = camera_mask | found.camera_mask
            lidar_mask = lidar_mask | found.lidar_mask
            sources = _through(sources, found.point_sources)
            drawn = found.record.parameters.items()
            parameters |= {f"{part.kind}.{name}": value for name, value in drawn}
        broken = None
        if sources is not None and sample.points is not None and worse.points is not None:
            change = PointsChange(worse.points, sources, lidar_mask, parameters)
            broken = change.broken(sample.points)
        return Corrupted(
            sample=worse,
            record=Record(kind=self.kind, sensors=self._sensors(), parameters=parameters),
            camera_mask=camera_mask,
            lidar_mask=lidar_mask,
            broken_points=broken,
            point_sources=sources,
        )

    def _sensors(self) -> tuple[Sensor, ...]:
        return tuple(
            name for name in self.sensors if any(name in part.sensors for part in self.parts)
        )


def find_corruption(names: str, severity: int, lidar: SpinningLidar = HDL_64E) -> Corruption:
    """The corruption of a kind, or of several joined by `+`, at one severity.

    Args:
        names: Such as camera_fog, or camera_fog+lidar_fog.
        severity: From 1, slight, to 5.
        lidar: The LiDAR that it is a fault of, as far as it matters.

    Raises:
        ValueError: There is no such kind or severity, or a kind is named twice.
    """
    kinds = [find_kind(name.strip()) for name in names.split(JOINED)]
    twice = sorted({kind.name for kind in kinds if kinds.count(kind) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)} is named twice in '{names}'; name each kind once")
    parts = tuple(kind.at(severity, lidar) for kind in kinds)
    return parts[0] if len(parts) == 1 else Combined(parts=parts)


def needs_calibration(corruption: Corruption) -> bool:
    """Whether what a corruption, or one of its parts, does depends on the calibration."""
    if isinstance(corruption, Combined):
        return any(map(needs_calibration, corruption.parts))
    return corruption.needs_calibration


def _through(earlier: Tensor | None, later: Tensor | None) -> Tensor | None:
    """Rows of the sound sweep that points stem from, after two corruptions; -1 stays -1."""
    if earlier is None or later is None:
        return later if earlier is None else earlier
    sources = later.clone()
    from_earlier = later >= 0
    sources[from_earlier] = earlier[later[from_earlier]]
    return sources
