"""Farthest point sampling: a spread-out subset of a point cloud."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.ops.each_sweep import for_each_sweep
from sightline.ops.farthest_points_kernel import sample_farthest
from sightline.ops.operator import operator
from sightline.ops.point_checks import checked_points, require_points


def farthest_points(
    points: Float[Tensor, "batch num_points 3"], count: int
) -> Int64[Tensor, "batch {count}"]:
    """Select `count` points of each cloud [m], each the farthest from those before it.

    Eldar et al. 1997. The first is point 0; of equally far points, the first in order is used, so
    the result is the same on every run and device. If all remaining points coincide with selected
    ones (too few points, or copies), point 0 is repeated. Distances are computed in float32. There
    is no gradient.

    A compiled kernel on the CPU skips most points in each step, as Han et al. 2023 (QuickFPS) do,
    and gives exactly the result of the plain method. Points on another device are copied: the plain
    method needs some twenty launches per selected point there.

    Raises:
        ValueError: A coordinate is not finite, `count` is negative, or there is no point to take.
    """
    require_points(points, "points")
    if count < 0:
        raise ValueError(f"count must not be negative, got {count}")
    if count > 0 and points.shape[1] == 0:
        raise ValueError(f"points is empty, but count is {count}; skip empty sweeps")
    taken: Tensor = _farthest_points(points, count)
    return taken


@operator("farthest_points")
def _farthest_points(points: Tensor, count: int) -> Tensor:
    clouds = checked_points(points, "points").cpu().numpy()
    taken = torch.zeros((points.shape[0], count), dtype=torch.int64)
    if count > 0:
        rows = taken.numpy()

        def sample(sweep: int) -> None:
            rows[sweep] = sample_farthest(clouds[sweep], count)

        for_each_sweep(sample, len(clouds))
    return taken.to(points.device)


@_farthest_points.register_fake
def _(points: Tensor, count: int) -> Tensor:
    return points.new_empty((points.shape[0], count), dtype=torch.int64)
