"""What every kind of corruption is: a fault of sensors that tells what it did, and where."""

import json
import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64, UInt8
from torch import Tensor

from sightline.data.faults import Fault
from sightline.geometry.checked import checked
from sightline.structures.sample import CameraLidarSample

Sensor = Literal["camera", "lidar"]
Image = UInt8[Tensor, "3 height width"]
Sweep = Float32[Tensor, "num_points 4"]
Number = float | int
Parameter = Number | str | Sequence[Number]
"""What JSON can hold."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """What was done to a sample."""

    kind: str
    sensors: tuple[Sensor, ...]
    """Those that the kind is a fault of."""
    parameters: Mapping[str, Parameter]
    """What was drawn, by name with unit; empty where a sensor was absent, so nothing was done."""

    def to_json(self) -> dict[str, object]:
        """What a record file holds."""
        return {
            "kind": self.kind,
            "sensors": list(self.sensors),
            "parameters": dict(self.parameters),
        }


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class Corrupted:
    """A sample as faulty sensors took it, with what was done to it.

    The masks mark the pixels that may have changed: nothing outside of them has. The LiDAR's is in
    the image plane, where its projected maps (`geometry.projection`) are; what it delivers out of
    the camera's view has no pixel. Point by point, which is exact, `broken_points` and
    `point_sources` tell what became of the sweep.
    """

    sample: CameraLidarSample
    record: Record
    camera_mask: Bool[Tensor, "height width"]
    lidar_mask: Bool[Tensor, "height width"]
    broken_points: Bool[Tensor, " num_points"] | None = None
    """Which points of the sound sweep are lost or changed; None where no sweep was corrupted."""
    point_sources: Int64[Tensor, " num_delivered"] | None = None
    """Of each point that is delivered its row in the sound sweep, -1 where it is from none."""


@dataclass(frozen=True, kw_only=True)
class Corruption(Fault):
    """A fault that tells what it did; its fields are what it draws from, in the sensor's units.

    To add a kind: subclass `CameraCorruption`, `LidarCorruption` or, for both sensors, this class,
    in a file of its own, and name it in a suite.
    """

    kind: ClassVar[str]
    """Name, which also keeps its random numbers apart from other kinds'."""
    sensors: ClassVar[tuple[Sensor, ...]]
    """Those that it changes; all other parts of a sample stay."""
    revision: ClassVar[int] = 1
    """Raised whenever the same settings and draws begin to give something else."""
    needs_calibration: ClassVar[bool] = True
    """True where the effect depends on the calibration; masks of the LiDAR always do."""
    leaves_nothing: ClassVar[bool] = False
    """Whether what the masks mark shows nothing of the scene any more, rather than less of it."""

    def __str__(self) -> str:
        """The kind."""
        return self.kind.replace("_", " ")

    def described(self) -> dict[str, object]:
        """All that its effect depends on, as JSON types: what records and manifests hold."""
        revision = {"revision": self.revision} if self.revision > 1 else {}
        described: dict[str, object]
        described = json.loads(json.dumps({"kind": self.kind, **revision, **asdict(self)}))
        return described

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """The sample as the faulty sensors take it; as it is where they are absent already."""
        return self.corrupt(sample, rng).sample

    @abstractmethod
    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """The sample as the faulty sensors take it, with record and masks.

        Nothing of the given sample is changed; the new one shares with it what is the same. A
        sensor that is absent stays so: its mask is empty.

        Args:
            sample: Of sound sensors, however little they delivered.
            rng: Where all randomness comes from.
        """


@dataclass(frozen=True, kw_only=True, slots=True)
class NoCorruption(Corruption):
    """Sound sensors."""

    kind = "none"
    sensors = ()

    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """The sample as it is."""
        del rng
        return _unchanged(self, sample)


class ImageChange(NamedTuple):
    """What a fault makes of an image."""

    image: Image
    mask: Bool[Tensor, "height width"]
    parameters: Mapping[str, Parameter]


class PointsChange(NamedTuple):
    """What a fault makes of a sweep."""

    points: Sweep
    sources: Int64[Tensor, " num_delivered"]
    """Of each point its row in the sound sweep, -1 where it is from none; each row once at most."""
    mask: Bool[Tensor, "height width"]
    parameters: Mapping[str, Parameter]

    def broken(self, sound: Sweep) -> Bool[Tensor, " num_points"]:
        """Which points of the sound sweep are lost or changed."""
        broken = torch.ones(len(sound), dtype=torch.bool)
        from_sound = self.sources >= 0
        rows = self.sources[from_sound]
        broken[rows] = (self.points[from_sound] != sound[rows]).any(dim=1)
        return broken


class CameraCorruption(Corruption):
    """A fault of the camera alone."""

    sensors = ("camera",)
    needs_calibration = False

    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """See `Corruption.corrupt`."""
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
        """The image as the faulty camera takes it, in new memory.

        Args:
            image: The sample's.
            sample: What else is known.
            rng: Where all randomness comes from.
        """


class LidarCorruption(Corruption):
    """A fault of the LiDAR alone."""

    sensors = ("lidar",)
    needs_calibration = False

    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """See `Corruption.corrupt`."""
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
        """The sweep as the faulty LiDAR takes it, in new memory.

        Args:
            points: The sample's.
            sample: What else is known.
            rng: Where all randomness comes from.
        """


def everywhere(sample: CameraLidarSample) -> Bool[Tensor, "height width"]:
    """The mask of all pixels."""
    return torch.ones(sample.image_size, dtype=torch.bool)


def nowhere(sample: CameraLidarSample) -> Bool[Tensor, "height width"]:
    """The mask of no pixel."""
    return torch.zeros(sample.image_size, dtype=torch.bool)


def check_range(name: str, bounds: tuple[Number, Number], lowest: Number, highest: Number) -> None:
    """Refuses a range to draw from that is empty or beyond what makes sense.

    Raises:
        ValueError: It is.
    """
    if not (lowest <= bounds[0] <= bounds[1] <= highest and bounds[1] < math.inf):
        raise ValueError(
            f"{name} must be two numbers from {lowest:g} to {highest:g}, the lower first; got "
            f"{bounds[0]:g} and {bounds[1]:g}"
        )


def check_number(name: str, value: Number, lowest: Number, highest: Number = math.inf) -> None:
    """Refuses a setting that is not finite or beyond what makes sense.

    Raises:
        ValueError: It is.
    """
    if not (lowest <= value <= highest and value < math.inf):
        limits = f"from {lowest:g} to {highest:g}" if highest < math.inf else f"at least {lowest:g}"
        raise ValueError(f"{name} must be finite and {limits}, got {value:g}")


def _unchanged(corruption: Corruption, sample: CameraLidarSample) -> Corrupted:
    none = nowhere(sample)
    return Corrupted(
        sample=sample, record=record_of(corruption, {}), camera_mask=none, lidar_mask=none
    )


def record_of(corruption: Corruption, parameters: Mapping[str, Parameter]) -> Record:
    """What a corruption did, by what it drew."""
    return Record(kind=corruption.kind, sensors=corruption.sensors, parameters=parameters)
