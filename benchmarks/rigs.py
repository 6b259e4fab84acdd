"""Networks on other rigs: `python -m benchmarks.rigs SIMULATED VIEWS KITTI CACHE`.

Named rigs of the simulator (frame N of `rigs-val-600` has rig N modulo their number), nuScenes'
views (a recording with labels) and KITTI's `sample_val` and `sample_train`, for any number of
networks: cars and pedestrians by KITTI's rules, depth by the simulator's dense truth below the
highest return, processor time and peak memory by rig, and paired differences of two networks.
Prints a row for each network and set of frames, then one line of JSON, kept in
benchmarks/results/rigs.json.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import jsonargparse
import numpy as np

from benchmarks.record import print_record
from benchmarks.rig_runs import DEPTH, FrameSet, Network, Run, named_network, run_network
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.evaluation.depth_breakdown import paired_difference
from sightline.evaluation.kitti_object import compare_objects, evaluate_objects
from sightline.evaluation.kitti_object_comparison import ComparedEntry, PairedDifference
from sightline.evaluation.kitti_object_rules import STRICT, ClassOverlaps, MinimumOverlaps
from sightline.evaluation.object_report import ObjectEntry
from sightline.export.names import EngineName
from sightline.simulation.rigs import RIG_NAMES

NETWORKS: Final = (
    "best=detection2d-best",
    "fast=detection2d-fast-cpu",
    "best-3d=detection3d-best",
    "fast-3d=detection3d-fast-cpu",
    "classical=classical",
    "adaptive=adaptive",
    "fast-depth=depth-fast-cpu",
    "best-depth=depth-best",
)
OTHERS: Final = "all but kitti"
VIEWS: Final = "nuScenes' views"
_LISTS: Final = ("sample_val", "sample_train")
_HALF: Final = MinimumOverlaps(car=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5))
_SCORES: Final = {
    "detection2d": (("Car", "bbox", 0.7), ("Pedestrian", "bbox", 0.5)),
    "detection3d": (("Car", "3d", 0.7), ("Car", "3d", 0.5), ("Pedestrian", "3d", 0.5)),
}
"""Class, metric and IoU of each score."""
_OVERLAPS: Final = {0.7: STRICT, 0.5: _HALF}
_ERRORS: Final = ("rmse_mm", "mae_mm", "median_mm")


def main(
    simulated: Path,
    views: Path,
    kitti: Path,
    cache: Path,
    networks: Sequence[str] = NETWORKS,
    compare: Sequence[str] = (),
    frames: int = 120,
    depth_frames: int = 48,
    resamples: int = 1000,
    seed: int = 0,
    engine: EngineName = "openvino",
) -> None:
    """Print a row for each network and set of frames, then one line of JSON.

    Args:
        simulated: Object tree of preset `rigs-val-600`.
        views: Recording of nuScenes' views with labels.
        kitti: KITTI's object tree.
        cache: Folder for results, which a second run with the same weights reads.
        networks: Networks as NAME=WEIGHTS: weights of any task, by name or file, or a method of
            depth completion.
        compare: Pairs of networks as NAME:OTHER, of which the first less the second is given.
        frames: Number of simulated frames, from the first on.
        depth_frames: Number of them for depth, which takes the most time.
        resamples: Number of resamples of the frames.
        seed: Seed of the resamples.
        engine: Inference engine.
    """
    used = [named_network(each) for each in networks]
    known = {each.name: each for each in used}
    pairs = [_pair(each, known) for each in compare]
    rows, differences = [], []
    for tasks, count in ((tuple(_SCORES), frames), ((DEPTH,), depth_frames)):
        sets = frame_sets(simulated, views, kitti, count)
        if tasks == (DEPTH,):
            sets = [each for each in sets if each.has_depth]
        scored = [each for each in used if each.task in tasks]
        runs = {
            network.name: {each.name: run_network(network, each, cache, engine) for each in sets}
            for network in scored
        }
        for each in [*sets, joined_rigs(sets)]:
            for network in scored:
                found = _runs_of(each.name, runs[network.name])
                rows.append(_row(network, each, found, cache, resamples, seed))
                print(rows[-1], flush=True)
            for first, second in pairs:
                if first.task in tasks:
                    both = [_runs_of(each.name, runs[network.name]) for network in (first, second)]
                    scores = _compared(first, second, each, both, cache, resamples, seed)
                    names = {"set": each.name, "first": first.name, "second": second.name}
                    differences.append({**names, "scores": scores})
                    print(differences[-1], flush=True)
    content = {
        "engine": engine,
        "resamples": resamples,
        "frames": frames,
        "depth_frames": depth_frames,
    }
    weights = [each.weights for each in used if not each.is_method]
    print_record(
        {**content, "results": rows, "differences": differences}, seed=seed, weights=weights
    )


def frame_sets(simulated: Path, views: Path, kitti: Path, frames: int) -> list[FrameSet]:
    """List the sets of frames: each rig's, nuScenes' views, KITTI's two lists.

    Args:
        simulated: See `main`.
        views: See `main`.
        kitti: See `main`.
        frames: Number of simulated frames.
    """
    names = [f"{index:06d}" for index in range(frames)]
    labels = simulated / "training" / "label_2"
    sets = [
        FrameSet(
            name=rig,
            group="simulated",
            data=simulated,
            labels=labels,
            frames=tuple(names[place :: len(RIG_NAMES)]),
            has_depth=True,
        )
        for place, rig in enumerate(RIG_NAMES)
    ]
    seen = tuple(sorted(path.stem for path in (views / "labels").glob("*.txt")))
    sets.append(
        FrameSet(
            name=VIEWS,
            group="views",
            data=views,
            labels=views / "labels",
            frames=seen,
            difficulty="hard",  # occlusion is not known
        )
    )
    for name in _LISTS:
        listed = tuple(read_sample_list(name, kitti))
        labels = kitti / "training" / "label_2"
        sets.append(FrameSet(name=name, group="kitti", data=kitti, labels=labels, frames=listed))
    return sets


def _pair(text: str, known: dict[str, Network]) -> tuple[Network, Network]:
    first, _, second = text.partition(":")
    if {first, second} - known.keys():
        raise ValueError(f"--compare {text}: give NAME:OTHER of {', '.join(known)}")
    if known[first].task != known[second].task:
        raise ValueError(f"--compare {text}: both must be of one task")
    return known[first], known[second]


def joined_rigs(sets: Sequence[FrameSet]) -> FrameSet:
    """Join the frames of all simulated rigs but KITTI's own."""
    rigs = [each for each in sets if each.has_depth and each.name != "kitti"]
    return rigs[0]._replace(
        name=OTHERS, frames=tuple(name for each in rigs for name in each.frames)
    )


