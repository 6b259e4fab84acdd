"""Fusion with learned gates less fusion without: AP of several seeds with paired intervals.

`python -m benchmarks.gated_fusion_ablation RESULTS LABELS --sample_list LIST`. RESULTS has a folder
NAME-SEED of `sightline reproduce gated-fusion --out` for each trained network. In each case of the
paper and in their mean ("full"), AP is averaged over the seeds; the frames are resampled, the same
for all networks, seeds and cases, which gives the interval of the difference. Its last line is kept
in benchmarks/results/gated_fusion_ablation_LIST.json.
"""

import re
import statistics
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse
import numpy as np
from numpy import ndarray

from benchmarks.record import print_record
from sightline.corruptions.suites import find_suite
from sightline.evaluation.bootstrap import PERCENTILES, draw_frames
from sightline.evaluation.kitti_object import frame_names, read_frames
from sightline.evaluation.kitti_object_matching import index_pairs, select
from sightline.evaluation.kitti_object_pairs import find_pairs
from sightline.evaluation.kitti_object_resampling import ResampledCurve
from sightline.evaluation.kitti_object_rules import CLASSES, ClassOverlaps, MinimumOverlaps

FULL: Final = "full"
MODERATE: Final = 1
SCORES: Final = (("Car", 0.7), ("Car", 0.5), ("Pedestrian", 0.5), ("Cyclist", 0.5))
"""Class and IoU in the image; moderate objects."""
_LOWEST: Final = MinimumOverlaps(
    car=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5),
    pedestrian=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5),
    cyclist=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5),
)


class Run(NamedTuple):
    """Result files of one trained network."""

    name: str
    seed: int
    folder: Path
    """Its folder with one folder for each case."""


def main(
    results: Path,
    labels: Path,
    sample_list: Path | None = None,
    names: Sequence[str] = ("gated", "ones"),
    resamples: int = 1000,
    workers: int = 2,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        results: Folder of the networks' result files.
        labels: Folder of KITTI's label files.
        sample_list: Text file with one frame's name a line. None: all with labels.
        names: The two networks; the second is subtracted from the first.
        resamples: Number of resamples of the frames.
        workers: Number of processes.

    Raises:
        ValueError: A network has no results, or other seeds than the first.
    """
    frames = frame_names(labels, sample_list)
    runs = {name: _runs(results, name) for name in names}
    seeds = [[run.seed for run in of_name] for of_name in runs.values()]
    if not seeds[0] or any(other != seeds[0] for other in seeds):
        raise ValueError(f"{results} has seeds {seeds} of {', '.join(names)}, expected equal ones")
    cases = [case.name for case in find_suite("dgfn7").cases]
    jobs = [(run, case) for of_name in runs.values() for run in of_name for case in cases]
    read = partial(_curves, labels=labels, frames=frames)
    with ProcessPoolExecutor(workers) as pool:
        curves = {
            (run.name, run.seed, case): found
            for (run, case), found in zip(jobs, pool.map(read, jobs), strict=True)
        }
        by_score = [{key: each[n] for key, each in curves.items()} for n in range(len(SCORES))]
        compare = partial(_compare, names=names, seeds=seeds[0], cases=cases, resamples=resamples)
        rows = [
            {"class": class_name, "iou": iou, **row}
            for (class_name, iou), of_score in zip(SCORES, pool.map(compare, by_score), strict=True)
            for row in of_score
        ]
    print(f"{len(frames)} frames, seeds {seeds[0]}, moderate, AP R40 (all points)")
    for row in rows:
        first, second, points = (row["r40"][key] for key in ("first", "second", "difference_95"))
        print(
            f"{row['class']:<11}{row['iou']} {row['case']:<20} {first:5.1f} {second:5.1f} "
            f"{first - second:+5.1f} [{points[0]:+.1f}, {points[1]:+.1f}]   by seed "
            + " ".join(f"{each:+.1f}" for each in row["r40"]["difference_by_seed"])
            + f"   ({row['all_points']['first']:.1f} {row['all_points']['second']:.1f})"
        )
    settings = {"frames": len(frames), "seeds": seeds[0], "names": list(names)}
    print_record({**settings, "resamples": resamples, "rows": rows}, seed=0)


def _runs(results: Path, name: str) -> list[Run]:
    """Find the folders of a network, by seed."""
    found = []
    for folder in results.iterdir():
        match = re.fullmatch(rf"{re.escape(name)}-(\d+)", folder.name)
        if match and folder.is_dir():
            (inner,) = (each for each in folder.iterdir() if each.is_dir())
            found.append(Run(name, int(match[1]), inner))
    return sorted(found, key=lambda run: run.seed)


def _curves(job: tuple[Run, str], *, labels: Path, frames: Sequence[str]) -> list[ResampledCurve]:
    """Match a network's results in one case, for each of `SCORES`."""
    run, case = job
    detections, truths = zip(
        *read_frames(run.folder / case, labels, frames, progress=False), strict=True
    )
    found = find_pairs(detections, truths, _LOWEST.as_array())
    index = index_pairs(found)
    return [
        ResampledCurve.of(
            select(
                found,
                index,
                code=CLASSES.index(class_name),
                metric=0,
                difficulty=MODERATE,
                min_overlap=iou,
            )
        )
        for class_name, iou in SCORES
    ]


def _both(curve: ResampledCurve, weights: ndarray) -> tuple[float, float]:
    return curve.ap_r40(weights), curve.ap_all_points(weights)


def _compare(
    curves: Mapping[tuple[str, int, str], ResampledCurve],
    *,
    names: Sequence[str],
    seeds: Sequence[int],
    cases: Sequence[str],
    resamples: int,
) -> list[dict[str, Any]]:
    """Compare two networks by one class and IoU in every case and in their mean."""

    def scores(weights: ndarray) -> ndarray:
        """AP R40 and of all points: names x seeds x cases x 2."""
        values = [
            [[_both(curves[name, seed, case], weights) for case in cases] for seed in seeds]
            for name in names
        ]
        by_case = np.array(values)
        return np.concatenate((by_case.mean(axis=2, keepdims=True), by_case), axis=2)

    valid = next(iter(curves.values())).valid_per_frame
    once = scores(np.ones(len(valid), dtype=np.int64))
    drawn = np.array([scores(weights) for weights in draw_frames(valid, resamples, 0)])
    differences = (drawn[:, 0] - drawn[:, 1]).mean(axis=1)
    low, high = np.percentile(differences, PERCENTILES, axis=0)
    rows = []
    for place, case in enumerate((FULL, *cases)):
        row: dict[str, Any] = {"case": case}
        for number, measure in enumerate(("r40", "all_points")):
            first, second = once[:, :, place, number]
            row[measure] = {
                "first": statistics.fmean(first),
                "second": statistics.fmean(second),
                "difference_95": [float(low[place, number]), float(high[place, number])],
                "difference_by_seed": (first - second).tolist(),
            }
        rows.append(row)
    return rows


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=True)
