"""Combinations of corruptions, for example rain in both the camera and the LiDAR."""

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import torch

from sightline.corruptions.corruption import (
    Corrupted,
    Corruption,
    Parameter,
    PointsChange,
    Record,
    nowhere,
)
from sightline.corruptions.kinds import find_kind
from sightline.corruptions.occlusion import CameraOcclusion, LidarOcclusion
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.files.plain_text import shortened
from sightline.geometry.arguments import wrong_type
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.sample import CameraLidarSample, Sensor

JOINED = "+"
"""Separator of kinds that corrupt a sample together: camera_fog+lidar_fog."""


@dataclass(frozen=True, kw_only=True)
class Combined(Corruption):
    """Corruptions in sequence, each applied to the output of the one before.

    Corruptions of the camera alone come first, in any given order: their effect may depend on the
    depth from a sound sweep. Each draws from a generator of its own, which the given one spawns:
    its seed and the number of its earlier spawns count, not the state of its bits. To repeat a
    result, give a new generator of the same seed; restoring `bit_generator.state` is not enough.

    Raises:
        ValueError: There are fewer than two.
    """

    parts: tuple[Corruption, ...]
    """Two or more corruptions."""

    def __post_init__(self) -> None:
        """Check the number."""
        if len(self.parts) < 2:
            raise ValueError(f"a combination needs two or more kinds, got {len(self.parts)}")

    @property
    def kind(self) -> str:  # type: ignore[override]  # a property of the parts, not of the class
        """Names of the parts' kinds."""
        return JOINED.join(part.kind for part in self.parts)

    @property
    def sensors(self) -> tuple[Sensor, ...]:  # type: ignore[override]  # as above
        """Sensors affected by the parts, the camera first."""
        named = {sensor for part in self.parts for sensor in part.sensors}
        return tuple(sensor for sensor in get_args(Sensor) if sensor in named)

    def __str__(self) -> str:
        """Names of the kinds."""
        return ", ".join(map(str, self.parts))

    def described(self) -> dict[str, object]:
        """Collect `Corruption.described` of each part."""
        return {"kind": self.kind, "parts": [part.described() for part in self.parts]}

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Apply all parts; see `Corruption.corrupt`. Parameters are named KIND.NAME."""
        pairs = list(zip(self.parts, rng.spawn(len(self.parts)), strict=True))
        pairs.sort(key=lambda pair: "lidar" in pair[0].sensors)
        current, sources = sample, None
        camera_mask, lidar_mask = nowhere(sample), nowhere(sample)
        parameters: dict[str, Parameter] = {}
        for part, own_rng in pairs:
            step = part.corrupt(current, own_rng)
            current = step.sample
            camera_mask, lidar_mask = camera_mask | step.camera_mask, lidar_mask | step.lidar_mask
            named = step.record.parameters.items()
            parameters |= {f"{part.kind}.{name}": value for name, value in named}
            if step.point_sources is None:
                continue
            if sources is None or len(sources) == 0:  # of a dead sensor without output
                sources = step.point_sources
            else:
                rows = sources[step.point_sources.clamp(min=0)]
                sources = torch.where(step.point_sources >= 0, rows, -1)
        corrupted = Corrupted(
            sample=current,
            record=Record(kind=self.kind, sensors=self.sensors, parameters=parameters),
            camera_mask=camera_mask,
            lidar_mask=lidar_mask,
        )
        if sources is None or sample.points is None or current.points is None:
            return corrupted
        change = PointsChange(current.points, sources, lidar_mask, {})
        return replace(corrupted, broken_points=change.broken(sample.points), point_sources=sources)


def find_corruption(names: str, severity: int, lidar: SpinningLidar = HDL_64E) -> Corruption:
    """Find the corruption of a kind, or of several joined by `+`, at one severity.

    Args:
        names: For example camera_fog, or camera_fog+lidar_fog.
        severity: From 1, slight, to 5.
        lidar: The affected LiDAR, if its properties matter.

    Raises:
        TypeError: The kind is not a string.
        ValueError: There is no such kind or severity, or a kind is given twice.
    """
    if not isinstance(names, str):
        raise wrong_type("kind", names, "text; give a kind's name, such as camera_fog")
    kinds = [find_kind(name.strip()) for name in names.split(JOINED)]
    twice = sorted({kind.name for kind in kinds if kinds.count(kind) > 1})
    if twice:
        raise ValueError(
            f"{', '.join(twice)} is named twice in '{shortened(names)}'; name each kind once"
        )
    parts = tuple(kind.at(severity, lidar) for kind in kinds)
    return parts[0] if len(parts) == 1 else Combined(parts=parts)


def needs_calibration(corruption: Corruption) -> bool:
    """Test whether the effect of a corruption, or of a part, depends on the calibration."""
    if isinstance(corruption, Combined):
        return any(map(needs_calibration, corruption.parts))
    return corruption.needs_calibration


def hits_objects(corruption: Corruption) -> bool:
    """Test whether a corruption, or a part, is placed by the labels of the frame."""
    if isinstance(corruption, Combined):
        return any(map(hits_objects, corruption.parts))
    if isinstance(corruption, CameraOcclusion | LidarOcclusion):
        return corruption.box.placement == "object"
    return False
