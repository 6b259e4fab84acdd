"""Scores of the health monitor: `python -m benchmarks.sensor_health KITTI SCORES`.

For each case of a suite the area under the ROC curve of the scores, against the same frames clean,
over the frames that the case broke: of the sensors that it breaks, and of the worst score of camera
and LiDAR. Misalignments by single frames and by five together that share the fault. Then false
alarms of single clean frames, the error of the yaw estimate, the time of a frame; with `--drive`,
the delay of alarms after faults begin along that drive; with `--sound_drive`, alarms along a drive
of sound sensors. SCORES stores the checks' values, so that a stopped run can be resumed, shards can
run at the same time, and other limits need no new run. 60 frames of suite
core take about 5 minutes of one core. Its last line is kept in
benchmarks/results/sensor_health.json.
"""

import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from benchmarks.sensor_health_drives import delays, false_alarms
from benchmarks.sensor_health_scores import (
    CHECKS,
    SENSORS,
    TOGETHER,
    ScoreJob,
    is_misalignment,
    judge,
)
from sightline.corruptions.kinds import SEVERITIES
from sightline.corruptions.suites import CLEAN, Case, find_suite
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.evaluation.auroc import auroc_of_values
from sightline.health.limits import SHIPPED, HealthLimits, read_limits
from sightline.health.monitor import HealthMonitor
from sightline.jobs.output_dirs import acquire_output_dir
from sightline.jobs.run import shard
from sightline.structures.health import ALARM_SCORE, Health

_PARTS: frozenset[Part] = frozenset({"image", "points", "objects"})
_TIMED = 10  # frames
Scores = dict[str, Health]


