"""Health along a sound drive, re-encoded and thinned: `python -m benchmarks.health_drive DRIVE`.

A row for each form of the drive: the limits that are chosen, alarms, median scores of camera,
LiDAR and alignment, and the median yaw. Takes some minutes.
"""

import statistics
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from benchmarks.sensor_health_scores import SENSORS
from sightline.corruptions.optics import CameraJpeg
from sightline.data.open import open_dataset
from sightline.health.monitor import HealthMonitor
from sightline.health.ring_order import number_rings
from sightline.health.sequence import DriveMonitor
from sightline.health.shipped import check_frames, choose_shipped
from sightline.health.sphere import to_sphere
from sightline.structures.sample import CameraLidarSample

_FORMS = ((None, 1), (92, 1), (85, 1), (None, 2), (None, 4), (95, 4))  # JPEG's quality, every ring
_EXAMINED = 15  # frames by which limits are chosen


def main(drive: Path, seed: int = 0) -> None:
    """Print the rows, then one line of JSON.

    Args:
        drive: Raw drive or recording of sound sensors, with PNG pictures and 64 beams.
        seed: Seed of the re-encoding, which draws nothing.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    dataset = open_dataset(drive, parts={"image", "points"})
    samples = [dataset[index] for index in range(len(dataset))]
    rows = []
    for quality, every_ring in _FORMS:
        changed = [_changed(each, quality, every_ring, seed) for each in samples]
        row = {"quality": quality, "every_ring": every_ring, **_watch(changed)}
        rows.append(row)
        print(row)
    print_record({"drive": drive.resolve().name, "rows": rows}, seed=seed)


def _changed(
    sample: CameraLidarSample, quality: int | None, every_ring: int, seed: int
) -> CameraLidarSample:
    if quality is not None:
        sample = CameraJpeg(quality=quality)(sample, np.random.default_rng(seed))
    if sample.points is None or every_ring == 1:
        return sample
    _, azimuth_deg, _ = to_sphere(sample.points.numpy())
    kept = torch.from_numpy(number_rings(azimuth_deg) % every_ring == 0)
    return replace(sample, points=sample.points[kept])


def _watch(samples: Sequence[CameraLidarSample]) -> dict[str, object]:
    places = np.linspace(0, len(samples) - 1, min(_EXAMINED, len(samples))).round().astype(int)
    chosen = choose_shipped(check_frames(samples[place] for place in places.tolist()))
    watch = DriveMonitor(HealthMonitor(chosen.limits))
    states = [watch(sample) for sample in samples]
    found = {name: [getattr(each.health, name) for each in states] for name in SENSORS}
    yaws_deg = [each.health.yaw_deg for each in states if each.health.yaw_deg is not None]
    return {
        "limits": f"{chosen.camera}; {chosen.lidar}",
        "alarms": {name: sum(getattr(each.alarms, name) for each in states) for name in SENSORS},
        "median_scores": {
            name: round(statistics.median(each.score for each in scores if each is not None), 2)
            for name, scores in found.items()
        },
        "yaw_deg": round(statistics.median(yaws_deg), 2),
    }


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
