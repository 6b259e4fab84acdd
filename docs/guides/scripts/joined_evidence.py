"""Evidence of both detectors' boxes, as the fitted models of joined.json take it."""

from typing import Any

import numpy as np

from joined_scene import Boxes, Scene
from kitti_frame import Array

LEAST_IOU, CONFIRMING_IOU = 0.05, 0.5
RANGE_M, HEIGHT_PX, BORDER_PX, USUAL_LOG_POINTS = 40.0, 40.0, 1.0, 9.0


def score(model: dict[str, Any], rows: Array) -> Array:
    """Compute the probability that a logistic model gives."""
    logits = rows @ np.array(model["weights"]) + model["bias"]
    return 1 / (1 + np.exp(-logits.clip(-50, 50)))


def gather(scene: Scene) -> tuple[Array, Array, Array, Array]:
    """Rows of the sweep's boxes and of the image's, their IoU, and whether classes are equal."""
    image, sweep = scene.image, scene.sweep
    iou = overlaps(sweep.in_image, image.in_image)
    same = sweep.names[:, None] == image.names[None]
    has_lidar = len(scene.points) > 0
    seen = np.log1p(len(scene.points)) - USUAL_LOG_POINTS if has_lidar else 0.0
    blind = 0.0 if scene.frame.rgb.any() else 1.0
    fit, other = best(iou, same, image.scores), best(iou, ~same, image.scores)
    logits = np.where(fit[0] > LEAST_IOU, logit(fit[1]), logit(0.0))
    confirmed = np.where(same & (iou > CONFIRMING_IOU), image.scores[None], 0.0)
    count = len(sweep.scores)
    sweep_rows = (
        logit(sweep.scores),
        fit[0],
        logits,
        fit[0] * fit[1],
        confirmed.max(axis=1, initial=0.0),
        other[0] * other[1],
        np.hypot(scene.boxes3d[:, 0], scene.boxes3d[:, 1]) / RANGE_M,
        np.log1p(sweep.returns),
        shape(sweep)[0],
        at_border(sweep, scene.size[1]),
        np.where(fit[0] > LEAST_IOU, fit[0] * logits, 0.0),
        np.full(count, blind),
        np.full(count, seen),
    )
    fit, other = best(iou.T, same.T, sweep.scores), best(iou.T, ~same.T, sweep.scores)
    count = len(image.scores)
    image_rows = (
        logit(image.scores),
        fit[0],
        np.where(fit[0] > LEAST_IOU, logit(fit[1]), logit(0.0)),
        fit[0] * fit[1],
        other[0] * other[1],
        *shape(image),
        at_border(image, scene.size[1]),
        np.log1p(image.returns),
        np.full(count, blind),
        np.full(count, seen),
    )
    return np.stack(sweep_rows, axis=1), np.stack(image_rows, axis=1), iou, same


def logit(probability: Array | float) -> Array:
    """Compute log odds, limited to 0.001 and 0.999."""
    limited = np.clip(probability, 1e-3, 1 - 1e-3)
    return np.log(limited / (1 - limited))


def overlaps(boxes: Array, others: Array) -> Array:
    """Compute the IoU of all pairs; 0 for boxes outside the image."""
    one, two = boxes[:, None], others[None]
    sides = np.minimum(one[..., 2:], two[..., 2:]) - np.maximum(one[..., :2], two[..., :2])
    shared = sides.clip(0).prod(axis=2)
    areas = [(each[..., 2:] - each[..., :2]).clip(0).prod(axis=2) for each in (one, two)]
    union = areas[0] + areas[1] - shared
    return np.nan_to_num(np.divide(shared, union, out=np.zeros_like(union), where=union != 0))


def best(iou: Array, mask: Array, scores: Array) -> tuple[Array, Array]:
    """IoU and score of the masked box with their largest product, for each row."""
    if iou.shape[1] == 0:
        return np.zeros(len(iou)), np.zeros(len(iou))
    value, rows = np.where(mask, iou * scores[None], -1.0), np.arange(len(iou))
    chosen = value.argmax(axis=1)
    is_there = value[rows, chosen] > 0
    return np.where(is_there, iou[rows, chosen], 0.0), np.where(is_there, scores[chosen], 0.0)


def shape(boxes: Boxes) -> tuple[Array, Array]:
    """Log of the height and of the aspect ratio in the image."""
    width, height = np.nan_to_num(boxes.in_image[:, 2:] - boxes.in_image[:, :2], nan=1).clip(1).T
    return np.log(height / HEIGHT_PX), np.log(width / height)


def at_border(boxes: Boxes, width: int) -> Array:
    """Tell whether a box reaches the left or right border."""
    left, right = boxes.in_image[:, 0], boxes.in_image[:, 2]
    return ((left <= BORDER_PX) | (right >= width - 1 - BORDER_PX)) * 1.0
