"""Other sensors than KITTI's, from a folder to scores: `python -m benchmarks.own_sensor OUT`.

The same simulated streets are recorded by several rigs, each in the layout of a user's recording
(JPG, .npy, one YAML file without the LiDAR's height), checked, perceived by all tasks,
and scored. Prints a Markdown table, then one line of JSON: benchmarks/results/own_sensor.json.

Difficulties are by pixels of KITTI's image, which a camera of a longer focal length reaches with
smaller or farther objects. So its objects are scored twice: as `sightline evaluate objects` does,
and with boxes of labels and results in pixels of KITTI's focal length. Depth is scored on the dense
truth up to 80 m below the highest ring of the rig, per image, then averaged.
"""

import json
import statistics
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import jsonargparse
import numpy as np
import torch

from benchmarks.own_sensor_rigs import RIGS, record_street
from benchmarks.record import print_record
from sightline.data.check import check_tree, summarize_tree
from sightline.data.formats.kitti_labels import read_labels, read_results, write_objects
from sightline.data.formats.map_png import read_depth_png
from sightline.data.open import open_dataset
from sightline.evaluation.held_out_frame import dense_truth_in_reach
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import Metric
from sightline.evaluation.object_report import ObjectEntry
from sightline.export.names import EngineName
from sightline.jobs.progress import track
from sightline.perception.kept_lines import TIMINGS_NAME
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.simulation.settings import KITTI_FOCAL_PX

_TASKS: Final[Mapping[str, Metric]] = {"detection2d": "bbox", "detection3d": "3d"}
_TABLE_CLASSES: Final = ("Car", "Pedestrian")
_BOOTSTRAP: Final = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectScore:
    """Moderate score of one class by one metric."""

    class_name: str
    metric: Metric
    num_objects: int
    ap_r40: float
    """Percent, like the next two."""
    ap_all_points_95: tuple[float, float] | None
    """95 % interval of the area under the whole curve; None without counted objects."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthScore:
    """Means of the images' scores."""

    rmse_mm: float
    mae_mm: float
    median_mm: float
    coverage: float
    """Share of the truth's pixels that have a depth; the others count as 0 m."""
    truth_share: float
    """Share of the image that has truth."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RigScores:
    """Scores of one rig's recording."""

    rig: str
    check: tuple[str, ...]
    """Output of `sightline check`."""
    lidar_height_m: float | None
    """Height estimated from the road."""
    objects: tuple[ObjectScore, ...]
    """In the recording's own pixels."""
    objects_in_kitti_pixels: tuple[ObjectScore, ...]
    depth: DepthScore
    median_ms: Mapping[str, float]
    """Median time of a frame, by task."""


def main(
    out: Path,
    rigs: Sequence[str] = tuple(RIGS),
    frames: int = 40,
    seed: int = 1500,
    engine: EngineName = "openvino",
) -> None:
    """Make, check, perceive and score a recording of each rig.

    Args:
        out: Folder for recordings and results; existing files are kept.
        rigs: Names of rigs; see `own_sensor_rigs.RIGS`.
        frames: Number of streets.
        seed: Seed of the streets.
        engine: Inference engine of the networks.
    """
    torch.set_num_threads(1)
    perceiver = MultiTaskPredictor.load(engine=engine, threads=1)
    results = []
    for rig in rigs:
        recording, predictions = out / rig, out / f"{rig}-perceived"
        for index in track(range(frames), description=f"taking {rig}"):
            record_street(RIGS[rig], recording, seed=seed, index=index)
        check_lines = (*map(str, summarize_tree(recording)), *map(str, check_tree(recording)))
        print("\n".join(check_lines))
        perceive(recording, predictions, perceiver=perceiver)
        results.append(
            RigScores(
                rig=rig,
                check=tuple(line.replace(str(recording), rig) for line in check_lines),
                lidar_height_m=open_dataset(recording)[0].lidar_height_m,
                objects=score_objects(recording, predictions),
                objects_in_kitti_pixels=score_objects(
                    recording, predictions, scale=KITTI_FOCAL_PX / RIGS[rig].focal_px
                ),
                depth=score_depth(recording, predictions),
                median_ms=_median_ms(predictions),
            )
        )
    print("\n".join(_table(results)))
    made_by = [predictor.name for predictor in perceiver.predictors.values()]
    rows = [*map(asdict, results)]
    print_record({"frames": frames, "engine": engine, "results": rows}, seed=seed, weights=made_by)


