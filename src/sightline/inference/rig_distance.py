"""Distance of a recording's rig from the rig that shipped weights were trained on."""

import json
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.sample_dataset import NamedSubset, SampleDataset
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.files.weights_header import WEIGHTS_FOLDER
from sightline.simulation.measured_rig import (
    measure_camera,
    measure_lidar,
    spread_samples,
    swept_samples,
)
from sightline.simulation.rigs import CameraRig, LidarRig

TRAINED_RIGS: Final = WEIGHTS_FOLDER / "trained_rigs.json"
"""Trained range of each number of a rig, for the shipped weights."""
_FRAMES: Final = 3  # of the data set
_LEAST: Final = 0.25  # smaller distances are not reported
_NAMED: Final = 3  # numbers of a rig in the line
_LEAST_STEP_DEG: Final = 0.01
_NO_RINGS: Final = 1.0  # distance of a LiDAR without rings
_SENSORS: Final = {"camera": "camera", "lidar": "LiDAR"}
_TITLES: Final = {
    "focal_px": ("focal length", "px"),
    "height_m": ("height", "m"),
    "pitch_deg": ("pitch", "degrees"),
    "roll_deg": ("roll", "degrees"),
    "ring_step_deg": ("step between rings", "degrees"),
    "azimuth_step_deg": ("step in azimuth", "degrees"),
    "range_m": ("range", "m"),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Departure:
    """A number of a rig beyond its trained range."""

    sensor: str
    """camera or lidar."""
    name: str
    """Name of the number, with its unit."""
    value: float | None
    """Measured value; None: the LiDAR has no rings."""
    trained: tuple[float, float]
    distance: float
    """Distance from the trained range: 1 is a difference that is expected to cost much."""
    suffers: tuple[str, ...]
    """Results that become worse."""

    def __str__(self) -> str:
        """Format the number and its trained range."""
        title, unit = _TITLES[self.name]
        if self.value is None:
            return "LiDAR without rings"
        low, high = self.trained
        return (
            f"{_SENSORS[self.sensor]}'s {title} {self.value:.4g} {unit} (trained {low:g} to "
            f"{high:g})"
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class RigDistance:
    """Distance of a rig from training, by sensor; `str` formats it as one line."""

    departures: tuple[Departure, ...]
    """Numbers beyond their trained range, the farthest first."""

    def of_sensor(self, sensor: str) -> float:
        """Root of the sum of the squared distances of a sensor's numbers; 0: as trained."""
        return math.hypot(*(each.distance for each in self.departures if each.sensor == sensor))

    def __str__(self) -> str:
        """Name the farthest numbers, the results that suffer and both distances."""
        distances = ", ".join(
            f"{title} {self.of_sensor(sensor):.1f}" for sensor, title in _SENSORS.items()
        )
        shown = self.departures[:_NAMED]
        suffering = dict.fromkeys(result for each in shown for result in each.suffers)
        return (
            f"this rig differs from the training data: {', '.join(map(str, shown))}; expect losses "
            f"in {', '.join(suffering)} (distance: {distances}; 0: as trained, 1: costs much); "
            "`sightline adapt` fine-tunes (docs/guides/own_rig.md)"
        )

    def to_json(self) -> dict[str, Any]:
        """Convert to JSON: the distance of each sensor, and each number beyond its range."""
        return {
            sensor: {
                "distance": round(self.of_sensor(sensor), 3),
                "departures": [
                    {
                        "number": each.name,
                        "value": each.value,
                        "trained": list(each.trained),
                        "distance": round(each.distance, 3),
                        "suffers": list(each.suffers),
                    }
                    for each in self.departures
                    if each.sensor == sensor
                ],
            }
            for sensor in _SENSORS
        }


def rig_distance(
    data: Path,
    weights: Iterable[str],
    *,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
) -> RigDistance | None:
    """Measure a data set's rig by three of its frames, and compare it with the weights' training.

    Args:
        data: Folder of the data set.
        weights: Names of shipped weights; others are passed over, since their training is unknown.
        sample_list: List of the samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree.

    Returns:
        The distance; None: the rig is as trained (KITTI's is), the data cannot be read, or none of
        the weights is known.
    """
    table = _trained_rigs()
    designs = dict.fromkeys(table["weights"].get(name) for name in weights)
    ranges = [table["designs"][name] for name in designs if name is not None]
    if not ranges:
        return None
    parts: set[Part] = {"points"}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the command itself warns of the data
            dataset = open_dataset(
                data, sample_list=sample_list, velodyne=velodyne, parts=parts, needs=()
            )
            return _distance(dataset, ranges)
    except (ValueError, OSError):  # the command itself reports unreadable data
        return None


def _distance(dataset: SampleDataset, ranges: Sequence[Mapping[str, Any]]) -> RigDistance | None:
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if isinstance(whole, KittiDepthDataset):  # of KITTI's rig, in maps of depth without rings
        return None
    samples = spread_samples(dataset, _FRAMES)
    measured = [("camera", camera_numbers(measure_camera(sample))) for sample in samples]
    swept = swept_samples(samples)
    if swept:
        measured.append(("lidar", lidar_numbers(measure_lidar(swept)[0])))
    return compare(measured, ranges)


def compare(
    measured: Iterable[tuple[str, Mapping[str, float | None]]], ranges: Sequence[Mapping[str, Any]]
) -> RigDistance | None:
    """Compare numbers with trained ranges; None: all are within their ranges or near them.

    Of each number, the farthest measurement from any of the ranges counts.

    Args:
        measured: Sensors, each with its numbers by name; a sensor may occur several times.
        ranges: Trained range of each number by sensor and name, for each network.
    """
    farthest: dict[tuple[str, str], Departure] = {}
    for sensor, numbers in measured:
        for name, value in numbers.items():
            limits = [entry[sensor][name] for entry in ranges if name in entry.get(sensor, {})]
            found = [_departure(sensor, name, value, limit) for limit in limits]
            felt = [each for each in found if each.distance >= _LEAST]
            felt.sort(key=lambda each: -each.distance)
            known = farthest.get((sensor, name))
            if felt and (known is None or felt[0].distance > known.distance):
                suffers = tuple(result for each in felt for result in each.suffers)
                farthest[sensor, name] = replace(felt[0], suffers=suffers)
    departures = sorted(farthest.values(), key=lambda each: -each.distance)
    return RigDistance(departures=tuple(departures)) if departures else None


def _departure(sensor: str, name: str, value: float | None, limit: Mapping[str, Any]) -> Departure:
    low, high = map(float, limit["trained"])
    if value is None:
        distance = 0.0 if limit.get("without_rings") else _NO_RINGS
    elif value > high and limit.get("side") == "low":  # only smaller values cost anything
        distance = 0.0
    elif "factor" in limit:
        factor = max(low / value, value / high, 1.0)
        distance = math.log(factor) / math.log(limit["factor"])
    else:
        distance = max(low - value, value - high, 0.0) / limit["step"]
    return Departure(
        sensor=sensor,
        name=name,
        value=value,
        trained=(low, high),
        distance=distance,
        suffers=(limit["suffers"],),
    )


def camera_numbers(camera: CameraRig) -> dict[str, float | None]:
    """Collect the numbers of a camera that are compared."""
    return {
        name: getattr(camera, name) for name in ("focal_px", "height_m", "pitch_deg", "roll_deg")
    }


def lidar_numbers(lidar: LidarRig) -> dict[str, float | None]:
    """Collect the numbers of a measured LiDAR that are compared; without rings, it has no steps."""
    names = ["height_m", "pitch_deg", "roll_deg", "range_m"]
    step_deg = None
    if len(lidar.elevations_deg) > 1:
        names.append("azimuth_step_deg")
        step_deg = max(float(np.median(-np.diff(lidar.elevations_deg))), _LEAST_STEP_DEG)
    return {"ring_step_deg": step_deg, **{name: getattr(lidar, name) for name in names}}


@cache
def _trained_rigs() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(TRAINED_RIGS.read_text())
    return table
