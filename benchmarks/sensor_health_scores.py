"""Values of the health monitor's checks on clean and broken frames, kept group by group."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.corruptions.suites import Case
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.files.atomic import atomic_write_text
from sightline.health.alignment_checks import AlignmentChecks, check_alignment
from sightline.health.camera_checks import CameraChecks, check_camera
from sightline.health.lidar_checks import LidarChecks, check_lidar
from sightline.health.limits import HealthLimits
from sightline.health.monitor import rgb_of
from sightline.health.yaw_error import LARGEST_DEG, EdgeMatch, estimate_yaw, match_edges
from sightline.structures.health import Health
from sightline.structures.sample import CameraLidarSample

SENSORS = ("camera", "lidar", "alignment")
TOGETHER = 5
"""Number of frames matched together; they share one misalignment."""
CHECKS = {
    "camera": CameraChecks._fields,
    "lidar": LidarChecks._fields,
    "alignment": AlignmentChecks._fields,
}
Found = dict[str, list[float]]
"""Values of the checks, by sensor."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoreJob:
    """Frames and cases to judge."""

    dataset: SampleDataset
    cases: Sequence[Case]
    seed: int

    def group(self, places: Sequence[int], path: Path) -> Mapping[str, object]:
        """Read the values of some frames from their file, or compute and write them."""
        if path.exists():
            kept: dict[str, object] = json.loads(path.read_text())
            return kept
        samples = [self.dataset[int(place)] for place in places]
        found = {
            "frames": [self._frame(sample) for sample in samples],
            "together": self._together(samples),
            "yaw": self._yaw(samples, np.random.default_rng([self.seed, int(places[0])])),
        }
        atomic_write_text(path, json.dumps(found) + "\n")
        return found

    def _frame(self, sample: CameraLidarSample) -> dict[str, object]:
        broken = {}
        for case in self.cases:
            found = case.corrupt(sample, self.seed)
            if found.camera_mask.any() or found.lidar_mask.any():  # else it was left alone
                checked_sensors: set[str] = {*case.corruption.sensors}
                if is_misalignment(case):
                    checked_sensors.add("alignment")
                broken[case.name] = _check_sensors(found.sample, checked_sensors)
        return {"clean": _check_sensors(sample, {*SENSORS}), "broken": broken}

    def _together(self, samples: Sequence[CameraLidarSample]) -> dict[str, Found]:
        """Judge the alignment by the edges of all frames; a fault is drawn once for all."""
        found = {"clean": _alignment(samples)}
        for case in self.cases:
            if is_misalignment(case):
                named = [replace(each, sample_id=samples[0].sample_id) for each in samples]
                broken = [case.corrupt(each, self.seed).sample for each in named]
                found[case.name] = _alignment(broken)
        return found

    def _yaw(
        self, samples: Sequence[CameraLidarSample], rng: np.random.Generator
    ) -> dict[str, object]:
        """Estimate the yaw [degrees] with the LiDAR turned by a known angle, and unturned."""
        turn_deg = float(rng.uniform(-LARGEST_DEG, LARGEST_DEG))
        turned = [rotate_extrinsics(sample, turn_deg) for sample in samples]
        return {
            "turn_deg": turn_deg,
            "single_deg": [_yaw_of([each]) for each in turned],
            "together_deg": _yaw_of(turned),
            "unturned_deg": _yaw_of(samples),
        }


def judge(limits: HealthLimits, found: Found) -> dict[str, Health]:
    """Judge the health of each checked sensor."""
    makers = {"camera": CameraChecks, "lidar": LidarChecks, "alignment": AlignmentChecks}
    return {
        name: getattr(limits, name).judge(makers[name](*values)) for name, values in found.items()
    }


def _check_sensors(sample: CameraLidarSample, sensors: set[str]) -> Found:
    found: Found = {}
    image, points = rgb_of(sample), sample.points
    if "camera" in sensors and image is not None:
        found["camera"] = list(check_camera(image))
    if "lidar" in sensors and points is not None:
        found["lidar"] = list(check_lidar(points.numpy()))
    return found | (_alignment([sample]) if "alignment" in sensors else {})


def _alignment(samples: Sequence[CameraLidarSample]) -> Found:
    match = _matched(samples)
    return {} if match is None else {"alignment": list(check_alignment(match))}


def is_misalignment(case: Case) -> bool:
    """Check that a case misaligns camera and LiDAR."""
    return case.kind.startswith("misalignment")


def _matched(samples: Sequence[CameraLidarSample]) -> EdgeMatch | None:
    matches = [match for each in samples if (match := match_edges(each)) is not None]
    return reduce(add, matches) if matches else None


def _yaw_of(samples: Sequence[CameraLidarSample]) -> float:
    match = _matched(samples)
    return math.nan if match is None else estimate_yaw(match).yaw_deg
