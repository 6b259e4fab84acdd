"""Figures of the two-stage detection report: inputs of the second stage, training, results.

Three regions of interest, a scene with all proposals and pooled points, curves of a training and
validation scenes at its beginning, middle and end; precision over recall, and one frame's boxes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.image_file import write_rgb
from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.detector import POINT_SEED, Detector3D
from sightline.detection3d.files import read_detections
from sightline.detection3d.pictures import prediction_picture
from sightline.detection3d.predictor import StageRunners
from sightline.detection3d.region_pictures import (
    DrawnRegion,
    pool_points,
    proposals_picture,
    region_picture,
    regions_legend,
)
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import (
    Sweep,
    SweepTruthConfig,
    make_truth,
    network_sweep,
    to_kitti_frame,
)
from sightline.inference.network import LoadedNetwork
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.papers.two_stage_rows import Row, StageScores
from sightline.structures.sample import CameraLidarSample
from sightline.training.run_log import LoggedPicture, RunLog, read_run_log
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.cells import PAGE, TITLE
from sightline.visualization.curves import Curve, draw_curves
from sightline.visualization.lettering import put_text
from sightline.visualization.precision_recall import draw_precision_recall

FRAME: Final = "two_stage_frame.png"
"""File name of the picture of a frame."""
CURVES: Final = "two_stage_iou_{iou:g}.png"
"""File names of the pictures of precision over recall."""
REGIONS: Final = "two_stage_regions.png"
"""File name of the picture of three regions of interest."""
PROPOSALS: Final = "two_stage_proposals.png"
"""File name of the picture of a scene with all proposals and pooled points."""
TRAINING: Final = "two_stage_training.png"
"""File name of the picture of a training's loss and precision."""
SCENES: Final = "two_stage_scene_{number}.png"
"""File names of the pictures of a validation scene at the beginning, middle and end."""

