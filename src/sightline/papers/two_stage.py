"""Table and figures of the course's two-stage 3D detection of cars: its result beside ours.

ETH Zurich, "3D Object Detection from Lidar Point Clouds" (project 3, 2021): the first stage that is
handed out (that of Shi et al. 2019, PointRCNN), the baseline of problem 1, and an improved second
stage, problem 2. The course's result is average precision at 11 recall positions and a 3D IoU of
0.5 on its own test frames; the benchmark's IoU of 0.7 stands beside it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, get_args

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.detector import Detector3D
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.points.config import ProposalNetworkConfig, RefinementConfig
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.detection3d.registration import TASK
from sightline.detection3d.suppression import SuppressionConfig
from sightline.detection3d.sweeps import SweepConfig
from sightline.evaluation.kitti_object_rules import DIFFICULTIES, STRICT, MinimumOverlaps
from sightline.export.names import EngineChoice
from sightline.files.problem import remaking
from sightline.files.weights import fill_network
from sightline.inference.network import LoadedNetwork, load_network
from sightline.inference.predict import predict
from sightline.jobs.output_dirs import read_claim
from sightline.papers.rows import (
    GivenNetwork,
    add_rows,
    class_entries,
    class_scores,
    describe,
    find_departures,
    find_frame,
    is_published_split,
    levels_text,
    missing_note,
    networks_note,
    new_table,
    open_labelled,
)
from sightline.papers.two_stage_figures import (
    DrawnFigures,
    draw_inputs,
    draw_results,
    draw_training,
)
from sightline.papers.two_stage_rows import IOUS, NAMES, PUBLISHED, Row, StageScores
from sightline.structures.sample import CameraLidarSample

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

COURSE: Final = Detection3DConfig(
    input=SweepConfig(num_points=16_384, lowest_m=(0.0, -40.0, -3.0), highest_m=(70.4, 40.0, 1.0)),
    pillars=None,
    points=ProposalNetworkConfig(),
    regions=None,
    refinement=RefinementConfig(),
    suppression=SuppressionConfig(min_score=0.3, iou=0.1),
)
"""Settings of the course's baseline with the first stage that its features come from."""

_BESIDES: Final[dict[Row, tuple[str, ...]]] = {
    "first": ("refinement", "pooling", "suppression", "regions", "axes"),
    "baseline": (),
    "improved": ("refinement", "pooling", "suppression", "regions", "axes"),
}
"""Settings in which a row's network is free; of the improved one the whole second stage is."""
_PROPOSERS: Final[tuple[Row, ...]] = ("baseline", "first", "improved")
"""Rows whose first stage may propose for the pictures, in order of preference."""
_UNUSED = ("training_proposals", "centers")


