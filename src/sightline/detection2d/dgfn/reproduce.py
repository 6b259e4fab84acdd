"""Reproduction of the tables of the paper on gated fusion, next to the published results.

Kim et al. 2018, "Robust Camera Lidar Sensor Fusion Via Deep Gated Information Fusion Network":
Table I (sensor faults), Table II (other methods); `gates` draws Fig. 4 and 5. Published
results are quoted, ours are measured on the given data; a cell without a measurement names what it
needs.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, get_args

from sightline.corruptions.generate import case_settings
from sightline.corruptions.suites import CLEAN, Case, Suite, find_suite
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.object_tree import Part, Velodyne, part_folder
from sightline.data.open import open_dataset
from sightline.data.sample_list import read_sample_list
from sightline.detection2d.answers import write_results
from sightline.detection2d.config import Fusion
from sightline.detection2d.dgfn.gates import (
    GATE_MAPS,
    GATE_MEANS,
    CaseGates,
    GateRecord,
    measure_gates,
    pool_gates,
    read_gate_record,
    score_gates,
    write_gate_maps,
    write_gate_means,
    write_gate_record,
)
from sightline.detection2d.dgfn.report import CaseScore, DgfnReport, Levels, SystemScores
from sightline.detection2d.predictor import DetectionPredictor
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import (
    DIFFICULTIES,
    STRICT,
    ClassName,
    ClassOverlaps,
    MinimumOverlaps,
)
from sightline.evaluation.object_report import ObjectEntry, ObjectReport
from sightline.export.names import EngineChoice
from sightline.files.atomic import check_links
from sightline.jobs.output_dirs import acquire_output_dir
from sightline.jobs.progress import track
from sightline.jobs.run import JobResult
from sightline.robustness.answers import MethodRun, answer_in_cases, check_numbers
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.simulation.generate import MANIFEST_NAME as SIMULATION_MANIFEST
from sightline.structures.sample import CameraLidarSample

_GATES = "gates"


@dataclass(frozen=True, kw_only=True, slots=True)
class System:
    """Detector, and its cases."""

    fusion: Fusion
    predictor: DetectionPredictor
    cases: tuple[Case, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseFolder:
    """Folder with a detector's output in one case.

    `NAME.txt` is a frame's KITTI result file; `gates/NAME.json` contains the gates of a gated
    detector. The latter is written first: a frame with a result file is complete.
    """

    path: Path

    def gates_file(self, name: str) -> Path:
        """Path of a frame's gates."""
        return self.path / _GATES / f"{name}.json"

    def gate_records(self, names: Iterable[str]) -> Iterator[GateRecord]:
        """Read the gate records of frames, in their order, one at a time.

        Raises:
            ValueError: A file is missing or damaged.
        """
        return (read_gate_record(self.gates_file(name)) for name in names)


def case_folder(out: Path, fusion: Fusion, case: Case) -> CaseFolder:
    """Folder where `detect_in_cases` saves a detector's output in a case."""
    return CaseFolder(path=out / fusion / case.name)


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
    `answer_in_cases`.

    Args:
        dataset: Frames with image, sweep and labels; these are only read.
        systems: The detectors, one of each fusion type.
        out: Output folder, see `case_folder`.
        suite: Suite of the cases.
        seed: Seed of the corruptions' boxes, discs and noise.
        workers: Number of processes; 1 is this process alone.

    Returns:
        Answers written and skipped.

    Raises:
        ValueError: A frame cannot be read, or a folder holds other results or cannot be written to.
            Errors about a frame name it; frames done before stay done.
    """
    check_numbers(seed, workers)
    check_links(out)
    asked = []
    for system in systems:
        made_by = {"method": system.predictor.name, **system.predictor.made_by}
        folder = out / system.fusion
        acquire_output_dir(
            folder, case_settings(dataset, suite, seed) | made_by, results=("*/*.txt",)
        )
        asked.append(MethodRun(predictor=system.predictor, cases=system.cases, folder=folder))
    return answer_in_cases(
        dataset,
        asked,
        _ResultsAndGates(),
        seed=seed,
        workers=workers,
        description=f"detecting in {suite.name}",
    )


class _ResultsAndGates:
    """`ResultWriter` that saves KITTI's result files with the gates beside them."""

    suffix = ".txt"

    def pose(self, sample: CameraLidarSample) -> BenchFrame:
        """Return the sample unchanged."""
        return BenchFrame(sample, None)

    def keep(self, path: Path, answered: BenchPrediction) -> None:
        """Write the gates first: a frame with a result file is complete."""
        sample, answer = answered.posed.sample, answered.answer
        if answer.camera_gate is not None:
            record = measure_gates(answer, sample, answered.corrupted)
            write_gate_record(CaseFolder(path=path.parent).gates_file(path.stem), record)
        write_results(path, sample, answer)


