"""Proposals that a frame offers a second stage, and draws by four samplings of the course.

`python -m benchmarks.proposal_sampling DATA CACHE --sample_list LIST`. CACHE is a folder of
`sightline proposals`. The handout asks what would happen if (1) all proposals were drawn alike,
(2) easy background were left out, (3) foreground began at an IoU of 0.5 and all else were
background. Also counts the boxes that suppression leaves by the overlap from above and in 3D.
Prints one line for each figure, then one line of JSON.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import jsonargparse
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.record import print_record
from sightline.data.open import open_dataset
from sightline.detection3d.examples import Detection3DExampleConfig, Detection3DExamples
from sightline.detection3d.points.refinement_training import assign_truths
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import Sweep, SweepTruth, SweepTruthConfig
from sightline.jobs.progress import track
from sightline.ops.roi_points import roi_points
from sightline.ops.rotated_iou import pairwise_iou_3d, pairwise_iou_bev
from sightline.papers.two_stage import COURSE

NUM_SAMPLES: Final = 64
_FOREGROUND, _BACKGROUND, _EASY, _HALF = 0.55, 0.45, 0.05, 0.5
_COUNTS: Final = (10, 20, 50, 100)


class Frame(NamedTuple):
    """Proposals of a frame with the objects to find."""

    sweep: Sweep
    proposed: Proposed
    truth: SweepTruth


def main(data: Path, cache: Path, sample_list: str | None = None, *, training: bool = True) -> None:
    """Print the figures of a cache's proposals.

    Args:
        data: KITTI object tree with labels.
        cache: Folder of the proposals.
        sample_list: List of frames. None: all.
        training: Whether to use the 300 proposals for training, or the 100 for scoring.
    """
    torch.set_num_threads(1)
    frames = list(_frames(data, cache, sample_list, training=training))
    results = {
        **_offered(frames),
        **_recall(frames),
        **_suppressed(frames),
    }
    for name, value in results.items():
        print(f"{name:<44}{value:10.3f}")
    print_record({"frames": len(frames), "training": training, "results": results}, seed=None)


def _frames(data: Path, cache: Path, sample_list: str | None, *, training: bool) -> Iterator[Frame]:
    dataset = open_dataset(data, sample_list=sample_list, parts={"points", "objects"})
    settings = Detection3DExampleConfig(changes=None, targets=SweepTruthConfig(min_points=3))
    examples = Detection3DExamples(settings, cache).for_network(COURSE)
    rng = np.random.default_rng(0)
    for index in track(range(len(dataset)), description="frames"):
        batch = examples.prepare(dataset[index], rng, training=training)
        assert batch.records is not None, "read from the cache"
        proposed, sweep = batch.records[0].proposed, batch.points[0]
        pooled = roi_points(
            sweep[None, :, :3].contiguous(),
            proposed.boxes[None],
            margin_m=COURSE.pooling.margin_m,
            count=1,
            seed=0,
        )
        kept = pooled.num_inside[0] > 0
        yield Frame(sweep, proposed.select(kept), batch.truths[0])


def _offered(frames: Sequence[Frame]) -> dict[str, float]:
    """Mean numbers of proposals by kind, and of the samples by each way to draw them."""
    kinds = np.array([_kinds(frame) for frame in frames])
    foreground, between, hard, easy, half = kinds.T
    total = foreground + between + hard + easy
    share = NUM_SAMPLES / np.maximum(total, 1)
    drawn_foreground = np.minimum(foreground, NUM_SAMPLES // 2)
    background = NUM_SAMPLES - drawn_foreground
    objects = np.array([len(frame.truth.boxes) for frame in frames])
    best = np.concatenate([_best_iou(frame) for frame in frames])
    return {
        "proposals": total.mean(),
        "foreground, IoU 0.55 or more": foreground.mean(),
        "between 0.45 and 0.55": between.mean(),
        "hard background, 0.05 to 0.45": hard.mean(),
        "easy background, below 0.05": easy.mean(),
        "objects": objects.mean(),
        "frames without foreground, %": 100 * (foreground == 0).mean(),
        "frames without hard background, %": 100 * (hard == 0).mean(),
        "objects with a foreground proposal, %": 100 * (best >= _FOREGROUND).mean(),
        "objects with a best proposal from 0 to 0.55, %": 100
        * ((best > 1e-9) & (best < _FOREGROUND)).mean(),
        "as asked: foreground of 64": drawn_foreground.mean(),
        "as asked: hard of 64": np.where(hard > 0, background // 2, 0).mean(),
        "(1) foreground of 64": (share * foreground).mean(),
        "(1) hard of 64": (share * hard).mean(),
        "(1) frames with less than 1 foreground, %": 100 * (share * foreground < 1).mean(),
        "(2) repeats of a hard one": (background / np.maximum(hard, 1))[hard > 0].mean(),
        "(3) proposals within 0.05 of the limit 0.5": half.mean(),
        "(3) the same, of those at 0.5 or more, %": 100
        * _share(frames, _HALF, _FOREGROUND, _HALF, 1.01),
    }


def _kinds(frame: Frame) -> tuple[int, int, int, int, int]:
    """Count the proposals: foreground, between, hard, easy, and within 0.05 of 0.5."""
    iou = _own_iou(frame)
    counts = (
        iou >= _FOREGROUND,
        (iou >= _BACKGROUND) & (iou < _FOREGROUND),
        (iou >= _EASY) & (iou < _BACKGROUND),
        iou < _EASY,
        (iou >= _HALF - 0.05) & (iou < _HALF + 0.05),
    )
    a, b, c, d, e = (int(each.sum()) for each in counts)
    return a, b, c, d, e


def _own_iou(frame: Frame) -> Float[Tensor, " num_proposals"]:
    iou = pairwise_iou_3d(frame.proposed.boxes.double(), frame.truth.boxes)
    return assign_truths(iou, frame.truth.boxes).iou


def _best_iou(frame: Frame) -> Float[np.ndarray, " num_objects"]:
    if len(frame.proposed.boxes) == 0:
        return np.zeros(len(frame.truth.boxes))
    iou = pairwise_iou_3d(frame.proposed.boxes.double(), frame.truth.boxes)
    return iou.amax(dim=0).numpy()


def _share(
    frames: Sequence[Frame], low: float, high: float, all_low: float, all_high: float
) -> float:
    """Share of the proposals with an IoU in [low, high) among those in [all_low, all_high)."""
    iou = torch.cat([_own_iou(frame) for frame in frames])
    inside = ((iou >= low) & (iou < high)).sum()
    return float(inside / ((iou >= all_low) & (iou < all_high)).sum().clamp(min=1))


def _recall(frames: Sequence[Frame]) -> dict[str, float]:
    """Recall at IoU 0.5 by the number of proposals, and the share of proposals on an object."""
    results = {}
    for count in _COUNTS:
        best, on_object = [], []
        for frame in frames:
            order = torch.argsort(frame.proposed.scores, descending=True, stable=True)
            few = _with_rows(frame, order[:count])
            best.append(_best_iou(few))
            on_object.append(_own_iou(few).numpy() >= _HALF)
        found = np.concatenate(best) >= _HALF
        results[f"recall at 0.5, {count} proposals, %"] = 100 * found.mean()
        results[f"proposals on an object, of {count}, %"] = 100 * np.concatenate(on_object).mean()
    return results


def _with_rows(frame: Frame, rows: Tensor) -> Frame:
    """Select some proposals of a frame."""
    return frame._replace(proposed=frame.proposed.select(rows))


def _suppressed(frames: Sequence[Frame]) -> dict[str, float]:
    """Boxes that greedy suppression at IoU 0.1 leaves, by the overlap from above and in 3D."""
    left = {"from above": 0, "in 3D": 0}
    objects_over = 0
    for frame in frames:
        sure = _with_rows(frame, frame.proposed.scores >= COURSE.suppression.min_score)
        boxes = sure.proposed.boxes.double()
        overlaps = {
            "from above": pairwise_iou_bev(_from_above(boxes), _from_above(boxes)),
            "in 3D": pairwise_iou_3d(boxes, boxes),
        }
        order = torch.argsort(sure.proposed.scores, descending=True, stable=True)
        for name, iou in overlaps.items():
            left[name] += _keep(iou[order][:, order])
        truths = _from_above(frame.truth.boxes)
        between = pairwise_iou_bev(truths, truths).triu(diagonal=1)
        objects_over += int((between >= COURSE.suppression.iou).sum())
    return {
        **{f"boxes after suppression {name}": n / len(frames) for name, n in left.items()},
        "pairs of objects with 0.1 or more from above": objects_over,
    }


def _from_above(boxes: Float[Tensor, "num_boxes 7"]) -> Float[Tensor, "num_boxes 5"]:
    return boxes[:, [0, 1, 3, 4, 6]]


def _keep(iou: Float[Tensor, "num_boxes num_boxes"]) -> int:
    """Count the boxes, in order, that no earlier kept one overlaps."""
    kept: list[int] = []
    for place in range(len(iou)):
        if not any(iou[place, other] >= COURSE.suppression.iou for other in kept):
            kept.append(place)
    return len(kept)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