def main(
    data: Path,
    scores: Path,
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne",
    frames: int = 60,
    suite: str = "core",
    cases: tuple[str, ...] | None = None,
    limits: Path = SHIPPED,
    drive: Path | None = None,
    onset: int = 20,
    drive_severity: int = 3,
    sound_drive: Path | None = None,
    seed: int = 0,
    shard_index: int = 0,
    num_shards: int = 1,
) -> None:
    """Print tables, then one line of JSON.

    Args:
        data: KITTI object tree or raw drive.
        scores: Folder for the checks' values.
        sample_list: List of frames.
        velodyne: Folder of the sweeps in an object tree.
        frames: Number of frames, evenly spaced.
        suite: Name of the suite.
        cases: Names of cases; default: all.
        limits: Limits file of the monitor.
        drive: Drive in which faults begin.
        onset: Number of frames of the drive before the fault.
        drive_severity: Severity of these faults.
        sound_drive: Drive of sound sensors, for false alarms.
        seed: Seed of the corruptions and the turns.
        shard_index: Index of the part of the frames to score.
        num_shards: Number of parts; with more than one, no table is printed.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    monitor = HealthMonitor(read_limits(limits))
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=_PARTS)
    spread = np.linspace(0, len(dataset) - 1, min(frames, len(dataset)))
    places: list[int] = np.unique(spread.astype(int)).tolist()
    known = find_suite(suite)
    chosen = [case for case in known.select(cases or known.case_names) if case.name != CLEAN]
    setting: dict[str, object] = {
        "data": data.resolve().name,
        "sample_list": sample_list,
        "frames": len(places),
        "suite": suite,
        "cases": [case.name for case in chosen],
        "checks": CHECKS,
        "seed": seed,
    }
    acquire_output_dir(scores, setting, results=("[0-9]*.json",))
    job = ScoreJob(dataset=dataset, cases=chosen, seed=seed)
    groups = [places[first : first + TOGETHER] for first in range(0, len(places), TOGETHER)]
    found = [
        job.group(group, scores / f"{int(group[0]):06d}.json")
        for group in shard(groups, shard_index, num_shards)
    ]
    if num_shards > 1:
        return
    result: dict[str, object] = {
        **{name: setting[name] for name in ("data", "sample_list", "frames", "suite")},
        "limits": dict(monitor.limits.provenance),
        "median_ms": _median_ms(dataset, monitor, places),
        **_tables(found, chosen, monitor.limits),
    }
    if drive is not None:
        faults = [
            case
            for case in chosen
            if case.severity in (None, _drive_severity(case, drive_severity))
        ]
        moving = open_dataset(drive, parts=_PARTS)
        result["delays"] = rows = delays(moving, monitor, faults, onset, seed)
        print(f"\n{drive.name}, {len(moving)} frames, fault from frame {onset}:")
        for row in rows:
            delay = row["delay_frames"]
            print(f"{row['case']:<28} {'not raised' if delay is None else f'{delay} frames'}")
    if sound_drive is not None:
        result["sound_drive"] = sound = false_alarms(
            open_dataset(sound_drive, parts=_PARTS), monitor
        )
        print(f"\n{sound_drive.name}, sound: {sound}")
    print_record(result, seed=seed)


def _drive_severity(case: Case, severity: int) -> int:
    """Choose the severity along the drive; below the greatest, blanks lose frames by chance."""
    return SEVERITIES[-1] if case.kind.endswith("_blank") else severity


def _median_ms(dataset: SampleDataset, monitor: HealthMonitor, places: Sequence[int]) -> float:
    """Measure the processor time of a frame in one thread."""
    times = []
    for place in places[: _TIMED + 1]:  # the first one compiles
        sample = dataset[int(place)]
        start = time.process_time()
        monitor(sample)
        times.append((time.process_time() - start) * 1e3)
    median = round(statistics.median(times[1:] or times), 1)
    print(f"median {median} ms a frame, processor time")
    return median


def _tables(
    groups: Sequence[Mapping[str, Any]], cases: Sequence[Case], limits: HealthLimits
) -> dict[str, object]:
    frames = [frame for group in groups for frame in group["frames"]]
    clean = [judge(limits, frame["clean"]) for frame in frames]
    shares = {name: float((-_badness(clean, (name,)) < ALARM_SCORE).mean()) for name in SENSORS}
    rates = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
    print(f"{len(frames)} frames; false alarms of single clean ones: {rates}")
    print(f"{'case':<28} {'frames':>6} {'own':>6} {'any':>6} {'alarms':>7} {'5 tog.':>7}  worst")
    rows = []
    for case in cases:
        named = [
            (clean_scores, judge(limits, frame["broken"][case.name]))
            for clean_scores, frame in zip(clean, frames, strict=True)
            if case.name in frame["broken"]
        ]
        together = [
            {name: judge(limits, each) for name, each in group["together"].items()}
            for group in groups
        ]
        row = _row(case, clean, named, together)
        rows.append(row)
        numbers = (f"{_number_text(row[name]):>7}" for name in ("own", "any", "alarms", "together"))
        print(f"{case.name:<28} {row['frames']:>6}{''.join(numbers)}  {row['worst_check']}")
    return {"false_alarms": shares, "cases": rows, "yaw": _yaw_errors(groups)}


def _number_text(number: float | None) -> str:
    return "-" if number is None else f"{number:.3f}"


def _row(
    case: Case,
    clean: Sequence[Scores],
    pairs: Sequence[tuple[Scores, Scores]],
    together: Sequence[Mapping[str, Scores]],
) -> dict[str, Any]:
    """Score one case.

    Args:
        case: Case to score.
        clean: Scores of all clean frames.
        pairs: Scores of the frames that the case breaks, clean and broken.
        together: Scores of groups of frames, clean (`CLEAN`) and misaligned.
    """
    broken = [sound | each for sound, each in pairs]
    own = ("alignment",) if is_misalignment(case) else case.corruption.sensors
    columns = {"own": own, "any": (*own, "camera", "lidar")}
    row: dict[str, Any] = {"case": case.name, "severity": case.severity, "frames": len(broken)}
    for column, names in columns.items():
        row[column] = auroc_of_values(_badness(broken, names), _badness(clean, names))
    alarms = -_badness(broken, own) < ALARM_SCORE
    row["alarms"] = float(alarms.mean()) if len(alarms) else None
    row["together"] = None
    if is_misalignment(case):
        both = ([each[name] for each in together] for name in (case.name, CLEAN))
        row["together"] = auroc_of_values(*(_badness(each, own) for each in both))
    worst = [min(each.items(), key=lambda item: item[1].score)[1].worst_check for _, each in pairs]
    row["worst_check"] = statistics.mode(worst) if worst else "-"
    return row


def _badness(
    scores: Sequence[Scores], names: Sequence[str]
) -> "np.ndarray[Any, np.dtype[np.float64]]":
    """Negate the worst of these scores; a score that is missing counts as sound."""
    return -np.array(
        [min(each[name].score if name in each else 1.0 for name in names) for each in scores], float
    )


def _yaw_errors(groups: Sequence[Mapping[str, Any]]) -> dict[str, object]:
    """Errors of the estimated turns [degrees], also less the data's own turn."""
    yaws = [group["yaw"] for group in groups]
    own_deg = float(np.nanmedian([each["unturned_deg"] for each in yaws]))
    single = [e - each["turn_deg"] for each in yaws for e in each["single_deg"]]
    together = [each["together_deg"] - each["turn_deg"] for each in yaws]
    rows = {}
    print(f"\nyaw of the unrotated data {own_deg:+.3f} deg; errors, median / 90 %:")
    for name, errors in (("1", single), (f"{TOGETHER}", together)):
        known = np.array(errors)[~np.isnan(errors)]
        row = [
            float(np.quantile(np.abs(known - own), share))
            for own in (0.0, own_deg)
            for share in (0.5, 0.9)
        ]
        print(f"{name} together: {row[0]:.3f} / {row[1]:.3f}; less it {row[2]:.3f} / {row[3]:.3f}")
        rows[name] = row
    return {"own_deg": own_deg, "errors_deg": rows}


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
