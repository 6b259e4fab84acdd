"""Base classes of corruptions: sensor faults with a record and masks of their changes."""

import json
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import ClassVar, Final, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64, UInt8
from torch import Tensor

from sightline.augmentation.faults import Fault
from sightline.geometry.checked import checked
from sightline.geometry.projection import project_points
from sightline.geometry.ranges import Number, check_ranges
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.sample import CameraLidarSample, Sensor

Image = UInt8[Tensor, "3 height width"]
Sweep = Float32[Tensor, "num_points 4"]
Parameter = Number | str | Sequence[Number]
"""Values that JSON can store."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """Record of the corruption of a sample."""

    kind: str
    sensors: tuple[Sensor, ...]
    """Sensors affected by the kind."""
    parameters: Mapping[str, Parameter]
    """Drawn values, by name with unit; empty if a sensor was absent, so that nothing changed."""

    def to_json(self) -> dict[str, object]:
        """Content of a record file."""
        return {
            "kind": self.kind,
            "sensors": list(self.sensors),
            "parameters": dict(self.parameters),
        }


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class Corrupted:
    """Sample from faulty sensors, with a record of the corruption.

    The masks mark the pixels that may have changed; no pixel outside has changed. The LiDAR's mask
    is in the image plane, like its projected maps (`geometry.projection`); points outside the
    camera's view have no pixel. `broken_points` and `point_sources` give the exact changes point by
    point.
    """

    sample: CameraLidarSample
    record: Record
    camera_mask: Bool[Tensor, "height width"]
    lidar_mask: Bool[Tensor, "height width"]
    broken_points: Bool[Tensor, " num_points"] | None = None
    """Points of the sound sweep that are lost or changed; None if no sweep was corrupted."""
    point_sources: Int64[Tensor, " num_delivered"] | None = None
    """Row of each delivered point in the sound sweep; -1 if it has none."""


@dataclass(frozen=True, kw_only=True)
class Corruption(Fault):
    """Fault with a record; its fields are the ranges of its random draws, in the sensor's units.

    To add a kind: subclass `CameraCorruption`, `LidarCorruption` or, for both sensors, this class,
    in a file of its own, and list it in a suite.
    """

    kind: ClassVar[str]
    """Name of the kind; it also separates its random numbers from other kinds'."""
    sensors: ClassVar[tuple[Sensor, ...]]
    """Sensors that it changes; all other parts of a sample stay unchanged."""
    revision: ClassVar[int] = 1
    """Revision, raised whenever the same settings and draws begin to give another result."""
    needs_calibration: ClassVar[bool] = True
    """Whether the effect depends on the calibration; masks of the LiDAR always do."""
    leaves_nothing: ClassVar[bool] = False
    """Whether the masked pixels show nothing of the scene any more, rather than less of it."""

    def __post_init__(self) -> None:
        """Check the settings; a subclass with checks of its own calls `check_ranges`, too."""
        check_ranges(self)

    def __str__(self) -> str:
        """Name of the kind."""
        return self.kind.replace("_", " ")

    def described(self) -> dict[str, object]:
        """Collect all settings of the effect as JSON types, for records and manifests.

        Raises:
            ValueError: A subclass keeps settings that are no fields, as it is no dataclass itself.
        """
        others = sorted(vars(self).keys() - {each.name for each in fields(self)})
        if others and "__dataclass_fields__" not in vars(type(self)):
            raise ValueError(
                f"{type(self).__name__} keeps {others[0]} beside its fields, so that records would "
                "not tell it; make it a field, under @dataclass(frozen=True, kw_only=True)"
            )
        revision = {"revision": self.revision} if self.revision > 1 else {}
        described: dict[str, object]
        described = json.loads(json.dumps({"kind": self.kind, **revision, **asdict(self)}))
        return described

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Corrupt a sample; parts of absent sensors stay unchanged."""
        return self.corrupt(sample, rng).sample

    @abstractmethod
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Corrupt a sample, with record and masks.

        The given sample is not changed; the new one shares its unchanged parts. A sensor that is
        absent stays absent: its mask is empty.

        Args:
            sample: Sample of sound sensors, possibly with little data.
            rng: Source of all randomness.
        """


