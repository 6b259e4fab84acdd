"""Health monitor along drives: false alarms, and delay of alarms."""

import copy
import statistics
from collections.abc import Sequence
from dataclasses import replace

from benchmarks.sensor_health_scores import SENSORS, is_misalignment
from sightline.corruptions.suites import Case
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.health.monitor import HealthMonitor
from sightline.health.sequence import DriveMonitor
from sightline.structures.sample import CameraLidarSample

_LONGEST_DELAY = 20  # frames after which an alarm counts as not raised


def false_alarms(drive: SampleDataset, monitor: HealthMonitor) -> dict[str, object]:
    """Measure a drive of sound sensors: shares of the frames with an alarm, and the yaw."""
    watch = DriveMonitor(monitor)
    states = [watch(drive[index]) for index in range(len(drive))]
    yaws = [state.health.yaw_deg for state in states if state.health.yaw_deg is not None]
    return {
        "frames": len(states),
        "alarms": {
            name: sum(getattr(state.alarms, name) for state in states) / len(states)
            for name in SENSORS
        },
        "yaw_deg": statistics.median(yaws) if yaws else None,
    }


def delays(
    drive: SampleDataset, monitor: HealthMonitor, cases: Sequence[Case], onset: int, seed: int
) -> list[dict[str, object]]:
    """Measure each case's delay: frames from its begin to its alarm.

    None: no alarm within 20 frames. 0: alarm at the first faulty frame.
    """
    samples = [drive[index] for index in range(len(drive))]
    at_onset = DriveMonitor(monitor)
    for sample in samples[:onset]:
        at_onset(sample)
    return [
        {
            "case": case.name,
            "delay_frames": _delay(copy.deepcopy(at_onset), samples[onset:], case, seed),
        }
        for case in cases
    ]


def _delay(
    watch: DriveMonitor, samples: Sequence[CameraLidarSample], case: Case, seed: int
) -> int | None:
    """Count the frames from the first faulty one to a new alarm of a sensor that the case breaks.

    For misalignment any alarm counts: the LiDAR's own checks notice an older sweep.

    Args:
        watch: Monitor that has seen the frames before the fault.
        samples: Samples from the fault on.
        case: Case of the fault.
        seed: Seed of the random draws.
    """
    names = SENSORS if is_misalignment(case) else case.corruption.sensors
    before = watch.alarms
    for number, sample in enumerate(samples[:_LONGEST_DELAY]):
        # With one name, random draws stay the same along the drive.
        named = replace(sample, sample_id=samples[0].sample_id)
        alarms = watch(case.corrupt(named, seed).sample).alarms
        if any(getattr(alarms, name) and not getattr(before, name) for name in names):
            return number
    return None
