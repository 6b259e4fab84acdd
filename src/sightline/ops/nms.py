"""Greedy non-maximum suppression of boxes in the image, and of rotated boxes seen from above.

Boxes are visited by descending score, then ascending index. A box is dropped if its IoU with a kept
box is greater than the threshold (torchvision's rule: equal is kept). The result is the kept
indices in that order, the same on every run. With `labels`, only boxes of the same label suppress
each other. IoUs are computed in float64; a box with a size of 0 has IoU 0 with everything, so it is
kept and suppresses nothing. There is no gradient.

On a CPU a compiled kernel takes O(kept * n) time and O(n) memory; on other devices plain PyTorch
takes some launches, and one synchronisation, per kept box.
"""

import torch
from jaxtyping import Float, Float64, Int, Int64
from torch import Tensor, library

from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.ops import nms_kernel, rotated_iou_torch
from sightline.ops.box_rows import checked_box_rows
from sightline.ops.operator import operator
from sightline.ops.rotated_iou_kernel import LARGEST


def nms2d(
    boxes: Float[Tensor, "n 4"],
    scores: Float[Tensor, " n"],
    iou_threshold: float,
    *,
    labels: Int[Tensor, " n"] | None = None,
    max_detections: int | None = None,
) -> Int64[Tensor, " kept"]:
    """Select boxes x_min, y_min, x_max, y_max: indices of the kept ones by descending score.

    Raises:
        ValueError: Lengths differ, a score is NaN, labels are no integers, a box is not finite or
            has its corners swapped, or a setting is out of range.
    """
    _require_settings(boxes, scores, labels, iou_threshold, max_detections, columns=4)
    kept: Tensor = _nms(boxes, scores, labels, iou_threshold, max_detections)
    return kept


def nms_bev(
    boxes: Float[Tensor, "n 5"],
    scores: Float[Tensor, " n"],
    iou_threshold: float,
    *,
    labels: Int[Tensor, " n"] | None = None,
    max_detections: int | None = None,
) -> Int64[Tensor, " kept"]:
    """Select rotated boxes x, y, length, width, yaw: indices of the kept ones by descending score.

    Raises:
        ValueError: Lengths differ, a score is NaN, labels are no integers, a box is not finite or
            has a negative size, or a setting is out of range.
    """
    _require_settings(boxes, scores, labels, iou_threshold, max_detections, columns=5)
    kept: Tensor = _nms(boxes, scores, labels, iou_threshold, max_detections)
    return kept


def _require_settings(
    boxes: Tensor,
    scores: Tensor,
    labels: Tensor | None,
    iou_threshold: float,
    max_detections: int | None,
    *,
    columns: int,
) -> None:
    if boxes.ndim != 2 or boxes.shape[1] != columns or not boxes.is_floating_point():
        raise ValueError(
            f"boxes must be a floating-point tensor of n rows with {columns} values each, got "
            f"{boxes.dtype} of shape {tuple(boxes.shape)}"
        )
    for name, values in (("scores", scores), ("labels", labels)):
        if values is not None and values.shape != boxes.shape[:1]:
            raise ValueError(
                f"{name} must hold one value for each of the {boxes.shape[0]} boxes, got shape "
                f"{tuple(values.shape)}"
            )
    if labels is not None and (labels.is_floating_point() or labels.is_complex()):
        raise ValueError(f"labels must be whole numbers, got {labels.dtype}: cast them first")
    if not 0 <= iou_threshold <= 1:
        raise ValueError(f"iou_threshold must be between 0 and 1, got {iou_threshold}")
    if max_detections is not None and max_detections < 0:
        raise ValueError(f"max_detections must not be negative, got {max_detections}")


@operator("nms")
def _nms(
    boxes: Tensor,
    scores: Tensor,
    labels: Tensor | None,
    iou_threshold: float,
    max_detections: int | None,
) -> Tensor:
    if bool(scores.isnan().any()):
        raise ValueError(f"scores[{int(scores.isnan().int().argmax())}] is NaN: drop such boxes")
    rows = _checked_boxes2d(boxes) if boxes.shape[1] == 4 else checked_box_rows(boxes, "boxes")
    order = scores.argsort(descending=True, stable=True)
    labels = torch.zeros_like(order) if labels is None else labels.to(torch.int64)
    limit = boxes.shape[0] if max_detections is None else max_detections
    suppress = _suppress_by_kernel if rows.is_cpu else _suppress_by_torch
    return order[suppress(rows[order], labels[order], iou_threshold, limit)]


@_nms.register_fake
def _(
    boxes: Tensor,
    scores: Tensor,
    labels: Tensor | None,
    iou_threshold: float,
    max_detections: int | None,
) -> Tensor:
    del scores, labels, iou_threshold, max_detections
    kept = library.get_ctx().new_dynamic_size()
    return boxes.new_empty(kept, dtype=torch.int64)


def _checked_boxes2d(boxes: Tensor) -> Float64[Tensor, "n 4"]:
    rows = boxes.detach().double()
    good = (rows.abs() <= LARGEST).all(dim=1) & (rows[:, 2:] >= rows[:, :2]).all(dim=1)
    if not bool(good.all()):
        bad = int(good.int().argmin())
        raise ValueError(
            f"boxes[{bad}] is {boxes[bad].tolist()}, but values must be finite (up to {LARGEST:g}) "
            "and x_min, y_min must not exceed x_max, y_max: drop such boxes first"
        )
    return rows


def _suppress_by_kernel(
    rows: Float64[Tensor, "n columns"],
    labels: Int64[Tensor, " n"],
    iou_threshold: float,
    max_detections: int,
) -> Int64[Tensor, " kept"]:
    """Select rows of boxes, sorted by descending score, with a kernel."""
    axis_aligned = rows.shape[1] == 4
    kernel = nms_kernel.suppress_axis_aligned if axis_aligned else nms_kernel.suppress_rotated
    return torch.from_numpy(kernel(rows.numpy(), labels.numpy(), iou_threshold, max_detections))


def _suppress_by_torch(
    rows: Float64[Tensor, "n columns"],
    labels: Int64[Tensor, " n"],
    iou_threshold: float,
    max_detections: int,
) -> Int64[Tensor, " kept"]:
    """Select rows of boxes, sorted by descending score, without a kernel."""
    waiting = torch.arange(rows.shape[0], device=rows.device)
    kept = [waiting[:0]]
    while len(kept) <= max_detections and waiting.numel() > 0:
        best, rest = waiting[:1], waiting[1:]
        if rows.shape[1] == 4:
            iou = pairwise_iou2d(Boxes2D(rows[best]), Boxes2D(rows[rest]))[0]
        else:
            iou = rotated_iou_torch.iou(rows[best], rows[rest])
        kept.append(best)
        waiting = rest[(iou <= iou_threshold) | (labels[rest] != labels[best])]
    return torch.cat(kept)
