"""Resident memory over many samples: `python -m benchmarks.flat_memory`.

The embedded frames, again and again, through the corruptions of a suite, one case after the other,
through the health monitor along a drive, and through the joined detectors with the fast weights, in
one process. Prints the resident memory after some samples and after many. Its last line is kept in
benchmarks/results/flat_memory.json.
"""

import gc
import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.corruptions.suites import find_suite
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.health.sequence import DriveMonitor
from sightline.joining.predictor import JoinedPredictor
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample

_PAGE_BYTES = 4096
_FAST_2D = "detection2d-fast-cpu"
_FAST_3D = "detection3d-fast-cpu"


def main(first: int = 200, samples: int = 2000, suite: str = "core", seed: int = 0) -> None:
    """Print a table, then one line of JSON.

    Args:
        first: Number of samples after which everything is loaded, compiled and cached.
        samples: Number of samples in all.
        suite: Name of the suite of corruptions.
        seed: Seed of the corruptions.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    dataset = KittiObjectDataset(PACKAGED_FRAMES)
    monitor = DriveMonitor()
    cases = itertools.cycle(find_suite(suite).cases)

    def corrupt(sample: CameraLidarSample) -> None:
        next(cases).corrupt(sample, seed)

    def judge(sample: CameraLidarSample) -> None:
        monitor(sample)

    joined = JoinedPredictor.load(detection2d=_FAST_2D, detection3d=_FAST_3D, engine="openvino")

    def join(sample: CameraLidarSample) -> None:
        joined(next(cases).corrupt(sample, seed).sample)

    works: dict[str, Callable[[CameraLidarSample], None]] = {
        "corruptions": corrupt,
        "health": judge,
        "joined": join,
    }
    results = []
    for name, work in works.items():
        sizes = {}
        for number in range(samples):
            frame = dataset[number % len(dataset)]
            work(replace(frame, sample_id=f"{number:06d}"))  # each draws another fault
            if number + 1 in (first, samples):
                gc.collect()
                sizes[number + 1] = round(_resident_mib(), 1)
        sizes_text = ", ".join(f"{size:.0f} MiB after {number:,}" for number, size in sizes.items())
        print(f"{name:<12} {sizes_text}")
        results.append({"work": name, "resident_mib": sizes})
    weights = (_FAST_2D, _FAST_3D)
    print_record({"suite": suite, "results": results}, seed=seed, weights=weights)


def _resident_mib() -> float:
    """Resident memory of this process [MiB]; Linux only."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * _PAGE_BYTES / 2**20


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
