"""Scores of the health monitor on clean and broken frames, kept group by group."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

from sightline.corruptions.suites import Case
from sightline.data.atomic import atomic_write_text
from sightline.data.augmentation import rotate_extrinsics
from sightline.data.open import SampleDataset
from sightline.health.alignment_checks import check_alignment
from sightline.health.camera_checks import check_camera
from sightline.health.lidar_checks import check_lidar
from sightline.health.monitor import HealthMonitor, rgb_of
from sightline.health.yaw_error import LARGEST_DEG, EdgeMatch, estimate_yaw, match_edges
from sightline.structures.health import Health
from sightline.structures.sample import CameraLidarSample

TOGETHER = 5
"""Frames whose edges are matched together: they meet the same misalignment."""
Scores = dict[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoreJob:
    """What is scored, and by what."""

    dataset: SampleDataset
    monitor: HealthMonitor
    cases: Sequence[Case]
    seed: int

    def group(self, places: Sequence[int], path: Path) -> Mapping[str, object]:
        """The scores of some frames, read from the file where it is there, else written to it."""
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
        limits = self.monitor.limits
        clean = self.monitor(sample)
        whole = {"camera": clean.camera.score, "lidar": clean.lidar.score}
        alignment = 1.0 if clean.alignment is None else clean.alignment.score
        broken: dict[str, object] = {}
        for case in self.cases:
            found = case.corrupt(sample, self.seed)
            if not (found.camera_mask.any() or found.lidar_mask.any()):
                continue  # a frame that this fault left alone
            judged: dict[str, Health] = {}
            if is_misalignment(case):
                match = match_edges(found.sample)
                if match is not None:
                    judged["alignment"] = limits.alignment.judge(check_alignment(match))
            if "camera" in case.corruption.sensors:
                image = rgb_of(found.sample)
                assert image is not None, "no kind takes the image away"
                judged["camera"] = limits.camera.judge(check_camera(image))
            if "lidar" in case.corruption.sensors:
                assert found.sample.points is not None, "no kind takes the sweep away"
                judged["lidar"] = limits.lidar.judge(check_lidar(found.sample.points.numpy()))
            worst = min(judged.values(), key=lambda each: each.score)
            scores = {name: each.score for name, each in judged.items()}
            broken[case.name] = {**whole, **scores, "worst_check": worst.worst_check}
        return {"clean": {**whole, "alignment": alignment}, "broken": broken}

    def _together(self, samples: Sequence[CameraLidarSample]) -> Scores:
        """Of the alignment, by the edges of all of them; a fault is drawn once for all."""
        scores = {"clean": self._alignment(samples)}
        for case in self.cases:
            if is_misalignment(case):
                named = [replace(each, sample_id=samples[0].sample_id) for each in samples]
                broken = [case.corrupt(each, self.seed).sample for each in named]
                scores[case.name] = self._alignment(broken)
        return scores

    def _alignment(self, samples: Sequence[CameraLidarSample]) -> float:
        match = _matched(samples)
        if match is None:
            return 1.0
        return self.monitor.limits.alignment.judge(check_alignment(match)).score

    def _yaw(
        self, samples: Sequence[CameraLidarSample], rng: np.random.Generator
    ) -> dict[str, object]:
        """Estimates [degrees] where the LiDAR was turned by a known angle, and unturned ones."""
        turn_deg = float(rng.uniform(-LARGEST_DEG, LARGEST_DEG))
        turned = [rotate_extrinsics(sample, turn_deg) for sample in samples]
        return {
            "turn_deg": turn_deg,
            "single_deg": [_yaw_of([each]) for each in turned],
            "together_deg": _yaw_of(turned),
            "unturned_deg": _yaw_of(samples),
        }


def is_misalignment(case: Case) -> bool:
    """Whether a case is a fault of how camera and LiDAR lie to each other."""
    return case.kind.startswith("misalignment")


def _matched(samples: Sequence[CameraLidarSample]) -> EdgeMatch | None:
    known = [match for each in samples if (match := match_edges(each)) is not None]
    return reduce(add, known) if known else None


def _yaw_of(samples: Sequence[CameraLidarSample]) -> float:
    match = _matched(samples)
    return math.nan if match is None else estimate_yaw(match).yaw_deg
