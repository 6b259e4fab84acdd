"""Intersection over union of rotated rectangles (bird's-eye view) and of upright 3D boxes.

A BEV box is x, y, length, width, yaw; a 3D box x, y, z, length, width, height, yaw: metres,
radians, geometric centre, length along the heading, yaw counter-clockwise from above.

For all three functions:

- Results lie in [0, 1]. They are computed in float64 (within 1e-9 of exact, at any distance from
  the origin) and returned in the wider type of the two inputs. Boxes that only touch, and boxes
  with a size of 0, have IoU 0.
- They are differentiable with respect to both sets of boxes. The gradient is always finite: at a
  kink it is a mean of the one-sided derivatives, 0 for two identical boxes; it is 0 for disjoint
  boxes. There is no second derivative.
- A NaN, an infinity, a value beyond 1e100 or a negative size is a `ValueError`. This check
  synchronises with the device.
- On a CPU a compiled kernel computes them, on one thread and without memory beyond the result; on
  other devices and for gradients plain PyTorch does, with some kilobytes per pair.
"""

import torch
from jaxtyping import Float, Float64
from torch import Tensor
from torch.autograd.function import BackwardCFunction

from sightline.ops import rotated_iou_kernel, rotated_iou_torch
from sightline.ops.box_rows import box_rows, checked_box_rows, checked_numpy_rows
from sightline.ops.operator import operator

_BEV_COLUMNS = [0, 1, 3, 4, 6]  # columns of a 3D box


def pairwise_iou_bev(
    boxes_a: Float[Tensor, "n 5"], boxes_b: Float[Tensor, "m 5"]
) -> Float[Tensor, "n m"]:
    """IoU of every rectangle of one set with every rectangle of the other."""
    _require_columns(boxes_a, boxes_b, columns=5)
    iou: Tensor = _pairwise_iou(boxes_a, boxes_b)
    return iou


def pairwise_iou_3d(
    boxes_a: Float[Tensor, "n 7"], boxes_b: Float[Tensor, "m 7"]
) -> Float[Tensor, "n m"]:
    """IoU of every 3D box of one set with every 3D box of the other."""
    _require_columns(boxes_a, boxes_b, columns=7)
    iou: Tensor = _pairwise_iou(boxes_a, boxes_b)
    return iou


def aligned_iou_3d(
    boxes_a: Float[Tensor, "n 7"], boxes_b: Float[Tensor, "n 7"]
) -> Float[Tensor, " n"]:
    """IoU of each 3D box with the 3D box in the same row of the other set."""
    _require_columns(boxes_a, boxes_b, columns=7)
    if boxes_a.shape[0] != boxes_b.shape[0]:
        raise ValueError(
            f"boxes_a has {boxes_a.shape[0]} rows and boxes_b {boxes_b.shape[0]}; they must have "
            "equally many: use the pairwise function to compare all with all"
        )
    iou: Tensor = _aligned_iou(boxes_a, boxes_b)
    return iou


def _require_columns(boxes_a: Tensor, boxes_b: Tensor, *, columns: int) -> None:
    for name, boxes in (("boxes_a", boxes_a), ("boxes_b", boxes_b)):
        if boxes.ndim != 2 or boxes.shape[1] != columns or not boxes.is_floating_point():
            raise ValueError(
                f"{name} must be a floating-point tensor of n rows with {columns} values each, got "
                f"{boxes.dtype} of shape {tuple(boxes.shape)}"
            )


@operator("pairwise_iou")
def _pairwise_iou(boxes_a: Tensor, boxes_b: Tensor) -> Tensor:
    if boxes_a.is_cpu:
        rows_a = checked_numpy_rows(boxes_a, "boxes_a")
        rows_b = checked_numpy_rows(boxes_b, "boxes_b")
        iou = torch.from_numpy(rotated_iou_kernel.pairwise_iou(rows_a, rows_b))
    else:
        a, b = checked_box_rows(boxes_a, "boxes_a"), checked_box_rows(boxes_b, "boxes_b")
        iou = rotated_iou_torch.iou(a[:, None], b[None])
    return iou.to(torch.promote_types(boxes_a.dtype, boxes_b.dtype))


@operator("aligned_iou")
def _aligned_iou(boxes_a: Tensor, boxes_b: Tensor) -> Tensor:
    if boxes_a.is_cpu:
        rows_a = checked_numpy_rows(boxes_a, "boxes_a")
        rows_b = checked_numpy_rows(boxes_b, "boxes_b")
        iou = torch.from_numpy(rotated_iou_kernel.aligned_iou(rows_a, rows_b))
    else:
        a, b = checked_box_rows(boxes_a, "boxes_a"), checked_box_rows(boxes_b, "boxes_b")
        iou = rotated_iou_torch.iou(a, b)
    return iou.to(torch.promote_types(boxes_a.dtype, boxes_b.dtype))


@_pairwise_iou.register_fake
def _(boxes_a: Tensor, boxes_b: Tensor) -> Tensor:
    dtype = torch.promote_types(boxes_a.dtype, boxes_b.dtype)
    return boxes_a.new_empty((boxes_a.shape[0], boxes_b.shape[0]), dtype=dtype)


@_aligned_iou.register_fake
def _(boxes_a: Tensor, boxes_b: Tensor) -> Tensor:
    dtype = torch.promote_types(boxes_a.dtype, boxes_b.dtype)
    return boxes_a.new_empty(boxes_a.shape[0], dtype=dtype)


def _save_boxes(ctx: BackwardCFunction, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    del output
    ctx.save_for_backward(*inputs)


def _pairwise_backward(ctx: BackwardCFunction, by_iou: Tensor) -> tuple[Tensor, Tensor]:
    saved: tuple[Tensor, ...] = ctx.saved_tensors
    boxes_a, boxes_b = saved
    a, b = box_rows(boxes_a)[:, None], box_rows(boxes_b)[None]
    by_a, by_b = rotated_iou_torch.iou_gradients(a, b)
    weight = by_iou.double()[..., None]
    return _like((weight * by_a).sum(1), boxes_a), _like((weight * by_b).sum(0), boxes_b)


def _aligned_backward(ctx: BackwardCFunction, by_iou: Tensor) -> tuple[Tensor, Tensor]:
    saved: tuple[Tensor, ...] = ctx.saved_tensors
    boxes_a, boxes_b = saved
    by_a, by_b = rotated_iou_torch.iou_gradients(box_rows(boxes_a), box_rows(boxes_b))
    weight = by_iou.double()[..., None]
    return _like(weight * by_a, boxes_a), _like(weight * by_b, boxes_b)


_pairwise_iou.register_autograd(_pairwise_backward, setup_context=_save_boxes)
_aligned_iou.register_autograd(_aligned_backward, setup_context=_save_boxes)


def _like(gradient: Float64[Tensor, "n 7"], boxes: Tensor) -> Tensor:
    """Reduce the gradient to the boxes' columns and type."""
    columns = gradient if boxes.shape[1] == 7 else gradient[:, _BEV_COLUMNS]
    return columns.to(boxes.dtype)
