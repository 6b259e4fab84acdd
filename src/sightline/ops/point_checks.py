"""Checks and conversions of arguments of the point operations."""

from typing import Final

import torch
from jaxtyping import Float32, Float64
from torch import Tensor

LARGEST_M: Final = 1e9
"""Largest accepted coordinate: squared distances stay finite in float32."""


def require_points(points: Tensor, name: str) -> None:
    """Check that a tensor is a batch of points.

    Raises:
        ValueError: Not floating point, or not of shape (batch, number, 3).
    """
    if points.ndim != 3 or points.shape[2] != 3 or not points.is_floating_point():
        raise ValueError(
            f"{name} must be a floating-point tensor of shape (batch, number of points, 3), got "
            f"{points.dtype} of shape {tuple(points.shape)}"
        )


def require_boxes(boxes: Tensor, points: Tensor) -> None:
    """Check that a tensor is a batch of 3D boxes with the points' batch size.

    Raises:
        ValueError: Not floating point, not of shape (batch, number, 7), or of another batch size.
    """
    if boxes.ndim != 3 or boxes.shape[2] != 7 or not boxes.is_floating_point():
        raise ValueError(
            "boxes must be a floating-point tensor of shape (batch, number of boxes, 7), got "
            f"{boxes.dtype} of shape {tuple(boxes.shape)}"
        )
    require_same_batch(("points", points), ("boxes", boxes))


def require_features(features: Tensor, index: Tensor) -> None:
    """Check features of points, and integer indices of points.

    Raises:
        ValueError: A shape or type is wrong, or batch sizes differ.
    """
    if features.ndim != 3 or not features.is_floating_point():
        raise ValueError(
            "features must be a floating-point tensor of shape (batch, number of points, "
            f"channels), got {features.dtype} of shape {tuple(features.shape)}"
        )
    if index.ndim < 1 or index.dtype not in (torch.int64, torch.int32):
        raise ValueError(
            "index must be a tensor of whole numbers of shape (batch, ...), got "
            f"{index.dtype} of shape {tuple(index.shape)}"
        )
    require_same_batch(("features", features), ("index", index))


def require_same_batch(*named: tuple[str, Tensor]) -> None:
    """Check that the first axes of tensors have equal length.

    Raises:
        ValueError: The lengths differ; the message gives each.
    """
    if len({tensor.shape[0] for _, tensor in named}) > 1:
        sizes = ", ".join(f"{name} {tensor.shape[0]}" for name, tensor in named)
        raise ValueError(f"batch sizes differ: {sizes}; give one entry of each for every sweep")


def checked_points(points: Tensor, name: str) -> Float32[Tensor, "batch num_points 3"]:
    """Check points and convert them to float32 without gradient.

    Raises:
        ValueError: A NaN, an infinity or a coordinate beyond 1e9; names the point.
    """
    rows = points.detach().float()  # in float16 the limit itself is infinite
    _require_finite(rows, name)
    return rows.contiguous()


def checked_columns(points: Tensor, name: str) -> Float64[Tensor, "batch 3 num_points"]:
    """Check points and convert them to float64, one row for each of x, y and z.

    Raises:
        ValueError: As `checked_points`.
    """
    rows = points.detach().double()
    _require_finite(rows, name)
    return rows.transpose(1, 2).contiguous()


def _require_finite(points: Tensor, name: str) -> None:
    good = (points.abs() <= LARGEST_M).all(dim=2)
    if not bool(good.all()):
        sweep, row = (~good).nonzero()[0].tolist()
        raise ValueError(
            f"{name}[{sweep}, {row}] is {points[sweep, row].tolist()}, but coordinates must be "
            f"finite (up to {LARGEST_M:g} m): drop such points first"
        )


def checked_batch_boxes(boxes: Tensor, name: str) -> Float64[Tensor, "batch num_boxes 7"]:
    """Check boxes and convert them to float64 without gradient.

    Raises:
        ValueError: A NaN, an infinity, a value beyond 1e9 or a negative size; names the box.
    """
    rows = boxes.detach().double().contiguous()
    good = (rows.abs() <= LARGEST_M).all(dim=2) & (rows[..., 3:6] >= 0).all(dim=2)
    if not bool(good.all()):
        sweep, row = torch.nonzero(~good)[0].tolist()
        raise ValueError(
            f"{name}[{sweep}, {row}] is {boxes[sweep, row].tolist()}, but values must be finite "
            f"(up to {LARGEST_M:g}) and sizes not negative: drop such boxes first"
        )
    return rows
