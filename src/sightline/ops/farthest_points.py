"""Farthest point sampling: a spread-out subset of a point cloud."""

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, library

from sightline.ops.farthest_points_kernel import sample_farthest
from sightline.ops.point_checks import checked_points, require_points


def farthest_points(
    points: Float[Tensor, "batch num_points 3"], count: int
) -> Int64[Tensor, "batch {count}"]:
    """Select `count` points of each cloud [m], each the farthest from those before it.

    Eldar et al. 1997. The first is point 0; of equally far points, the first in order is used, so
    the result is the same on every run and device. If all remaining points coincide with selected
    ones (too few points, or copies), point 0 is repeated. Distances are computed in float32. There
    is no gradient.

    On a CPU a compiled kernel skips most of the points in each step, as Han et al. 2023 (QuickFPS)
    do, and gives exactly the result of the plain method; on other devices plain PyTorch uses some
    launches per selected point.

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


@library.custom_op("sightline::farthest_points", mutates_args=())
def _farthest_points(points: Tensor, count: int) -> Tensor:
    clouds = checked_points(points, "points")
    if count == 0 or clouds.shape[0] == 0:
        return points.new_zeros((points.shape[0], count), dtype=torch.int64)
    if not clouds.is_cpu:
        return sample_by_torch(clouds, count)
    taken = [torch.from_numpy(sample_farthest(cloud.numpy(), count)) for cloud in clouds]
    return torch.stack(taken)


@_farthest_points.register_fake
def _(points: Tensor, count: int) -> Tensor:
    return points.new_empty((points.shape[0], count), dtype=torch.int64)


def sample_by_torch(
    clouds: Float32[Tensor, "batch num_points 3"], count: int
) -> Int64[Tensor, "batch {count}"]:
    """Select the points of `farthest_points` without a kernel: all distances in every step."""
    x, y, z = clouds.unbind(2)
    nearest = torch.full_like(x, torch.inf)
    current = torch.zeros_like(x[:, :1], dtype=torch.int64)
    taken = []
    for _ in range(count):
        taken.append(current)
        dx, dy, dz = (column - column.gather(1, current) for column in (x, y, z))
        # the kernel's roundings: equal distances are equal in both
        nearest = torch.minimum(nearest, dx * dx + dy * dy + dz * dz)
        farthest = nearest.amax(dim=1, keepdim=True)
        # argmax does not define which of several it returns
        current = (nearest == farthest).int().cumsum(dim=1).eq(0).sum(dim=1, keepdim=True)
    return torch.cat(taken, dim=1)
