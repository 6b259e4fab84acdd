"""Searches in point clouds by plain PyTorch: all distances, for clouds too large for loops."""

import torch
from jaxtyping import Float32, Int64
from torch import Tensor


def farthest_points(
    clouds: Float32[Tensor, "batch num_points 3"], count: int
) -> Int64[Tensor, "batch {count}"]:
    """Farthest points of several clouds: all distances in every step."""
    x, y, z = clouds.unbind(2)
    nearest = torch.full_like(x, torch.inf)
    current = torch.zeros_like(x[:, :1], dtype=torch.int64)
    taken = []
    for _ in range(count):
        taken.append(current)
        dx, dy, dz = (column - column.gather(1, current) for column in (x, y, z))
        nearest = torch.minimum(nearest, dx * dx + dy * dy + dz * dz)
        farthest = nearest.amax(dim=1, keepdim=True)
        # argmax does not define which of several it returns
        current = (nearest == farthest).int().cumsum(dim=1).eq(0).sum(dim=1, keepdim=True)
    return torch.cat(taken, dim=1)


def ball_query(
    points: Float32[Tensor, "num_points 3"],
    centers: Float32[Tensor, "num_centers 3"],
    radius_m: float,
    count: int,
) -> tuple[Int64[Tensor, "num_centers count"], Int64[Tensor, " num_centers"]]:
    """Indices of the first points around each centre, and their number."""
    num_points = points.shape[0]
    squared_radius = torch.tensor(radius_m, dtype=torch.float32).square()
    dx, dy, dz = (points[None] - centers[:, None]).unbind(2)
    is_near = dx * dx + dy * dy + dz * dz < squared_radius
    # the index if near, else one past the last
    candidates = torch.where(is_near, torch.arange(num_points), num_points)
    first = candidates.topk(min(count, num_points), largest=False, sorted=True).values
    found = (first < num_points).sum(dim=1)
    first = torch.where(first < num_points, first, first[:, :1])
    missing = first[:, :1].expand(-1, count - first.shape[1])
    index = torch.where(found[:, None] > 0, torch.cat((first, missing), dim=1), 0)
    return index, found


def three_nearest(
    points: Float32[Tensor, "num_points 3"], queries: Float32[Tensor, "num_queries 3"]
) -> tuple[Int64[Tensor, "num_queries 3"], Float32[Tensor, "num_queries 3"]]:
    """Indices and squared distances of each query's nearest points."""
    index = torch.zeros(queries.shape, dtype=torch.int64)
    squared_distance = torch.full(queries.shape, torch.inf)
    dx, dy, dz = (points[None] - queries[:, None]).unbind(2)
    distance = dx * dx + dy * dy + dz * dz
    for place in range(min(3, points.shape[0])):
        nearest = distance.amin(dim=1, keepdim=True)
        # argmin does not define which of several it returns
        first = (distance == nearest).int().cumsum(dim=1).eq(0).sum(dim=1, keepdim=True)
        index[:, place], squared_distance[:, place] = first[:, 0], nearest[:, 0]
        distance.scatter_(1, first, torch.inf)
    return index, squared_distance
