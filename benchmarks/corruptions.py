"""Time of the cases of suites: `python -m benchmarks.corruptions`.

A simulated frame of KITTI's size with a whole turn of the LiDAR, one thread, processor time. Each
repeat has another seed, to draw boxes and discs of all sizes. In a suite with severities a row is a
kind, by its slowest severity. The last line is kept in
benchmarks/results/corruptions.json.
"""

import statistics
import time
from dataclasses import replace
from typing import Any

import cv2
import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.corruptions.suites import Case, find_suite
from sightline.simulation.dataset import sample_of
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from sightline.structures.sample import CameraLidarSample

_SEED = 7
_LIMIT_MS = 60.0  # that a kind may take


def main(repeats: int = 10, suites: tuple[str, ...] = ("dgfn7", "all")) -> None:
    """Print a table, then one line of JSON.

    Args:
        repeats: Timed calls of each case, after one to warm up.
        suites: Names of the suites.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    # Without true depth, as recordings are: weather must find distances in the sweep.
    sample = replace(sample_of(simulate_frame(SimulationConfig(seed=_SEED), 0)), depth=None)
    assert sample.points is not None, "a simulated sample has a sweep"
    results: list[dict[str, Any]] = []
    for suite in map(find_suite, suites):
        rows: dict[str, dict[str, Any]] = {}
        for case in suite.cases:
            case.corrupt(sample, repeats)
            times = [_milliseconds(case, sample, seed) for seed in range(repeats)]
            median_ms = round(statistics.median(times), 2)
            name = case.name if case.severity is None else case.kind
            if name not in rows or median_ms > rows[name]["median_ms"]:
                timed = {"median_ms": median_ms, "max_ms": round(max(times), 2)}
                rows[name] = {"suite": suite.name, "case": case.name, **timed}
        for row in rows.values():
            mark = "" if row["median_ms"] <= _LIMIT_MS else "  above the limit"
            print(
                "{suite:<8} {case:<24} {median_ms:8.2f} ms  (largest {max_ms})".format(**row) + mark
            )
        results += rows.values()
    setting = {"image": sample.image_size, "points": len(sample.points), "repeats": repeats}
    print_record({**setting, "results": results}, seed=_SEED)


def _milliseconds(case: Case, sample: CameraLidarSample, seed: int) -> float:
    start = time.process_time()
    case.corrupt(sample, seed)
    return (time.process_time() - start) * 1e3


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
