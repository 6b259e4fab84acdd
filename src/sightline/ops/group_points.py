"""Gathering of the features of selected points."""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import BackwardCFunction

from sightline.ops.gather_kernel import add_to_rows
from sightline.ops.operator import operator
from sightline.ops.point_checks import require_features
from sightline.ops.spare_memory import rows_to_fill

KERNEL_DTYPES = (torch.float32, torch.float64)
"""Types of features for `gather_kernel`; PyTorch gathers other types."""


def group_points(
    features: Float[Tensor, "batch num_points channels"], index: Int64[Tensor, "batch *chosen"]
) -> Float[Tensor, "batch *chosen channels"]:
    """Gather the features of the points given by `index`, separately in every sweep.

    Differentiable with respect to the features: gradients of a repeated point are summed, in the
    same order on every run on a CPU.

    Raises:
        ValueError: Batch sizes differ, an index is out of range, or the arguments are no features
            and index.
    """
    require_features(features, index)
    if torch.compiler.is_exporting():  # other engines lack Sightline's operators
        return gather_rows(features, index)
    grouped: Tensor = _group_points(features, index)
    return grouped


@operator("group_points")
def _group_points(features: Tensor, index: Tensor) -> Tensor:
    rows = flat_rows(index, features.shape[1])
    shape = (*index.shape, features.shape[2])
    source = features.flatten(0, 1)
    if not (features.is_cpu and features.dtype in KERNEL_DTYPES):
        return source[rows].reshape(shape)
    out = torch.from_numpy(rows_to_fill(rows.numel(), source.shape[1], source.numpy().dtype))
    return torch.index_select(source, 0, rows, out=out).reshape(shape)


@_group_points.register_fake
def _(features: Tensor, index: Tensor) -> Tensor:
    return features.new_empty((*index.shape, features.shape[2]))


@operator("group_points_backward")
def _group_points_backward(by_grouped: Tensor, index: Tensor, num_points: int) -> Tensor:
    channels = by_grouped.shape[-1]
    rows, flat = flat_rows(index, num_points), by_grouped.flatten(0, -2)
    total = by_grouped.new_zeros((index.shape[0] * num_points, channels))
    if flat.is_cpu and flat.dtype in KERNEL_DTYPES:
        add_to_rows(flat.contiguous().numpy(), rows.numpy(), total.numpy())
    else:
        total.index_add_(0, rows, flat)
    return total.reshape(index.shape[0], num_points, channels)


@_group_points_backward.register_fake
def _(by_grouped: Tensor, index: Tensor, num_points: int) -> Tensor:
    return by_grouped.new_empty((index.shape[0], num_points, by_grouped.shape[-1]))


def _save(ctx: BackwardCFunction, inputs: tuple[Tensor, Tensor], output: Tensor) -> None:
    del output
    features, index = inputs
    ctx.save_for_backward(index)
    ctx.num_points = features.shape[1]  # type: ignore[attr-defined]


def _backward(ctx: BackwardCFunction, by_grouped: Tensor) -> tuple[Tensor, None]:
    saved: tuple[Tensor, ...] = ctx.saved_tensors
    num_points: int = ctx.num_points  # type: ignore[attr-defined]
    return _group_points_backward(by_grouped, saved[0], num_points), None


_group_points.register_autograd(_backward, setup_context=_save)


def gather_rows(
    features: Float[Tensor, "batch num_points channels"], index: Int64[Tensor, "batch *chosen"]
) -> Float[Tensor, "batch *chosen channels"]:
    """Gather by plain operators, for graphs that leave PyTorch; indices are not checked."""
    batch, num_points, channels = features.shape
    first = torch.arange(batch, device=index.device) * num_points
    rows = index + first.reshape(-1, *([1] * (index.ndim - 1)))
    chosen = features.reshape(-1, channels).index_select(0, rows.reshape(-1))
    return chosen.reshape(*index.shape, channels)


def flat_rows(index: Tensor, num_points: int) -> Int64[Tensor, " num_chosen"]:
    """Convert indices within sweeps to rows of a flattened batch.

    Raises:
        ValueError: An index is out of range.
    """
    if index.numel() > 0 and (int(index.min()) < 0 or int(index.max()) >= num_points):
        raise ValueError(
            f"index must be from 0 to {num_points - 1}, the points of a sweep, got "
            f"{int(index.min())} to {int(index.max())}"
        )
    sweep = torch.arange(index.shape[0], device=index.device) * num_points
    per_sweep = math.prod(index.shape[1:])
    return (index.reshape(index.shape[0], per_sweep) + sweep[:, None]).reshape(-1)
