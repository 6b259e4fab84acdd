"""Scores of the stages of 3D detectors: `python -m benchmarks.detection3d_stages DATA OUT`.

Each network predicts all frames with its first stage alone and with its second applied once, twice
and so on, up to its configured number of passes. The first stage's proposals are scored, too:
recall with at most 100 and 300 a frame. Without the flip test, and with each proposal's own axis
alone. Result files stay in OUT; existing ones are used. Prints tables of cars, then one line of
JSON with all classes.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.detector import Detector3D
from sightline.detection3d.files import write_results
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.predictor import StageRunners
from sightline.detection3d.sweeps import Sweep, network_sweep
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_proposals import evaluate_proposals
from sightline.evaluation.kitti_object_rules import LOOSE, STRICT
from sightline.evaluation.object_report import ObjectReport
from sightline.export.names import EngineName
from sightline.files.weights import fill_network
from sightline.inference.network import LoadedNetwork, load_network
from sightline.jobs.progress import track
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample
from sightline.structures.score_curves import PrecisionRecall
from sightline.visualization.precision_recall import draw_precision_recall

_COUNTS: Final = (100, 300)  # proposals of a frame
_FEW_PASSES: Final = {0: "stage 1 alone", 1: "refined once", 2: "refined twice"}
_MAX_CURVES: Final = 4  # in one chart
_MIN_HEAT: Final = 0.01  # minimum heat of a proposal, to get as many as requested
_OVERLAPS: Final = {"strict": STRICT, "loose": LOOSE}  # 0.7 and 0.5 for cars


def main(
    data: Path,
    out: Path,
    weights: tuple[str, ...] = ("detection3d-best", "detection3d-fast-cpu"),
    sample_list: str = "val",
    velodyne: Velodyne = "velodyne_reduced",
    bootstrap: int = 1000,
    engine: EngineName = "openvino",
    picture: Path | None = None,
) -> None:
    """Score the stages of each network.

    Args:
        data: KITTI object tree with labels.
        out: Folder for the result files; another one for other frames or networks.
        weights: Names or files of trained weights.
        sample_list: List of frames.
        velodyne: Folder of the sweeps.
        bootstrap: Number of resamples of the frames.
        engine: Inference engine of the networks.
        picture: PNG of precision over recall of moderate cars in 3D at IoU 0.7, of the
            first network; up to four curves.
    """
    torch.set_num_threads(1)
    labels = data / "training" / "label_2"
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts={"points"})
    samples = [dataset[index] for index in track(range(len(dataset)), description="frames")]
    names = out / "frames.txt"
    names.parent.mkdir(parents=True, exist_ok=True)
    names.write_text("".join(f"{sample.sample_id}\n" for sample in samples))
    scene = _Scene(samples, labels, names, bootstrap, engine)
    rows: list[dict[str, Any]] = []
    for number, name in enumerate(weights):
        loaded = load_network(NETWORK_TASK, name)
        loaded = _changed(loaded, replace(loaded.network.config, flip_test=False, axes=None))
        scored_passes = _score_passes(loaded, scene, out / loaded.name)
        rows += (row for row, _ in scored_passes)
        rows.append(_score_proposals(loaded, scene, out / loaded.name / "proposals"))
        if picture is not None and number == 0:
            curves = dict(itertools.islice((curve for _, curve in scored_passes), _MAX_CURVES))
            write_rgb(picture, draw_precision_recall("Car, 3D IoU 0.7, moderate", curves))
    setting = {"frames": len(samples), "sample_list": sample_list, "velodyne": velodyne}
    print_record({**setting, "results": rows}, seed=0, weights=weights)


class _Scene(NamedTuple):
    """Frames, labels and settings of the scoring."""

    samples: Sequence[CameraLidarSample]
    labels: Path
    names: Path
    bootstrap: int
    engine: EngineName


def _score_passes(
    loaded: LoadedNetwork[Detector3D], scene: _Scene, out: Path
) -> list[tuple[dict[str, Any], tuple[str, PrecisionRecall]]]:
    """Score each number of passes; with the named curve of moderate cars."""
    scored = []
    for passes, variant in _variants(loaded):
        results = out / f"refined-{passes}"
        _detect(variant, scene, results)
        reports = {
            overlaps: evaluate_objects(
                results,
                scene.labels,
                sample_list=scene.names,
                overlaps=limits,
                bootstrap=scene.bootstrap,
            )
            for overlaps, limits in _OVERLAPS.items()
        }
        row: dict[str, Any] = {"weights": loaded.name, "passes": passes}
        row |= {
            overlaps: _drop_curves(report.to_json()["entries"])
            for overlaps, report in reports.items()
        }
        _print_cars(row)
        name = _FEW_PASSES.get(passes, f"refined {passes} times")
        scored.append((row, (name, _moderate_cars(reports["strict"]))))
    return scored


def _score_proposals(loaded: LoadedNetwork[Detector3D], scene: _Scene, out: Path) -> dict[str, Any]:
    _propose(loaded, scene, out)
    recalls = {
        str(count): evaluate_proposals(
            out, scene.labels, sample_list=scene.names, max_proposals=count
        ).to_json()["entries"]
        for count in _COUNTS
    }
    row = {"weights": loaded.name, "recall": recalls}
    _print_recalls(row)
    return row


def _variants(
    loaded: LoadedNetwork[Detector3D],
) -> Iterator[tuple[int, LoadedNetwork[Detector3D]]]:
    """List the network with its second stage applied never, once, up to the configured number."""
    config = loaded.network.config
    yield 0, _changed(loaded, replace(config, refinement=None, regions=None))
    if config.regions is None:
        if config.refinement is not None:
            yield 1, loaded
        return
    for passes in range(1, config.regions.passes + 1):
        regions = replace(config.regions, passes=passes)
        yield passes, _changed(loaded, replace(config, regions=regions))


def _changed(
    loaded: LoadedNetwork[Detector3D], config: Detection3DConfig
) -> LoadedNetwork[Detector3D]:
    """Build the network with other settings and the same weights."""
    network = Detector3D(config)
    kept = {name: loaded.weights.tensors[name] for name in network.state_dict()}
    fill_network(network, kept)
    frozen = network.eval().requires_grad_(requires_grad=False)
    return replace(loaded, network=frozen)


def _detect(loaded: LoadedNetwork[Detector3D], scene: _Scene, results: Path) -> None:
    runners = StageRunners(loaded, engine=scene.engine, threads=1)

    def predict(sweep: Sweep) -> Detections3D:
        return runners.refine(sweep, runners.propose(sweep))

    _write_predictions(predict, loaded, scene.samples, results)


def _propose(loaded: LoadedNetwork[Detector3D], scene: _Scene, results: Path) -> None:
    """Write as many proposals as are counted, whatever the network's own number."""
    config, max_count = loaded.network.config, max(_COUNTS)
    many = replace(
        config,
        proposals=replace(config.proposals, num_proposals=max_count),
        centers=replace(config.centers, max_boxes=max_count, min_heat=_MIN_HEAT),
        refinement=None,
        regions=None,
    )
    runners = StageRunners(_changed(loaded, many), engine=scene.engine, threads=1)

    def predict(sweep: Sweep) -> Detections3D:
        return runners.detector.as_detections(*runners.propose(sweep)[:3])

    _write_predictions(predict, loaded, scene.samples, results)


