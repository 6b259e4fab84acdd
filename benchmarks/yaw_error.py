"""Errors of the estimated yaw between the sensors: `python -m benchmarks.yaw_error KITTI`.

Groups of frames are rotated by known angles; errors are relative to these. The data's own
calibration may have an error, too: so they are also given relative to the known rotation
plus the estimate of all unrotated frames together. Its last line is kept in
benchmarks/results/yaw_error.json.
"""

import statistics
import time
from collections.abc import Sequence
from functools import reduce
from operator import add
from pathlib import Path

import cv2
import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.health.yaw_error import LARGEST_DEG, EdgeMatch, estimate_yaw, match_edges
from sightline.structures.sample import CameraLidarSample


def main(
    data: Path,
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne",
    frames: int = 100,
    groups: int = 60,
    sizes: tuple[int, ...] = (1, 5, 20),
    *,
    in_a_row: bool = False,
    seed: int = 0,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        data: KITTI object tree or raw drive.
        sample_list: List of frames.
        velodyne: Folder of the sweeps in an object tree.
        frames: Number of frames, evenly spaced.
        groups: Number of estimates for each size.
        sizes: Numbers of frames in an estimate.
        in_a_row: Whether an estimate's frames follow each other, as in a drive, or are drawn.
        seed: Seed of angles and groups.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts={"image", "points"}
    )
    places = np.unique(np.linspace(0, len(dataset) - 1, min(frames, len(dataset))).astype(int))
    samples = [dataset[int(place)] for place in places]
    match_edges(samples[0])  # compiles
    start = time.process_time()
    unturned = [match for sample in samples if (match := match_edges(sample)) is not None]
    milliseconds = (time.process_time() - start) * 1e3 / len(samples)
    own_deg = estimate_yaw(reduce(add, unturned)).yaw_deg
    print(f"{len(samples)} frames, {milliseconds:.1f} ms each; together {own_deg:+.3f} deg")
    rng = np.random.default_rng(seed)
    results = []
    for size in sizes:
        errors = []
        for _ in range(groups):
            chosen = _group(samples, size, rng, in_a_row=in_a_row)
            turn_deg = float(rng.uniform(-LARGEST_DEG, LARGEST_DEG))
            match = _match_turned(chosen, turn_deg)
            if match is not None:
                errors.append(estimate_yaw(match).yaw_deg - turn_deg)
        row = {"frames": size, "estimates": len(errors), **_statistics(np.array(errors), own_deg)}
        print(
            "{frames:>3} frames: median {median_deg:.3f}, 90 % {p90_deg:.3f} deg; bias "
            "{bias_deg:+.3f}; against the data's own turn {own_median_deg:.3f}, "
            "{own_p90_deg:.3f}".format(**row)
        )
        results.append(row)
    setting = {
        "data": data.name,
        "frames": len(samples),
        "in_a_row": in_a_row,
        "own_deg": round(own_deg, 4),
        "ms": round(milliseconds, 1),
        "edges": statistics.median(match.num_edges for match in unturned),
    }
    print_record({**setting, "results": results}, seed=seed)


def _group(
    samples: Sequence[CameraLidarSample], size: int, rng: np.random.Generator, *, in_a_row: bool
) -> list[CameraLidarSample]:
    if in_a_row:
        first = int(rng.integers(len(samples) - size + 1))
        return list(samples[first : first + size])
    drawn = rng.choice(len(samples), size=size, replace=False)
    return [samples[int(number)] for number in drawn]


def _match_turned(samples: Sequence[CameraLidarSample], turn_deg: float) -> EdgeMatch | None:
    matches = [match_edges(rotate_extrinsics(sample, turn_deg)) for sample in samples]
    found = [match for match in matches if match is not None]
    return reduce(add, found) if found else None


def _statistics(errors: "np.ndarray", own_deg: float) -> dict[str, float]:
    own = np.abs(errors - own_deg)
    return {
        "median_deg": float(np.median(np.abs(errors))),
        "p90_deg": float(np.quantile(np.abs(errors), 0.9)),
        "bias_deg": float(np.median(errors)),
        "own_median_deg": float(np.median(own)),
        "own_p90_deg": float(np.quantile(own, 0.9)),
    }


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