ONE_SENSOR: Final[tuple[Fusion, ...]] = ("camera", "lidar")
"""Fusion types scored in the clean case only: Table II."""

_PUBLISHED_SPLIT = "kitti-object-val"


def reproduce_dgfn(
    data: Path,
    weights: Mapping[Fusion, str | Path],
    out: Path,
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
) -> DgfnReport:
    """Measure the results for the paper's tables on the given data.

    Every detector runs on every frame in every case of the suite; one-sensor detectors only in the
    clean case. The detections are kept, so that a second call continues an interrupted one, and
    computes other measures of them in seconds.

    Args:
        data: KITTI's object tree, with labels.
        weights: Networks by their fusion type; see `load_network`. Cells of other types stay open.
        out: Folder for the detections; see `detect_in_cases`.
        suite: Name of the suite of corruptions.
        seed: Seed of the corruptions' boxes, discs and noise.
        class_name: Class in the tables.
        iou: IoU that a match must exceed; None: the benchmark's own, 0.7 for cars and 0.5
            otherwise.
        bootstrap: Resamples of the frames for AP over all scores; 0 leaves it out.
        figures: Folder for the pictures of the gates. None: none are drawn.
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
    if figures is not None and "gated" not in weights:
        raise ValueError(
            "the figures show gates; give the weights of a network with gates (--gated), or leave "
            "the figures out"
        )
    systems = [
        System(fusion=fusion, predictor=predictor, cases=_cases(chosen, fusion))
        for fusion, predictor in _load(weights, engine, device).items()
    ]
    dataset = _open(data, sample_list, velodyne)
    shown = _position(dataset, figure_frame)
    detect_in_cases(dataset, systems, out, suite=chosen, seed=seed, workers=workers)
    scores = _score(dataset, systems, out, class_name, overlaps, bootstrap)
    gates = _gates(dataset, chosen, out) if "gated" in weights else ()
    if figures is not None:
        gated = next(system.predictor for system in systems if system.fusion == "gated")
        write_gate_means(figures / GATE_MEANS, gates, chosen)
        write_gate_maps(figures / GATE_MAPS, dataset[shown], gated, chosen, seed)
    return DgfnReport(
        data=str(data),
        frames=len(dataset),
        is_published_split=_is_published_split(dataset),
        suite=chosen,
        seed=seed,
        class_name=class_name,
        iou=_overlaps_of(overlaps, class_name).bbox,
        systems=scores,
        gates=gates,
    )


def _overlaps(class_name: ClassName, iou: float | None) -> MinimumOverlaps:
    if iou is None:
        return STRICT
    chosen = replace(_overlaps_of(STRICT, class_name), bbox=iou)
    return replace(STRICT, **{class_name.lower(): chosen})


def _overlaps_of(overlaps: MinimumOverlaps, class_name: ClassName) -> ClassOverlaps:
    of_class: ClassOverlaps = getattr(overlaps, class_name.lower())
    return of_class


def _cases(suite: Suite, fusion: Fusion) -> tuple[Case, ...]:
    return suite.select([CLEAN]) if fusion in ONE_SENSOR else suite.cases


def _load(
    weights: Mapping[Fusion, str | Path], engine: EngineChoice, device: str
) -> dict[Fusion, DetectionPredictor]:
    """Load the detectors, in the order of the tables."""
    if not weights:
        raise ValueError(
            "reproduce dgfn measures networks; give the weights of one or more (--gated WEIGHTS)"
        )
    loaded = {}
    for fusion in (each for each in get_args(Fusion) if each in weights):
        # With several threads PyTorch's last digits vary, so the workers provide the parallelism.
        predictor = DetectionPredictor.load(
            weights[fusion], engine=engine, device=device, threads=1
        )
        if predictor.fusion != fusion:
            raise ValueError(
                f"{predictor.name} is a network of fusion {predictor.fusion}, expected {fusion}; "
                f"give it as --{predictor.fusion}"
            )
        loaded[fusion] = predictor
    return loaded


def _open(
    data: Path, sample_list: str | Path | Sequence[str] | None, velodyne: Velodyne | None
) -> KittiObjectDataset:
    parts: tuple[Part, ...] = ("image", "points", "objects")
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    if not isinstance(dataset, KittiObjectDataset) or "objects" not in dataset.parts:
        raise ValueError(
            f"{data} is no object tree of KITTI's with labels to score against; name a folder that "
            "holds training/{image_2,velodyne,calib,label_2}"
        )
    return dataset


def _position(dataset: KittiObjectDataset, name: str | None) -> int:
    if name is None:
        return 0
    if name not in dataset.sample_ids:
        raise ValueError(
            f"frame {name} to draw is not among the {len(dataset)} frames that are scored; name "
            "one of them"
        )
    return dataset.sample_ids.index(name)


def _score(
    dataset: KittiObjectDataset,
    systems: Sequence[System],
    out: Path,
    class_name: ClassName,
    overlaps: MinimumOverlaps,
    bootstrap: int,
) -> dict[Fusion, SystemScores]:
    """Score every detector in each of its cases."""
    labels = dataset.root / dataset.split / part_folder("objects")
    pairs = [(system, case) for system in systems for case in system.cases]
    found: dict[Fusion, dict[str, CaseScore]] = {system.fusion: {} for system in systems}
    for system, case in track(pairs, description="scoring"):
        report = evaluate_objects(
            case_folder(out, system.fusion, case).path,
            labels,
            sample_list=dataset.sample_ids,
            overlaps=overlaps,
            bootstrap=bootstrap,
        )
        found[system.fusion][case.name] = _case_score(report, class_name)
    return {
        system.fusion: SystemScores(name=system.predictor.name, cases=found[system.fusion])
        for system in systems
    }


def _case_score(report: ObjectReport, class_name: ClassName) -> CaseScore:
    """Select the class's results; all 0 if it has no entry, because nothing was found."""
    entries = {
        entry.difficulty: entry
        for entry in report.entries
        if (entry.class_name, entry.metric) == (class_name, "bbox")
    }

    def levels(figure: Callable[[ObjectEntry], float]) -> Levels:
        easy, moderate, hard = (
            figure(entries[each]) if each in entries else 0.0 for each in DIFFICULTIES
        )
        return easy, moderate, hard

    intervals = tuple(
        (points.low, points.high)
        for entry in entries.values()
        if (points := entry.all_points) and points.low is not None and points.high is not None
    )
    return CaseScore(
        ap_r11=levels(lambda entry: entry.ap_r11),
        ap_r40=levels(lambda entry: entry.ap_r40),
        max_recall=levels(lambda entry: 100 * entry.max_recall),
        ap_all_points=(
            levels(lambda entry: entry.all_points.ap if entry.all_points else 0.0)
            if report.num_resamples
            else None
        ),
        ap_all_points_95=intervals or None,
    )


def _gates(dataset: KittiObjectDataset, suite: Suite, out: Path) -> tuple[CaseGates, ...]:
    pooled = {
        case.name: pool_gates(case_folder(out, "gated", case).gate_records(dataset.sample_ids))
        for case in track(suite.cases, description="reading gates")
    }
    return tuple(score_gates(name, each, pooled[CLEAN]) for name, each in pooled.items())


def _is_published_split(dataset: KittiObjectDataset) -> bool:
    """Check that these are the papers' frames, and not simulated ones of the same names."""
    if (dataset.root / SIMULATION_MANIFEST).exists():
        return False
    return set(dataset.sample_ids) == set(read_sample_list(_PUBLISHED_SPLIT, dataset.root))