def _write_predictions(
    predict: Callable[[Sweep], Detections3D],
    loaded: LoadedNetwork[Detector3D],
    samples: Sequence[CameraLidarSample],
    results: Path,
) -> None:
    """Write the missing result files."""
    results.mkdir(parents=True, exist_ok=True)
    settings = loaded.network.config.input
    for sample in track(samples, description=f"{loaded.name}, {results.name}"):
        path = results / f"{sample.sample_id}.txt"
        if not path.exists():
            write_results(path, sample, predict(network_sweep(sample, settings)))


def _moderate_cars(report: ObjectReport) -> PrecisionRecall:
    return next(
        entry.curve()
        for entry in report.entries
        if (entry.class_name, entry.metric, entry.difficulty) == ("Car", "3d", "moderate")
    )


def _drop_curves(entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Select the 3D and bird's-eye-view entries, without their curves."""
    curves = ("precision", "thresholds", "tp", "fp", "fn")
    return [
        {key: value for key, value in entry.items() if key not in curves}
        for entry in entries
        if entry["metric"] != "bbox"
    ]


def _print_cars(row: dict[str, Any]) -> None:
    print(f"{row['weights']}, refined {row['passes']} times")
    for overlaps in _OVERLAPS:
        for metric in ("3d", "bev"):
            car_entries = [
                entry
                for entry in row[overlaps]
                if entry["class"] == "Car" and entry["metric"] == metric
            ]
            columns = (
                f"{key} " + " / ".join(f"{entry[key]:5.1f}" for entry in car_entries)
                for key in ("AP_all_points", "AP_R40", "AP_R11")
            )
            print(f"  {metric:<4}{overlaps:<7}{'   '.join(columns)}")


def _print_recalls(row: dict[str, Any]) -> None:
    for count, entries in row["recall"].items():
        texts = (
            f"{entry['iou']}: {entry['recall']:.1f}"
            for entry in entries
            if (entry["class"], entry["metric"], entry["difficulty"]) == ("Car", "3d", "moderate")
        )
        print(f"  recall of moderate cars with {count} proposals, at 3D IoU {', '.join(texts)}")


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