def score_objects(
    recording: Path, predictions: Path, *, scale: float = 1.0
) -> tuple[ObjectScore, ...]:
    """Score both detectors, with boxes in the image resized by `scale`."""
    scores: list[ObjectScore] = []
    for task, metric in _TASKS.items():
        with tempfile.TemporaryDirectory() as folder:
            results, labels = Path(folder, "results"), Path(folder, "labels")
            for path in sorted((recording / "labels").glob("*.txt")):
                found, true = read_results(predictions / task / path.name), read_labels(path)
                for place, objects in ((results, found), (labels, true)):
                    resized = replace(objects, boxes2d=objects.boxes2d * scale)
                    write_objects(place / path.name, resized, decimals=None)
            report = evaluate_objects(results, labels, bootstrap=_BOOTSTRAP)
        scores += [
            ObjectScore(
                class_name=entry.class_name,
                metric=metric,
                num_objects=entry.n_gt,
                ap_r40=round(entry.ap_r40, 2),
                ap_all_points_95=_interval(entry),
            )
            for entry in report.entries
            if entry.metric == metric and entry.difficulty == "moderate"
        ]
    return tuple(scores)


def _interval(entry: ObjectEntry) -> tuple[float, float] | None:
    points = entry.all_points
    if points is None or points.low is None or points.high is None:
        return None
    return round(points.low, 2), round(points.high, 2)


def score_depth(recording: Path, predictions: Path) -> DepthScore:
    """Score the depth maps against the simulator's."""
    dataset = open_dataset(recording, parts=("points", "depth"))
    rows = []
    for index in track(range(len(dataset)), description="scoring depth"):
        sample = dataset[index]
        truth_m = dense_truth_in_reach(sample).numpy()
        depth_m = read_depth_png(predictions / "depth-completion" / f"{sample.sample_id}.png")
        is_scored = truth_m > 0
        error_mm = 1e3 * np.abs(depth_m.astype(np.float64) - truth_m)[is_scored]
        row = [np.sqrt(np.mean(error_mm**2)), np.mean(error_mm), np.median(error_mm)]
        rows.append([*row, (depth_m[is_scored] > 0).mean(), is_scored.mean()])
    means = [round(mean, 4) for mean in np.mean(rows, axis=0).tolist()]
    names = ("rmse_mm", "mae_mm", "median_mm", "coverage", "truth_share")
    return DepthScore(**dict(zip(names, means, strict=True)))


def _median_ms(predictions: Path) -> dict[str, float]:
    lines = (predictions / TIMINGS_NAME).read_text().splitlines()
    times = [json.loads(line)["milliseconds"] for line in lines]
    return {name: statistics.median(each[name] for each in times) for name in times[0]}


def _table(results: Sequence[RigScores]) -> Iterator[str]:
    heads = [f"{metric}: {name}" for metric in ("2D", "3D") for name in _TABLE_CLASSES]
    columns = ("sensors", "pixels", *heads, "depth: RMSE", "MAE", "median [mm]")
    yield f"| {' | '.join(columns)} |"
    yield "|---" * len(columns) + "|"
    for each in results:
        depth = [
            f"{mm:.0f}" for mm in (each.depth.rmse_mm, each.depth.mae_mm, each.depth.median_mm)
        ]
        title = RIGS[each.rig].title
        yield f"| {' | '.join((title, 'own', *_cells(each.objects), *depth))} |"
        if each.objects != each.objects_in_kitti_pixels:
            yield f"| | KITTI's | {' | '.join(_cells(each.objects_in_kitti_pixels))} | | | |"


def _cells(scores: Sequence[ObjectScore]) -> list[str]:
    shown = [each for each in scores if each.class_name in _TABLE_CLASSES]
    return [f"{each.ap_r40:.1f} ({each.num_objects})" for each in shown]


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
