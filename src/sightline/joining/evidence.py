"""Numbers that tell how far to trust a box, from both detectors and the returns."""

from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64

from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.joining.scene import Boxes, Scene

SWEEP_COLUMNS: Final = (
    "logit of its score",
    "IoU with the best box in the image",
    "logit of that box's score",
    "IoU times that score",
    "best score at an IoU above 0.5",
    "IoU times score of the best box of another class",
    "range",
    "log of its returns",
    "log of its height in the image",
    "at the image's border",
    "IoU times logit of that box's score",
    "no camera",
    "log of the returns in view",
)
"""Evidence for a box of the sweep detector."""

IMAGE_COLUMNS: Final = (
    "logit of its score",
    "IoU with the best projected box",
    "logit of that box's score",
    "IoU times that score",
    "IoU times score of the best box of another class",
    "log of its height",
    "log of its aspect ratio",
    "at the image's border",
    "log of its returns",
    "no camera",
    "log of the returns in view",
)
"""Evidence for a box of the image detector, beside a sweep."""

ALONE_COLUMNS: Final = IMAGE_COLUMNS[:1]
"""Evidence for a box of the image detector without a LiDAR: its score, so that the order of the
boxes stays the detector's."""

_RANGE_M: Final = 40.0
_HEIGHT_PX: Final = 40.0
_MIN_IOU: Final = 0.05  # below, a box does not concern another one
_CONFIRMING_IOU: Final = 0.5
_BORDER_PX: Final = 1.0
_USUAL_LOG_POINTS: Final = 9.0  # of a whole sweep of 64 beams in KITTI's image: 9.7


class Evidence(NamedTuple):
    """Evidence of a frame, and what it is computed from."""

    sweep: Float64[np.ndarray, "num_sweep 13"]
    """Columns of `SWEEP_COLUMNS`."""
    image: Float64[np.ndarray, "num_image 11"]
    """Columns of `IMAGE_COLUMNS`."""
    iou: Float64[np.ndarray, "num_sweep num_image"]
    """IoU of projected boxes with image boxes; 0 for boxes outside the image."""
    same_class: Bool[np.ndarray, "num_sweep num_image"]


class _Best(NamedTuple):
    """Best box of the other detector for each box; zeros without one."""

    iou: Float64[np.ndarray, " num_boxes"]
    score: Float64[np.ndarray, " num_boxes"]


def gather_evidence(scene: Scene) -> Evidence:
    """Compute the evidence of all boxes of a frame."""
    image, sweep = scene.image, scene.sweep
    iou = image_iou(sweep.in_image, image.in_image)
    same = np.array([[a == b for b in image.names] for a in sweep.names], dtype=bool)
    same = same.reshape(iou.shape)
    num_seen = np.log1p(len(scene.points)) - _USUAL_LOG_POINTS if scene.has_lidar else 0.0
    no_camera = 0.0 if scene.has_camera else 1.0
    agreeing, other = (_best(iou, mask, image.scores) for mask in (same, ~same))
    confirmed = np.where(same & (iou > _CONFIRMING_IOU), image.scores[None], 0.0)
    logits = np.where(agreeing.iou > _MIN_IOU, logit(agreeing.score), logit(0.0))
    sweep_rows = (
        logit(sweep.scores),
        agreeing.iou,
        logits,
        agreeing.iou * agreeing.score,
        confirmed.max(axis=1, initial=0.0),
        other.iou * other.score,
        np.hypot(scene.boxes3d[:, 0], scene.boxes3d[:, 1]) / _RANGE_M,
        np.log1p(sweep.num_points),
        _log_height(sweep),
        _is_at_border(sweep, scene.image_size),
        np.where(agreeing.iou > _MIN_IOU, agreeing.iou * logits, 0.0),
        np.full(len(sweep.scores), no_camera),
        np.full(len(sweep.scores), num_seen),
    )
    agreeing, other = (_best(iou.T, mask.T, sweep.scores) for mask in (same, ~same))
    image_rows = (
        logit(image.scores),
        agreeing.iou,
        np.where(agreeing.iou > _MIN_IOU, logit(agreeing.score), logit(0.0)),
        agreeing.iou * agreeing.score,
        other.iou * other.score,
        _log_height(image),
        _log_aspect(image),
        _is_at_border(image, scene.image_size),
        np.log1p(image.num_points),
        np.full(len(image.scores), no_camera),
        np.full(len(image.scores), num_seen),
    )
    return Evidence(np.stack(sweep_rows, axis=1), np.stack(image_rows, axis=1), iou, same)


def logit(probability: Float64[np.ndarray, "*shape"] | float) -> Float64[np.ndarray, "*shape"]:
    """Compute the log odds of probabilities, limited to 0.001 and 0.999."""
    limited = np.clip(probability, 1e-3, 1 - 1e-3)
    return np.asarray(np.log(limited / (1 - limited)))


def image_iou(
    boxes: Float64[np.ndarray, "num_boxes 4"], others: Float64[np.ndarray, "num_others 4"]
) -> Float64[np.ndarray, "num_boxes num_others"]:
    """Compute the IoU of all pairs of boxes in the image; 0 for boxes outside it (NaN)."""
    iou = pairwise_iou2d(*(Boxes2D(torch.from_numpy(each)) for each in (boxes, others)))
    return np.asarray(np.nan_to_num(iou.numpy()))


def _best(
    iou: Float64[np.ndarray, "num_boxes num_others"],
    mask: Bool[np.ndarray, "num_boxes num_others"],
    scores: Float64[np.ndarray, " num_others"],
) -> _Best:
    """Find the masked box with the largest product of IoU and score."""
    if iou.shape[1] == 0:
        return _Best(np.zeros(len(iou)), np.zeros(len(iou)))
    value = np.where(mask, iou * scores[None], -1.0)
    best, rows = value.argmax(axis=1), np.arange(len(iou))
    is_there = value[rows, best] > 0
    return _Best(np.where(is_there, iou[rows, best], 0.0), np.where(is_there, scores[best], 0.0))


def _sizes(boxes: Boxes) -> Float64[np.ndarray, "num_boxes 2"]:
    sizes = boxes.in_image[:, 2:] - boxes.in_image[:, :2]
    return np.asarray(np.maximum(np.nan_to_num(sizes, nan=1.0), 1.0))


def _log_height(boxes: Boxes) -> Float64[np.ndarray, " num_boxes"]:
    return np.asarray(np.log(_sizes(boxes)[:, 1] / _HEIGHT_PX))


def _log_aspect(boxes: Boxes) -> Float64[np.ndarray, " num_boxes"]:
    sizes = _sizes(boxes)
    return np.asarray(np.log(sizes[:, 0] / sizes[:, 1]))


def _is_at_border(boxes: Boxes, image_size: tuple[int, int]) -> Float64[np.ndarray, " num_boxes"]:
    left, right = boxes.in_image[:, 0], boxes.in_image[:, 2]
    return np.asarray((left <= _BORDER_PX) | (right >= image_size[1] - 1 - _BORDER_PX)) * 1.0