@dataclass(frozen=True, kw_only=True, slots=True)
class TwoStageReport:
    """Table of the course with our measurements."""

    data: str | None = None
    """Data set; None: nothing was measured."""
    frames: int = 0
    is_val_split: bool = False
    """Whether the frames are KITTI's val split, of which the course's test frames are not known to
    be a part."""
    rows: Mapping[Row, StageScores] = field(default_factory=dict)
    figures: DrawnFigures = field(default_factory=DrawnFigures)

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of the report file; None where nothing was measured."""
        return {
            "data": self.data,
            "frames": self.frames,
            "is_kitti_val": self.is_val_split,
            "class": "Car",
            "difficulties": list(DIFFICULTIES),
            "published": {"baseline": {f"{IOUS[0]:g}": {"ap_r11": list(PUBLISHED)}}},
            "ours": {row: self.rows[row].to_json() if row in self.rows else None for row in NAMES},
            "regions": [asdict(each) for each in self.figures.regions],
            "not_measured": self._missing(),
            "not_drawn": list(self.figures.missing),
        }

    def table(self) -> "Group":
        """Make the table, and lines on other networks and on what was not measured."""
        from rich.console import Group

        networks = [each.network for each in self.rows.values()]
        notes = (
            networks_note(networks),
            missing_note(self._missing()),
            missing_note(self.figures.missing, "drawn"),
        )
        return Group(self._scores_table(), *filter(None, notes))

    def _scores_table(self) -> "Table":
        split = "KITTI val" if self.is_val_split else "not KITTI val"
        ours = f"{self.data}, {self.frames:,} frames ({split})" if self.data else "none"
        table = new_table(
            "Cars in 3D: AP R11, easy / moderate / hard, percent. Published: the course's own test "
            f"frames. Ours: {ours}",
            ("detector", "network", *(f"3D IoU {iou:g}" for iou in IOUS)),
            texts=2,
        )
        table.add_row(f"{NAMES['baseline']}, published", "", levels_text(PUBLISHED), "-")
        for row, name in NAMES.items():
            scores = self.rows.get(row)
            network = None if scores is None else scores.network
            by_iou = () if scores is None else scores.entries.values()
            cells = tuple(levels_text(class_scores(each).ap_r11) for each in by_iou)
            add_rows(table, (f"{name}, ours",), f"--{row}", network, cells)
        return table

    def _missing(self) -> list[str]:
        if self.data is None:
            return ["ours, without --data KITTI and weights"]
        measured = [row for row, each in self.rows.items() if each.network.is_papers]
        absent = " ".join(f"--{row}" for row in NAMES if row not in measured)
        recipes = "recipes detection3d-rpn-kitti, detection3d-baseline-kitti"
        return [f"the course's networks ({recipes}), without {absent}"] if absent else []


def reproduce_two_stage(
    data: Path | None = None,
    given: Mapping[Row, str | Path] | None = None,
    out: Path = Path("two_stage"),
    *,
    figures: Path | None = None,
    figure_frame: str | None = None,
    training_frame: str | None = None,
    run: Path | None = None,
    engine: EngineChoice = "torch",
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
) -> TwoStageReport:
    """Measure the results for the course's table on the given data.

    Args:
        data: KITTI's object tree, with labels. None: the published figures alone.
        given: Weights of a row's network, see `load_network`, or a folder of its result files. Of
            weights for `first` only the first stage is used, with the network's suppression.
        out: Folder for the detections of weights, with a folder for each row; see `predict`.
        figures: Folder for the pictures; see `two_stage_figures`. None: none are drawn.
        figure_frame: Name of the frame whose boxes are drawn. None: the first.
        training_frame: Name of the frame of `data` that is drawn with all proposals. None: the
            first one that is not scored, or the first.
        run: Run folder of a training whose curves and scenes are drawn. None: none.
        engine: Inference engine.
        device: Device of the networks.
        sample_list: Which frames; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder. None: velodyne, or else velodyne_reduced.
        workers: Number of processes; 1 is this process alone.

    Raises:
        ValueError: The data cannot be read or have no labels, networks or figures are given without
            data, a run or a frame without figures, a network has no second stage, or as `predict`
            and `evaluate_objects`.
    """
    given = given or {}
    if data is None:
        if given or figures is not None:
            raise ValueError(
                "networks, results and figures need data; name KITTI's object tree with --data"
            )
        return TwoStageReport()
    if figures is None and (run is not None or training_frame is not None):
        raise ValueError("a run and a training frame are drawn; name a folder with --figures")
    folders = {row: Path(each) for row, each in given.items() if Path(each).is_dir()}
    loaded = {row: _load(row, given[row]) for row in given if row not in folders}
    dataset = open_labelled(data, sample_list, velodyne)
    frame_index = find_frame(dataset, figure_frame)
    training = None
    if figures is not None:
        training = _training_sample(data, dataset, training_frame, velodyne)
    rows: dict[Row, StageScores] = {}
    for row in (each for each in get_args(Row) if each in given):
        folder = folders.get(row)
        network = _describe_results(row, folder) if folder else _describe(row, loaded[row])
        if folder is None:
            folder = out / row
            predictor = Detection3DPredictor(loaded[row], engine=engine, device=device, threads=1)
            predict(
                TASK,
                predictor,
                data,
                folder,
                sample_list=dataset.sample_ids,
                velodyne=velodyne,
                workers=workers,
                remedy=f"to make them anew, remove {folder}",
            )
        with remaking(None if row in folders else folder):
            rows[row] = _score(network, folder, dataset)
    drawn = DrawnFigures()
    if figures is not None and training is not None:
        drawn += draw_training(figures, run)
        proposer = next((loaded[row] for row in _PROPOSERS if row in loaded), None)
        drawn += draw_inputs(figures, proposer, dataset, training, device=device)
        if rows:
            drawn += draw_results(figures, rows, dataset, frame_index)
    return TwoStageReport(
        data=str(data),
        frames=len(dataset),
        is_val_split=is_published_split(dataset),
        rows=rows,
        figures=drawn,
    )


def _training_sample(
    data: Path, scored: KittiObjectDataset, name: str | None, velodyne: Velodyne | None
) -> CameraLidarSample:
    """Read the frame to draw with all proposals: by default the first one that is not scored."""
    everything = open_labelled(data, None, velodyne)
    if name is None:
        taken = set(scored.sample_ids)
        others = (each for each in everything.sample_ids if each not in taken)
        name = next(others, everything.sample_ids[0])
    return everything[find_frame(everything, name)]


def _load(row: Row, weights: str | Path) -> LoadedNetwork[Detector3D]:
    """Load a row's network; for `first` without its second stage."""
    loaded = load_network(NETWORK_TASK, weights)
    network = loaded.network
    if row != "first":
        if network.second_name is None:
            raise ValueError(
                f"{loaded.name} has no second stage, as --{row} needs; give it as --first"
            )
        return loaded
    if network.second_name is None:
        return loaded
    alone = Detector3D(replace(network.config, refinement=None, regions=None, axes=None))
    kept = {
        name: tensor
        for name, tensor in network.state_dict().items()
        if not name.startswith(f"{network.second_name}.")
    }
    fill_network(alone, kept)
    alone.eval().requires_grad_(requires_grad=False)
    return replace(loaded, network=alone, name=f"{loaded.name}, first stage alone")


def _describe(row: Row, loaded: LoadedNetwork[Detector3D]) -> GivenNetwork:
    network = loaded.network
    departures = find_departures(network.config, COURSE, besides=(*_BESIDES[row], *_UNUSED))
    if row == "improved" and network.config.refinement == COURSE.refinement:
        departures = (*departures, "the baseline's second stage")
    stages = filter(None, (network.first_name, network.second_name))
    return describe(loaded, " and ".join(stages), departures)


def _describe_results(row: Row, folder: Path) -> GivenNetwork:
    """Describe results by their folder's manifest: the network behind them is not checked."""
    claim = read_claim(folder) or {}
    by = f"results by {claim['method']}" if "method" in claim else "results"
    return GivenNetwork(
        name=str(folder), design=f"{by}, given as {row}", departures=("network not checked",)
    )


def car_overlaps(iou: float) -> MinimumOverlaps:
    """KITTI's overlaps with another 3D IoU for cars."""
    return replace(STRICT, car=replace(STRICT.car, box3d=iou))


def _score(network: GivenNetwork, folder: Path, dataset: KittiObjectDataset) -> StageScores:
    entries = {iou: class_entries(folder, dataset, "Car", "3d", car_overlaps(iou)) for iou in IOUS}
    return StageScores(network=network, folder=folder, entries=entries)
