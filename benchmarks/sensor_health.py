"""Measures the health monitor: `python -m benchmarks.sensor_health KITTI`.

For each case of a suite the area under the ROC curve of the scores, against the same frames clean:
of the sensors that the case breaks, and of the worst score that a sample has. Then false alarms of
single clean frames, drives whose fault sets in, and the time of a frame. With `--drive`, alarms on
a drive of sound sensors, too. Its last line is kept in benchmarks/results/sensor_health.json.
"""

import copy
import json
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch

from benchmarks.machine import describe_machine
from sightline.corruptions.suites import CLEAN, Case, find_suite
from sightline.data.object_tree import Velodyne
from sightline.data.open import SampleDataset, open_dataset
from sightline.evaluation.auroc import auroc_of_values
from sightline.health.limits import SHIPPED, read_limits
from sightline.health.monitor import HealthMonitor
from sightline.health.sequence import DriveMonitor
from sightline.structures.health import ALARM_SCORE, SampleHealth
from sightline.structures.sample import CameraLidarSample

_SENSORS = ("camera", "lidar", "alignment")
_LONGEST_DELAY = 20  # frames, after which an alarm is taken never to come


def main(
    data: Path,
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne",
    frames: int = 100,
    suite: str = "dgfn7",
    cases: tuple[str, ...] | None = None,
    limits: Path = SHIPPED,
    drive: Path | None = None,
    onset: int = 20,
    seed: int = 0,
) -> None:
    """Prints tables, then one line of JSON.

    Args:
        data: KITTI object tree or raw drive.
        sample_list: Which frames.
        velodyne: Folder of the sweeps in an object tree.
        frames: How many of them, evenly spaced.
        suite: Whose cases are told from clean frames.
        cases: Which of them. Default: all.
        limits: What is usual of the sensors.
        drive: A drive, or another tree whose frames follow each other, in which faults set in.
        onset: Frames of the drive before the fault.
        seed: Of the corruptions.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    monitor = HealthMonitor(read_limits(limits))
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts={"image", "points", "objects"}
    )
    places = np.unique(np.linspace(0, len(dataset) - 1, min(frames, len(dataset))).astype(int))
    known = find_suite(suite)
    chosen = [case for case in known.select(cases or known.case_names) if case.name != CLEAN]
    clean, broken, times = _judge_all(monitor, dataset, places, chosen, seed)
    false_alarms = {name: _share_of_alarms(clean, name) for name in (*_SENSORS, "any")}
    print(f"{len(clean)} frames; false alarms of single ones: {_percents(false_alarms)}")
    print(f"median {statistics.median(times):.1f} ms a frame, processor time")
    rows = [_row(case, clean, broken[case.name]) for case in chosen]
    print(f"{'case':<28} {'own':>6} {'any':>6} {'alarms':>7}  worst check")
    for row in rows:
        print("{case:<28} {auroc:6.3f} {auroc_any:6.3f} {alarms:7.2f}  {worst_check}".format(**row))
    answer: dict[str, object] = {
        "machine": describe_machine(),
        "data": data.name,
        "frames": len(clean),
        "suite": suite,
        "limits": dict(monitor.limits.provenance),
        "median_ms": round(statistics.median(times), 1),
        "false_alarms": false_alarms,
        "results": rows,
    }
    if drive is not None:
        answer["drive"] = _drive_rows(
            open_dataset(drive, velodyne=velodyne, parts={"image", "points", "objects"}),
            monitor,
            chosen,
            onset,
            seed,
        )
    print(json.dumps(answer))


def _judge_all(
    monitor: HealthMonitor,
    dataset: SampleDataset,
    places: Sequence[int],
    cases: Sequence[Case],
    seed: int,
) -> tuple[list[SampleHealth], dict[str, list[SampleHealth]], list[float]]:
    clean: list[SampleHealth] = []
    broken: dict[str, list[SampleHealth]] = {case.name: [] for case in cases}
    times = []
    for place in places:
        sample = dataset[int(place)]
        start = time.process_time()
        clean.append(monitor(sample))
        times.append((time.process_time() - start) * 1e3)
        for case in cases:
            broken[case.name].append(monitor(case.corrupt(sample, seed).sample))
    return clean, broken, times


def _scores(healths: Sequence[SampleHealth], name: str) -> list[float]:
    """Of a sensor; where it cannot be told, as of nothing wrong."""
    if name == "any":
        return [health.worst_score for health in healths]
    found = (getattr(health, name) for health in healths)
    return [1.0 if each is None else each.score for each in found]


def _share_of_alarms(healths: Sequence[SampleHealth], name: str) -> float:
    return float(np.mean(np.array(_scores(healths, name)) < ALARM_SCORE))


def _own(case: Case) -> str:
    """What a case is a fault of: one sensor, or how both lie or see together."""
    sensors = case.corruption.sensors
    is_alignment = case.name.startswith("misalignment")
    return "alignment" if is_alignment else sensors[0] if len(sensors) == 1 else "any"


def _row(
    case: Case, clean: Sequence[SampleHealth], broken: Sequence[SampleHealth]
) -> dict[str, object]:
    own = _own(case)
    badness = {
        name: (-np.array(_scores(broken, name)), -np.array(_scores(clean, name)))
        for name in (own, "any")
    }
    worst = [
        min((each for each in (h.camera, h.lidar, h.alignment) if each), key=lambda e: e.score)
        for h in broken
    ]
    return {
        "case": case.name,
        "severity": getattr(case, "severity", None),
        "sensor": own,
        "auroc": auroc_of_values(*badness[own]),
        "auroc_any": auroc_of_values(*badness["any"]),
        "alarms": _share_of_alarms(broken, own),
        "worst_check": statistics.mode(each.worst_check for each in worst),
    }


def _drive_rows(
    drive: SampleDataset, monitor: HealthMonitor, cases: Sequence[Case], onset: int, seed: int
) -> dict[str, object]:
    """False alarms along the drive, and for each case after how many frames the alarm is raised."""
    samples = [drive[index] for index in range(len(drive))]
    sound = DriveMonitor(monitor)
    states = [sound(sample) for sample in samples]
    alarms = {
        name: sum(getattr(state.alarms, name) for state in states) / len(states)
        for name in _SENSORS
    }
    at_onset = DriveMonitor(monitor)
    for sample in samples[:onset]:
        at_onset(sample)
    yaws = [state.health.yaw_deg for state in states if state.health.yaw_deg is not None]
    print(f"\ndrive of {len(samples)} frames; alarms of sound sensors: {_percents(alarms)}")
    rows = []
    for case in cases:
        delay = _delay(copy.deepcopy(at_onset), samples[onset:], case, seed)
        print(f"{case.name:<28} {'not raised' if delay is None else f'{delay} frames'}")
        rows.append({"case": case.name, "delay_frames": delay})
    return {
        "frames": len(samples),
        "onset": onset,
        "alarms": alarms,
        "yaw_deg": statistics.median(yaws) if yaws else None,
        "delays": rows,
    }


def _delay(
    watch: DriveMonitor, samples: Sequence[CameraLidarSample], case: Case, seed: int
) -> int | None:
    """Frames from the first faulty one to a new alarm of what the case breaks; 0: that very one.

    Args:
        watch: That has seen the frames before the fault.
        samples: From the fault on.
        case: What it is.
        seed: Of what is drawn.
    """
    own = _own(case)
    names = _SENSORS if own == "any" else (own,)
    before = {name: getattr(watch.alarms, name) for name in names}
    for number, sample in enumerate(samples[:_LONGEST_DELAY]):
        alarms = watch(case.corrupt(_named(sample, samples[0]), seed).sample).alarms
        if any(getattr(alarms, name) and not before[name] for name in names):
            return number
    return None


def _named(sample: CameraLidarSample, first: CameraLidarSample) -> CameraLidarSample:
    """Under the name of the fault's first frame: what is drawn stays the same along the drive."""
    return replace(sample, sample_id=first.sample_id)


def _percents(shares: dict[str, float]) -> str:
    return ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
