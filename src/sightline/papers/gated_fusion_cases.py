"""Measurements for the tables and figures of Kim et al. 2018 (gated fusion).

Every detector runs on every frame in every case of the paper; see `gated_fusion` for the tables.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, get_args

from sightline.corruptions.generate import case_settings
from sightline.corruptions.suites import CLEAN, Case, Suite, find_suite
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.detection2d.config import PAPER, Fusion
from sightline.detection2d.network_task import NETWORK_TASK
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.results import write_results
from sightline.evaluation.kitti_object_rules import (
    STRICT,
    ClassName,
    ClassOverlaps,
    MinimumOverlaps,
)
from sightline.export.names import EngineChoice
from sightline.files.atomic import check_links
from sightline.files.problem import remaking
from sightline.inference.network import load_network
from sightline.jobs.output_dirs import acquire_output_dir, finished_names
from sightline.jobs.progress import track
from sightline.jobs.run import JobResult
from sightline.papers.gated_fusion import GatedFusionReport, SystemScores
from sightline.papers.gates import (
    GATE_MAPS,
    GATE_MEANS,
    CaseGates,
    Gates,
    measure_gates,
    pool_gates,
    read_gate_record,
    score_gates,
    write_gate_maps,
    write_gate_means,
    write_gate_record,
)
from sightline.papers.rows import (
    ClassScores,
    GivenNetwork,
    class_entries,
    class_scores,
    describe,
    find_departures,
    find_frame,
    is_published_split,
    open_labelled,
)
from sightline.papers.stream_similarity import stream_similarity
from sightline.robustness.predictions import MethodRun, check_numbers, predict_in_cases
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.structures.sample import CameraLidarSample

INTERPRETATIONS: Final = ("fusion", "postprocess", "input.height_offset_m")
"""Settings with which a network is still the paper's: of the compared systems, of boxes' selection,
and the letter of Eq. 3 beside our reading."""


@dataclass(frozen=True, kw_only=True, slots=True)
class System:
    """Detector, and its cases."""

    fusion: Fusion
    predictor: DetectionPredictor
    network: GivenNetwork
    cases: tuple[Case, ...]


def _case_folder(out: Path, fusion: Fusion, case: Case) -> Path:
    """Folder of a detector's output in a case: NAME.txt and gates/NAME.json for each frame."""
    return out / fusion / case.name


def _gates_file(folder: Path, name: str) -> Path:
    return folder / "gates" / f"{name}.json"


def detect_in_cases(
    dataset: KittiObjectDataset,
    systems: Sequence[System],
    out: Path,
    *,
    suite: Suite,
    seed: int = 0,
    workers: int = 2,
) -> JobResult:
    """Run every detector on every frame in each of its cases.

    Each detector's folder records its origin, see `acquire_output_dir`; otherwise as
    `predict_in_cases`.

    Args:
        dataset: Frames with image, sweep and labels; these are only read.
        systems: The detectors, one of each fusion type.
        out: Output folder, with a folder for each detector and case.
        suite: Suite of the cases.
        seed: Seed of the corruptions' boxes, discs and noise.
        workers: Number of processes; 1 is this process alone.

    Returns:
        Numbers of predictions written and skipped.

    Raises:
        ValueError: A frame cannot be read, or a folder holds other results or cannot be written to.
            Errors about a frame name it; frames done before stay done.
    """
    check_numbers(seed, workers)
    check_links(out)
    runs = []
    for system in systems:
        made_by = {"method": system.predictor.name, **system.predictor.made_by}
        folder = out / system.fusion
        acquire_output_dir(
            folder, case_settings(dataset, suite, seed) | made_by, results=("*/*.txt",)
        )
        runs.append(MethodRun(predictor=system.predictor, cases=system.cases, folder=folder))
    return predict_in_cases(
        dataset,
        runs,
        _ResultsAndGates(),
        seed=seed,
        workers=workers,
        description=f"detecting in {suite.name}",
    )


