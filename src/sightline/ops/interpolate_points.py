"""Interpolation of features from the three nearest points."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import BackwardCFunction

from sightline.ops.gather_kernel import add_weighted_to_rows, weighted_sums
from sightline.ops.group_points import KERNEL_DTYPES, flat_rows, gather_rows
from sightline.ops.operator import operator
from sightline.ops.point_checks import require_features
from sightline.ops.three_nearest import ThreeNearest

_MIN_SQUARED_DISTANCE_M2 = 1e-10  # a query on a point gets its features to within about 1e-8


def interpolate_points(
    features: Float[Tensor, "batch num_points channels"], nearest: ThreeNearest
) -> Float[Tensor, "batch num_queries channels"]:
    """Average the features of three points, weighted by their inverse squared distances.

    Qi et al. 2017 (PointNet++), eq. 2 with k = 3 and p = 2. A cloud with fewer points uses those.
    Differentiable with respect to the features alone, with sums in the same order on every run on a
    CPU.

    Raises:
        ValueError: Batch sizes differ, an index is out of range, or a shape is wrong.
    """
    index, squared_distance = nearest
    require_features(features, index)
    if index.ndim != 3 or index.shape[2] != 3 or index.shape != squared_distance.shape:
        raise ValueError(
            "nearest must hold three indices and as many distances for each query, got shapes "
            f"{tuple(index.shape)} and {tuple(squared_distance.shape)}"
        )
    closeness = 1 / squared_distance.clamp(min=_MIN_SQUARED_DISTANCE_M2)
    weights = (closeness / closeness.sum(dim=2, keepdim=True)).to(features.dtype)
    if torch.compiler.is_exporting():  # other engines lack Sightline's operators
        return (gather_rows(features, index) * weights[..., None]).sum(dim=2)
    interpolated: Tensor = _interpolate_points(features, index, weights)
    return interpolated


@operator("interpolate_points")
def _interpolate_points(features: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    batch, num_queries, _ = index.shape
    rows = flat_rows(index, features.shape[1]).reshape(-1, 3)
    source, flat_weights = features.flatten(0, 1), weights.reshape(-1, 3)
    if features.is_cpu and features.dtype in KERNEL_DTYPES:
        sums = features.new_empty((rows.shape[0], features.shape[2]))
        weighted_sums(
            source.contiguous().numpy(),
            rows.numpy(),
            flat_weights.contiguous().numpy(),
            sums.numpy(),
        )
    else:
        sums = (source[rows] * flat_weights[..., None]).sum(dim=1)
    return sums.reshape(batch, num_queries, features.shape[2])


@_interpolate_points.register_fake
def _(features: Tensor, index: Tensor, weights: Tensor) -> Tensor:
    del weights
    return features.new_empty((*index.shape[:2], features.shape[2]))


@operator("interpolate_points_backward")
def _interpolate_points_backward(
    by_sums: Tensor, index: Tensor, weights: Tensor, num_points: int
) -> Tensor:
    batch, _, channels = by_sums.shape
    rows, flat = flat_rows(index, num_points).reshape(-1, 3), by_sums.flatten(0, 1)
    flat_weights = weights.reshape(-1, 3)
    total = by_sums.new_zeros((batch * num_points, channels))
    if flat.is_cpu and flat.dtype in KERNEL_DTYPES:
        add_weighted_to_rows(
            flat.contiguous().numpy(),
            rows.numpy(),
            flat_weights.contiguous().numpy(),
            total.numpy(),
        )
    else:
        weighted = flat[:, None] * flat_weights[..., None]
        total.index_add_(0, rows.reshape(-1), weighted.reshape(-1, channels))
    return total.reshape(batch, num_points, channels)


@_interpolate_points_backward.register_fake
def _(by_sums: Tensor, index: Tensor, weights: Tensor, num_points: int) -> Tensor:
    del weights
    return by_sums.new_empty((index.shape[0], num_points, by_sums.shape[2]))


def _save(ctx: BackwardCFunction, inputs: tuple[Tensor, Tensor, Tensor], output: Tensor) -> None:
    del output
    features, index, weights = inputs
    ctx.save_for_backward(index, weights)
    ctx.num_points = features.shape[1]  # type: ignore[attr-defined]


def _backward(ctx: BackwardCFunction, by_sums: Tensor) -> tuple[Tensor, None, None]:
    saved: tuple[Tensor, ...] = ctx.saved_tensors
    index, weights = saved
    num_points: int = ctx.num_points  # type: ignore[attr-defined]
    return _interpolate_points_backward(by_sums, index, weights, num_points), None, None


_interpolate_points.register_autograd(_backward, setup_context=_save)