_NUM_REGIONS = 3
_BANDS_M = ((0.0, 15.0), (15.0, 30.0), (30.0, 80.0))
"""Distances of the three regions, where a frame has such a proposal."""
_MIN_SCORE = 0.5
_SCENE_WIDTH_PX = 414
_LOSSES = {
    "training/total": "training",
    "validation/second/total": "validation, all proposals",
    "training/second/boxes": "training, boxes",
    "training/second/confidence": "training, confidence",
}
_PRECISIONS = {
    "validation/loose/Car/3d/easy_R11": "easy, IoU 0.5",
    "validation/loose/Car/3d/moderate_R11": "moderate, IoU 0.5",
    "validation/loose/Car/3d/hard_R11": "hard, IoU 0.5",
    "validation/Car/3d/moderate_R11": "moderate, IoU 0.7",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnFigures:
    """Figures of a report."""

    paths: tuple[Path, ...] = ()
    """Files that were written."""
    regions: tuple[DrawnRegion, ...] = ()
    """The regions of interest in `REGIONS`."""
    missing: tuple[str, ...] = ()
    """Figures that were not drawn, with what they need."""

    def __add__(self, other: "DrawnFigures") -> "DrawnFigures":
        """Join the figures of two lists."""
        return DrawnFigures(
            paths=self.paths + other.paths,
            regions=self.regions + other.regions,
            missing=self.missing + other.missing,
        )


def draw_results(
    folder: Path,
    rows: Mapping[Row, StageScores],
    dataset: KittiObjectDataset,
    frame_index: int,
) -> DrawnFigures:
    """Draw precision over recall of moderate cars at each IoU, and one frame's boxes."""
    paths = []
    for iou in next(iter(rows.values())).entries:
        curves = {
            f"--{row}": each.entries[iou]["moderate"].curve()
            for row, each in rows.items()
            if each.entries[iou]
        }
        title = f"Cars, 3D IoU {iou:g}, moderate"
        paths.append(folder / CURVES.format(iou=iou))
        write_rgb(paths[-1], draw_precision_recall(title, curves))
    sample = dataset[frame_index]
    detections = {
        row: read_detections(each.folder / f"{sample.sample_id}.txt", sample)
        for row, each in rows.items()
    }
    pictures = [
        prediction_picture(rows[row].network.name, sample, detections.get("first", found), found)
        for row, found in detections.items()
    ]
    paths.append(folder / FRAME)
    write_rgb(paths[-1], np.concatenate(pictures))
    return DrawnFigures(paths=tuple(paths))


def draw_inputs(
    folder: Path,
    loaded: LoadedNetwork[Detector3D] | None,
    scored: KittiObjectDataset,
    training: CameraLidarSample,
    *,
    device: str = "cpu",
) -> DrawnFigures:
    """Draw the second stage's input: regions of three scored frames, and a training scene.

    Args:
        folder: Folder of the pictures.
        loaded: Network whose first stage proposes. None: nothing is drawn.
        scored: The frames that are scored; a region of each of the first three is drawn.
        training: Frame with all of its proposals for training.
        device: Device of the network.
    """
    if loaded is None:
        return DrawnFigures(missing=("regions and proposals, without weights",))
    stages = StageRunners(loaded, device=device)
    pooling = loaded.network.config.pooling
    regions, pictures = [], []
    for number in range(min(_NUM_REGIONS, len(scored))):
        sweep, proposed, truths = _propose(stages, scored[number], training=False)
        clouds, counts = pool_points(sweep, proposed.boxes, pooling, seed=POINT_SEED)
        place = _choose(proposed, counts, _BANDS_M[number])
        if place is None:
            continue
        iou = pairwise_iou_3d(proposed.boxes[place, None].double(), truths)
        region = DrawnRegion(
            sample_id=scored.sample_ids[number],
            box=tuple(proposed.boxes[place].tolist()),
            score=float(proposed.scores[place]),
            iou=float(iou.amax()) if iou.numel() else 0.0,
            num_inside=counts[place],
        )
        regions.append(region)
        pictures.append(region_picture(region, clouds[place], truths, pooling))
    sweep, proposed, truths = _propose(stages, training, training=True)
    clouds, _ = pool_points(sweep, proposed.boxes, pooling, seed=POINT_SEED)
    pooled = torch.unique(torch.cat([sweep[:0, :3], *clouds]), dim=0)
    scene = proposals_picture(
        training.sample_id, pooled, proposed.boxes, truths, Detection3DLossConfig().sampling
    )
    write_rgb(folder / PROPOSALS, scene)
    drawn = DrawnFigures(paths=(folder / PROPOSALS,))
    if not pictures:
        return drawn + DrawnFigures(missing=("regions: no proposal has points",))
    row = _beside(pictures)
    write_rgb(folder / REGIONS, np.concatenate((row, regions_legend(row.shape[1], pooling))))
    return DrawnFigures(paths=(folder / REGIONS,), regions=tuple(regions)) + drawn


def draw_training(folder: Path, run: Path | None) -> DrawnFigures:
    """Draw loss, precision and validation scenes of a training from what it has logged.

    Args:
        folder: Folder of the pictures.
        run: Run folder of the training. None: nothing is drawn.

    Raises:
        ValueError: As `read_run_log`.
    """
    if run is None:
        return DrawnFigures(missing=("curves and scenes of the training, without --run",))
    log = read_run_log(run)
    panels = [
        draw_curves("Loss", _curves(log, _LOSSES)),
        draw_curves("Cars in 3D: AP R11, percent", _curves(log, _PRECISIONS), highest=100.0),
    ]
    write_rgb(folder / TRAINING, _beside(panels))
    paths, missing = [folder / TRAINING], []
    if not any(name in log.series for name in _PRECISIONS):
        missing.append(f"precision curves: {run} has logged no validation")
    scenes = [f"validation/{number}" for number in range(_NUM_REGIONS)]
    for number, name in enumerate(scenes):
        pictures = log.pictures.get(name, ())
        if pictures:
            paths.append(folder / SCENES.format(number=number))
            write_rgb(paths[-1], _scene(pictures))
    if not any(name in log.pictures for name in scenes):
        missing.append(f"scenes of the training: {run} has logged no pictures of a validation")
    return DrawnFigures(paths=tuple(paths), missing=tuple(missing))


def _propose(
    stages: StageRunners, sample: CameraLidarSample, *, training: bool
) -> tuple[Sweep, Proposed, Float[Tensor, "num_objects 7"]]:
    """Run the first stage; give its input, its proposals and the objects, in KITTI's frame."""
    level = to_kitti_frame(sample)
    settings = stages.detector.config.input
    sweep = network_sweep(level, settings)
    for_scoring, for_training = stages.propose_both(sweep)
    proposed = for_training if training else for_scoring
    assert level.objects is not None, "the data have labels"
    names = stages.detector.class_names
    truth = make_truth(level.objects, sweep, names, settings, SweepTruthConfig())
    down = sweep.new_tensor([0, 0, settings.height_offset_m, 0])
    boxes = proposed.boxes - sweep.new_tensor([0, 0, settings.height_offset_m, 0, 0, 0, 0])
    truths = truth.boxes - truth.boxes.new_tensor([0, 0, settings.height_offset_m, 0, 0, 0, 0])
    return sweep - down, proposed._replace(boxes=boxes), truths


def _choose(proposed: Proposed, counts: Sequence[int], band_m: tuple[float, float]) -> int | None:
    """Choose the proposal of the highest score with points, within a band of distances.

    The band does not count where its proposals have low scores.
    """
    has_points = torch.tensor(counts, dtype=torch.int64) > 0
    distance = proposed.boxes[:, :2].norm(dim=1)
    is_at = has_points & (distance >= band_m[0]) & (distance < band_m[1])
    is_at &= proposed.scores >= _MIN_SCORE
    places = (is_at if is_at.any() else has_points).nonzero()[:, 0]
    return int(places[proposed.scores[places].argmax()]) if len(places) else None


def _curves(log: RunLog, names: Mapping[str, str]) -> list[Curve]:
    return [
        Curve(name=name, steps=log.series[key].steps, values=log.series[key].values)
        for key, name in names.items()
        if key in log.series
    ]


def _scene(pictures: Sequence[LoggedPicture]) -> UInt8[np.ndarray, "height width 3"]:
    """Set the first, the middle and the last picture of a series side by side."""
    steps = np.array([each.step for each in pictures])
    middle = int(np.abs(steps - (steps[0] + steps[-1]) / 2).argmin())
    chosen = {"beginning": 0, "middle": middle, "end": len(pictures) - 1}
    cells = []
    for name, place in chosen.items():
        picture = scaled_to_width(pictures[place].read(), _SCENE_WIDTH_PX)
        bar = np.full((34, picture.shape[1], 3), PAGE, np.uint8)
        title = f"{name}: after {pictures[place].step:,} steps"
        put_text(bar, title, 8, 23, height_px=12, color=TITLE)
        cells.append(np.concatenate((bar, picture)))
    return _beside(cells)


def _beside(
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
) -> UInt8[np.ndarray, "height width 3"]:
    """Set pictures side by side, with gaps."""
    gap_px = 6
    height = max(len(each) for each in pictures)
    width = sum(each.shape[1] for each in pictures) + gap_px * (len(pictures) - 1)
    page = np.full((height, width, 3), PAGE, np.uint8)
    left = 0
    for each in pictures:
        page[: len(each), left : left + each.shape[1]] = each
        left += each.shape[1] + gap_px
    return page