class _ResultsAndGates:
    """`ResultWriter` that saves KITTI's result files with the gates beside them."""

    suffix = ".txt"

    def prepare(self, sample: CameraLidarSample) -> BenchFrame:
        """Return the sample unchanged."""
        return BenchFrame(sample, None)

    def store(self, path: Path, prediction: BenchPrediction) -> None:
        """Write the gates first: a frame with a result file is complete."""
        sample, result = prediction.frame.sample, prediction.output
        if result.camera_gate is not None:
            record = measure_gates(result, sample, prediction.corrupted)
            write_gate_record(_gates_file(path.parent, path.stem), record)
        write_results(path, sample, result)

    def finished(self, folder: Path) -> frozenset[str]:
        """List the frames with a file; see `ResultWriter.finished`."""
        return finished_names(folder, self.suffix)


SIMILARITY_FRAMES: Final = 50
"""Largest number of frames over which the streams' features are compared."""
TWO_STREAMS: Final[tuple[Fusion, ...]] = ("gated", "ones")
"""Fusion types with a stream for each sensor and joint maps."""
ONE_SENSOR: Final[tuple[Fusion, ...]] = ("camera", "lidar")
"""Fusion types scored in the clean case only: Table II."""


def reproduce_gated_fusion(
    data: Path | None = None,
    weights: Mapping[Fusion, str | Path] | None = None,
    out: Path = Path("gated_fusion"),
    *,
    suite: str = "dgfn7",
    seed: int = 0,
    class_name: ClassName = "Car",
    iou: float | None = None,
    bootstrap: int = 0,
    figures: Path | None = None,
    figure_frame: str | None = None,
    engine: EngineChoice = "torch",
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
) -> GatedFusionReport:
    """Measure the results for the paper's tables on the given data.

    Every detector runs on every frame in every case of the suite; one-sensor detectors only in the
    clean case. The detections are kept, so that a second call continues an interrupted one, and
    computes other measures of them in seconds.

    Args:
        data: KITTI's object tree, with labels. None: the published figures alone.
        weights: Networks by their fusion type; see `load_network`. Rows of other types stay open.
            None: the published figures alone.
        out: Folder for the detections; see `detect_in_cases`.
        suite: Name of the suite of corruptions.
        seed: Seed of the corruptions' boxes, discs and noise.
        class_name: Class in the tables.
        iou: IoU that a match must exceed; None: the benchmark's own, 0.7 for cars and 0.5
            otherwise.
        bootstrap: Resamples of the frames for AP over all scores; 0 leaves it out.
        figures: Folder for the pictures of the gated network's gates. None: none are drawn.
        figure_frame: Name of the frame whose gates are drawn. None: the first.
        engine: Inference engine.
        device: Device of the networks.
        sample_list: Which frames; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder. None: velodyne, or else velodyne_reduced.
        workers: Number of processes; 1 is this process alone.

    Raises:
        ValueError: The data cannot be read or have no labels, a file of weights is for another
            fusion type, `out` holds other results, or as `evaluate_objects`.
    """
    chosen = find_suite(suite)
    overlaps = _overlaps(class_name, iou)
    weights = weights or {}
    if weights and data is None:
        raise ValueError("weights are measured on data; name KITTI's object tree with --data")
    if figures is not None and "gated" not in weights:
        raise ValueError(
            "the figures show gates; give the weights of a network with gates (--gated) and data "
            "(--data), or leave the figures out"
        )
    if data is None or not weights:
        bbox = _class_overlaps(overlaps, class_name).bbox
        return GatedFusionReport(suite=chosen, class_name=class_name, iou=bbox)
    systems = _load(weights, chosen, engine, device)
    dataset = open_labelled(data, sample_list, velodyne)
    frame_index = find_frame(dataset, figure_frame)
    detect_in_cases(dataset, systems, out, suite=chosen, seed=seed, workers=workers)
    scores = _score(dataset, systems, out, class_name, overlaps, bootstrap)
    for fusion in (each for each in TWO_STREAMS if each in weights):
        similarity = _similarity(weights[fusion], dataset)
        scores[fusion] = replace(scores[fusion], similarity=similarity)
    gates = _gates(dataset, chosen, out) if "gated" in weights else ()
    if figures is not None and gates:
        gated = next(system.predictor for system in systems if system.fusion == "gated")
        write_gate_means(figures / GATE_MEANS, gates, chosen)
        write_gate_maps(figures / GATE_MAPS, dataset[frame_index], gated, chosen, seed)
    return GatedFusionReport(
        data=str(data),
        frames=len(dataset),
        is_published_split=is_published_split(dataset),
        suite=chosen,
        seed=seed,
        class_name=class_name,
        iou=_class_overlaps(overlaps, class_name).bbox,
        systems=scores,
        gates=gates,
    )