@dataclass(frozen=True, kw_only=True, slots=True)
class NoCorruption(Corruption):
    """Unchanged output of sound sensors."""

    kind = "none"
    sensors = ()

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Return the unchanged sample."""
        del rng
        return _unchanged(self, sample)


class ImageChange(NamedTuple):
    """Corrupted image."""

    image: Image
    mask: Bool[Tensor, "height width"]
    parameters: Mapping[str, Parameter]


class PointsChange(NamedTuple):
    """Corrupted sweep."""

    points: Sweep
    sources: Int64[Tensor, " num_delivered"]
    """Row of each point in the sound sweep, -1 if it has none; each row at most once."""
    mask: Bool[Tensor, "height width"]
    parameters: Mapping[str, Parameter]

    def broken(self, sound: Sweep) -> Bool[Tensor, " num_points"]:
        """Test which points of the sound sweep are lost or changed."""
        broken = torch.ones(len(sound), dtype=torch.bool)
        from_sound = self.sources >= 0
        rows = self.sources[from_sound]
        broken[rows] = (self.points[from_sound] != sound[rows]).any(dim=1)
        return broken


class CameraCorruption(Corruption):
    """Corruption of the camera alone."""

    sensors = ("camera",)
    needs_calibration = False

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Apply `change_image`; see `Corruption.corrupt`."""
        if sample.image is None:
            return _unchanged(self, sample)
        change = self.change_image(sample.image, sample, rng)
        return Corrupted(
            sample=replace(sample, image=change.image),
            record=record_of(self, change.parameters),
            camera_mask=change.mask,
            lidar_mask=nowhere(sample),
        )

    @abstractmethod
    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Corrupt the image, in new memory.

        Args:
            image: The sample's image.
            sample: Other data of the sample.
            rng: Source of all randomness.
        """


class LidarCorruption(Corruption):
    """Corruption of the LiDAR alone."""

    sensors = ("lidar",)
    needs_calibration = False

    @named_arguments
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """Apply `change_points`; see `Corruption.corrupt`."""
        if sample.points is None:
            return _unchanged(self, sample)
        change = self.change_points(sample.points, sample, rng)
        return Corrupted(
            sample=replace(sample, points=change.points),
            record=record_of(self, change.parameters),
            camera_mask=nowhere(sample),
            lidar_mask=change.mask,
            broken_points=change.broken(sample.points),
            point_sources=change.sources,
        )

    @abstractmethod
    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Corrupt the sweep, in new memory.

        Args:
            points: The sample's sweep.
            sample: Other data of the sample.
            rng: Source of all randomness.
        """


@named_arguments
def everywhere(sample: CameraLidarSample) -> Bool[Tensor, "height width"]:
    """Make the mask of all pixels."""
    return torch.ones(sample.image_size, dtype=torch.bool)


@named_arguments
def nowhere(sample: CameraLidarSample) -> Bool[Tensor, "height width"]:
    """Make the mask of no pixel."""
    return torch.zeros(sample.image_size, dtype=torch.bool)


def _unchanged(corruption: Corruption, sample: CameraLidarSample) -> Corrupted:
    none = nowhere(sample)
    return Corrupted(
        sample=sample, record=record_of(corruption, {}), camera_mask=none, lidar_mask=none
    )


@named_arguments
def record_of(corruption: Corruption, parameters: Mapping[str, Parameter]) -> Record:
    """Make the record of a corruption from its drawn values."""
    return Record(kind=corruption.kind, sensors=corruption.sensors, parameters=parameters)


_SPACING_PX: Final = 9  # spacing of neighbouring rings in KITTI's image, rather more than less


@named_arguments
def region_of(
    points: Float32[np.ndarray, "num_points fields"], sample: CameraLidarSample
) -> Bool[Tensor, "height width"]:
    """Mark the pixels hit by points, and pixels between them up to the spacing of rings."""
    height, width = sample.image_size
    projected = project_points(torch.from_numpy(points[:, :3]).double(), sample.calibration)
    seen = projected.pixels[projected.in_image((height, width))].numpy()
    columns, rows = np.floor(seen + 0.5).astype(np.int64).T
    region = np.zeros((height, width), dtype=np.uint8)
    region[rows, columns] = 1
    kernel = np.ones((_SPACING_PX, _SPACING_PX), dtype=np.uint8)
    closed = cv2.morphologyEx(region, cv2.MORPH_CLOSE, kernel)
    return torch.from_numpy((closed > 0) | (region > 0))
