"""Fusion with learned gates less other kinds of fusion: AP of several seeds, paired intervals.

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
        names: The networks; the others are subtracted from the first, for their common seeds.
        resamples: Number of resamples of the frames.
        workers: Number of processes.

    Raises:
        ValueError: A network has no results, or no seed of the first.
    """
    frames = frame_names(labels, sample_list)
    runs = {name: _runs(results, name) for name in names}
    seeds = {name: [run.seed for run in of_name] for name, of_name in runs.items()}
    if any(not set(of_name) & set(seeds[names[0]]) for of_name in seeds.values()):
        raise ValueError(f"{results} has seeds {seeds}, expected common ones with the first")
    cases = [case.name for case in find_suite("dgfn7").cases]
    jobs = [(run, case) for of_name in runs.values() for run in of_name for case in cases]
    read = partial(_curves, labels=labels, frames=frames)
    with ProcessPoolExecutor(workers) as pool:
        curves = {
            (run.name, run.seed, case): found
            for (run, case), found in zip(jobs, pool.map(read, jobs), strict=True)
        }
        by_score = [{key: each[n] for key, each in curves.items()} for n in range(len(SCORES))]
        compare = partial(_compare, seeds=seeds, cases=cases, resamples=resamples)
        rows = [
            {"class": class_name, "iou": iou, **row}
            for (class_name, iou), of_score in zip(SCORES, pool.map(compare, by_score), strict=True)
            for row in of_score
        ]
    print(f"{len(frames)} frames, seeds {seeds}, moderate, AP R40; {names[0]} less another")
    for row in rows:
        scores = " ".join(f"{name} {score:5.1f}" for name, score in row["r40"]["scores"].items())
        differences = "  ".join(
            f"{name} {statistics.fmean(each['by_seed']):+.1f} "
            f"[{each['interval'][0]:+.1f}, {each['interval'][1]:+.1f}]"
            for name, each in row["r40"]["differences"].items()
        )
        print(f"{row['class']:<11}{row['iou']} {row['case']:<20} {scores}   {differences}")
    settings = {"frames": len(frames), "seeds": seeds, "resamples": resamples}
    print_record({**settings, "rows": rows}, seed=0)


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
    seeds: Mapping[str, Sequence[int]],
    cases: Sequence[str],
    resamples: int,
) -> list[dict[str, Any]]:
    """Compare the networks by one class and IoU in every case and in their mean."""

    def scores(weights: ndarray) -> dict[str, ndarray]:
        """AP R40 and of all points by network: seeds x (full and cases) x 2."""
        found = {}
        for name, of_name in seeds.items():
            by_case = np.array(
                [[_both(curves[name, seed, case], weights) for case in cases] for seed in of_name]
            )
            found[name] = np.concatenate((by_case.mean(axis=1, keepdims=True), by_case), axis=1)
        return found

    first, *others = seeds
    valid = next(iter(curves.values())).valid_per_frame
    if not valid.any():  # no such object
        return []
    once = scores(np.ones(len(valid), dtype=np.int64))
    drawn = [scores(weights) for weights in draw_frames(valid, resamples, 0)]
    rows: list[dict[str, Any]] = [{"case": case} for case in (FULL, *cases)]
    for place, row in enumerate(rows):
        for number, measure in enumerate(("r40", "all_points")):
            row[measure] = {
                "scores": {
                    name: float(each[:, place, number].mean()) for name, each in once.items()
                },
                "differences": {},
            }
    for other in others:
        common = [seed for seed in seeds[first] if seed in seeds[other]]
        pairs = [[seeds[name].index(seed) for seed in common] for name in (first, other)]

        by_seed = once[first][pairs[0]] - once[other][pairs[1]]
        resampled = [(each[first][pairs[0]] - each[other][pairs[1]]).mean(axis=0) for each in drawn]
        low, high = np.percentile(resampled, PERCENTILES, axis=0)
        for place, row in enumerate(rows):
            for number, measure in enumerate(("r40", "all_points")):
                row[measure]["differences"][other] = {
                    "by_seed": by_seed[:, place, number].tolist(),
                    "interval": [float(low[place, number]), float(high[place, number])],
                }
    return rows


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=True)