def _similarity(weights: str | Path, dataset: KittiObjectDataset) -> tuple[float | None, ...]:
    network = load_network(NETWORK_TASK, weights).network
    frames = range(min(len(dataset), SIMILARITY_FRAMES))
    tracked = track(frames, description="comparing the streams")
    return stream_similarity(network, (dataset[index] for index in tracked))


def _overlaps(class_name: ClassName, iou: float | None) -> MinimumOverlaps:
    if iou is None:
        return STRICT
    chosen = replace(_class_overlaps(STRICT, class_name), bbox=iou)
    return replace(STRICT, **{class_name.lower(): chosen})


def _class_overlaps(overlaps: MinimumOverlaps, class_name: ClassName) -> ClassOverlaps:
    class_overlaps: ClassOverlaps = getattr(overlaps, class_name.lower())
    return class_overlaps


def _load(
    weights: Mapping[Fusion, str | Path], suite: Suite, engine: EngineChoice, device: str
) -> list[System]:
    """Load the detectors, in the order of the tables."""
    systems = []
    for fusion in (each for each in get_args(Fusion) if each in weights):
        loaded = load_network(NETWORK_TASK, weights[fusion])
        # With several threads PyTorch's last digits vary, so the workers provide the parallelism.
        predictor = DetectionPredictor(loaded, engine=engine, device=device, threads=1)
        if predictor.fusion != fusion:
            raise ValueError(
                f"{predictor.name} is a network of fusion {predictor.fusion}, expected {fusion}; "
                f"give it as --{predictor.fusion}"
            )
        config = loaded.network.config
        network = describe(
            loaded,
            "compact" if config.dgfn is None else "DGFN",
            find_departures(config, PAPER, besides=INTERPRETATIONS),
            size=f"width {config.width:g}",
        )
        cases = suite.select([CLEAN]) if fusion in ONE_SENSOR else suite.cases
        systems.append(System(fusion=fusion, predictor=predictor, network=network, cases=cases))
    return systems


def _score(
    dataset: KittiObjectDataset,
    systems: Sequence[System],
    out: Path,
    class_name: ClassName,
    overlaps: MinimumOverlaps,
    bootstrap: int,
) -> dict[Fusion, SystemScores]:
    """Score every detector in each of its cases."""
    pairs = [(system, case) for system in systems for case in system.cases]
    found: dict[Fusion, dict[str, ClassScores]] = {system.fusion: {} for system in systems}
    for system, case in track(pairs, description="scoring"):
        folder = _case_folder(out, system.fusion, case)
        with remaking(folder):
            entries = class_entries(folder, dataset, class_name, "bbox", overlaps, bootstrap)
        scores = class_scores(entries, with_all_points=bootstrap > 0)
        found[system.fusion][case.name] = scores
    return {
        system.fusion: SystemScores(network=system.network, cases=found[system.fusion])
        for system in systems
    }


def _gates(dataset: KittiObjectDataset, suite: Suite, out: Path) -> tuple[CaseGates, ...]:
    pooled = {
        case.name: pool_gates(_records(_case_folder(out, "gated", case), dataset))
        for case in track(suite.cases, description="reading gates")
    }
    return tuple(score_gates(name, each, pooled[CLEAN]) for name, each in pooled.items())


def _records(folder: Path, dataset: KittiObjectDataset) -> Iterator[Gates]:
    return (read_gate_record(_gates_file(folder, name)) for name in dataset.sample_ids)