def _runs_of(name: str, runs: Mapping[str, Run]) -> list[Run]:
    """Select a network's runs over a set of frames: those of all rigs for the joined set."""
    rigs = [rig for rig in RIG_NAMES if rig != "kitti"]
    return [runs[each] for each in (rigs if name == OTHERS else (name,)) if each in runs]


def _row(
    network: Network,
    frames: FrameSet,
    runs: Sequence[Run],
    cache: Path,
    resamples: int,
    seed: int,
) -> dict[str, Any]:
    times = [time for run in runs for time in run["ms"].values()]
    row: dict[str, Any] = {
        "set": frames.name,
        "network": network.name,
        "task": network.task,
        "frames": len(frames.frames),
        "ms": round(float(np.median(times)), 1),
        "peak_mib": max((run["peak_mib"] or 0 for run in runs), default=0) or None,
    }
    if network.task == DEPTH:
        by_frame = [scores for run in runs for scores in run["depth"].values()]
        names = (*_ERRORS, "coverage")
        means = {name: float(np.mean([scores[name] for scores in by_frame])) for name in names}
        return {**row, **{name: round(mean, 3) for name, mean in means.items()}}
    folder, scores = network.folder(cache) / frames.group, []
    for iou, overlaps in _OVERLAPS.items():
        report = evaluate_objects(
            folder,
            frames.labels,
            sample_list=frames.frames,
            overlaps=overlaps,
            bootstrap=resamples,
            seed=seed,
        )
        scores += [
            _score(name, metric, iou, report.entries, frames)
            for name, metric, least in _SCORES[network.task]
            if least == iou
        ]
    return {**row, "difficulty": frames.difficulty, "scores": scores}


def _score(
    name: str, metric: str, iou: float, entries: Sequence[ObjectEntry], frames: FrameSet
) -> dict[str, Any]:
    """Select a score; a class without a result has none."""
    row: dict[str, Any] = {"class": name, "metric": metric, "iou": iou}
    for entry in entries:
        if (entry.class_name, entry.metric, entry.difficulty) == (name, metric, frames.difficulty):
            points = entry.all_points
            row["objects"] = entry.n_gt
            row["ap_r40"] = round(entry.ap_r40, 2)
            if points is not None:
                row["ap"] = round(points.ap, 2)
                row["ap_95"] = _interval(points.low, points.high)
    return row


def _compared(
    first: Network,
    second: Network,
    frames: FrameSet,
    runs: Sequence[Sequence[Run]],
    cache: Path,
    resamples: int,
    seed: int,
) -> list[dict[str, Any]]:
    """Compare two networks frame by frame: the first less the second."""
    if first.task == DEPTH:
        by_frame = [[s for run in side for s in run["depth"].values()] for side in runs]
        pairs = [
            paired_difference(
                name, *([each[name] for each in side] for side in by_frame), seed=seed
            )
            for name in _ERRORS
        ]
        return [
            {
                "score": each.score,
                "difference": round(each.mean, 2),
                "difference_95": _interval(each.low, each.high),
            }
            for each in pairs
        ]
    folders = [network.folder(cache) / frames.group for network in (first, second)]
    scores = []
    for iou, overlaps in _OVERLAPS.items():
        report = compare_objects(
            folders[0],
            frames.labels,
            folders[1],
            sample_list=frames.frames,
            overlaps=overlaps,
            bootstrap=resamples,
            seed=seed,
        )
        for name, metric, least in _SCORES[first.task]:
            found = _all_points(report.entries, name, metric, frames) if least == iou else None
            if found is not None:
                scores.append(
                    {
                        "class": name,
                        "metric": metric,
                        "iou": iou,
                        "difference": round(found.difference, 2),
                        "difference_95": _interval(found.low, found.high),
                    }
                )
    return scores


def _all_points(
    entries: Sequence[ComparedEntry], name: str, metric: str, frames: FrameSet
) -> PairedDifference | None:
    for entry in entries:
        if (entry.class_name, entry.metric, entry.difficulty) == (name, metric, frames.difficulty):
            return entry.all_points
    return None


def _interval(low: float | None, high: float | None) -> list[float] | None:
    return None if low is None or high is None else [round(low, 2), round(high, 2)]


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
