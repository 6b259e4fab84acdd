"""Overlap of upright 3D boxes in plain PyTorch: for every device, and for gradients.

The formula is that of `rotated_iou_kernel`. Its gradient is explicit and not from autograd: moving
a boundary outwards by one metre adds its length inside the other box to the shared area. This stays
finite where edges are parallel and the slopes of the formula are not.
"""

import torch
from jaxtyping import Float64
from torch import Tensor

Rows = Float64[Tensor, "*#pairs 7"]
"""x, y, z, length, width, height, yaw; two sets broadcast against each other."""

ALONG = (1.0, 1.0, -1.0, -1.0)  # corners counter-clockwise; edge k runs from corner k to k + 1,
ACROSS = (-1.0, 1.0, 1.0, -1.0)  # so the edges are front, left, back, right


def iou(a: Rows, b: Rows) -> Float64[Tensor, "*pairs"]:
    """Compute the IoU; 0 if both boxes are empty. Its gradient is `iou_gradients`."""
    shared, union = _shared_and_union(a, b)
    return torch.where(union > 0, shared / _nonzero(union), 0).clamp(0, 1)


def iou_gradients(a: Rows, b: Rows) -> tuple[Rows, Rows]:
    """Compute derivatives of each pair's IoU with respect to a and b, broadcast to all pairs.

    At a kink of the IoU (collinear edges, for example) it is a mean of the one-sided derivatives,
    so that two identical boxes have gradient 0; with a union of 0 it is 0.
    """
    shared, union = _shared_and_union(a, b)
    scale = torch.where(union > 0, 1 / _nonzero(union), 0)[..., None]
    ratio = shared[..., None] * scale
    by_a, by_b = _shared_gradient(b, a), _shared_gradient(a, b)
    return (
        (1 + ratio) * by_a * scale - ratio * (_volume_gradient(a) * scale),
        (1 + ratio) * by_b * scale - ratio * (_volume_gradient(b) * scale),
    )


def _shared_and_union(
    a: Rows, b: Rows
) -> tuple[Float64[Tensor, "*pairs"], Float64[Tensor, "*pairs"]]:
    shared = _shared_area(a, b) * _shared_height(a, b)
    return shared, a[..., 3:6].prod(-1) + b[..., 3:6].prod(-1) - shared


def _nonzero(values: Tensor) -> Tensor:
    """Replace zero divisors; the results are discarded there."""
    return torch.where(values == 0, 1, values)


def _shared_height(a: Rows, b: Rows) -> Float64[Tensor, "*pairs"]:
    dz, half_a, half_b = b[..., 2] - a[..., 2], a[..., 5] / 2, b[..., 5] / 2
    top, bottom = torch.minimum(half_a, dz + half_b), torch.maximum(-half_a, dz - half_b)
    return (top - bottom).clamp(min=0)


def _shared_area(a: Rows, b: Rows) -> Float64[Tensor, "*pairs"]:
    """Integrate clamp(u, -l/2, l/2) dv over b's outline, |v| <= w/2, in the frame of a."""
    u0, v0 = _corners(a, b)
    u1, v1 = u0.roll(-1, -1), v0.roll(-1, -1)
    half_l, half_w = a[..., 3, None] / 2, a[..., 4, None] / 2
    va, vb = _clamp(v0, half_w), _clamp(v1, half_w)
    rise = _nonzero(v1 - v0)
    ua, ub = u0 + (u1 - u0) * ((va - v0) / rise), u1 + (u1 - u0) * ((vb - v1) / rise)
    ca, cb = _clamp(ua, half_l), _clamp(ub, half_l)
    integral = ca * (ca - ua) + (ca + cb) / 2 * (cb - ca) + cb * (ub - cb)
    sloped = (ca != cb) & ((ca != ua) | (cb != ub))
    mean = torch.where(sloped, integral / _nonzero(ub - ua), (ca + cb) / 2)
    limit = torch.minimum(a[..., 3] * a[..., 4], b[..., 3] * b[..., 4])
    area = torch.minimum((mean * (vb - va)).sum(-1).clamp(min=0), limit)
    return torch.where(_distance(a, b) < _radius(a) + _radius(b), area, 0)


def _clamp(values: Tensor, bound: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(values, -bound), bound)


def _distance(a: Rows, b: Rows) -> Float64[Tensor, "*pairs"]:
    return torch.hypot(b[..., 0] - a[..., 0], b[..., 1] - a[..., 1])


def _radius(a: Rows) -> Tensor:
    return torch.hypot(a[..., 3], a[..., 4]) / 2


def _corners(a: Rows, b: Rows) -> tuple[Float64[Tensor, "*pairs 4"], Float64[Tensor, "*pairs 4"]]:
    """Compute the corners of b in the frame of a: along it, and across it."""
    dx, dy = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1]
    cos_a, sin_a = a[..., 6].cos(), a[..., 6].sin()
    u, v = cos_a * dx + sin_a * dy, cos_a * dy - sin_a * dx
    turn = b[..., 6] - a[..., 6]
    cos, sin = turn.cos()[..., None], turn.sin()[..., None]
    along = b[..., 3, None] / 2 * b.new_tensor(ALONG)
    across = b[..., 4, None] / 2 * b.new_tensor(ACROSS)
    return u[..., None] + cos * along - sin * across, v[..., None] + sin * along + cos * across


def _shared_gradient(a: Rows, b: Rows) -> Rows:
    """Compute derivatives of the shared volume with respect to b."""
    area, height = _shared_area(a, b)[..., None], _shared_height(a, b)[..., None]
    by_height = torch.where(height > 0, _height_gradient(a, b), 0)
    return _area_gradient(a, b) * height + by_height * area


def _area_gradient(a: Rows, b: Rows) -> Rows:
    share, middle = _edges_inside(a, b)
    edges = b[..., [4, 3, 4, 3]]
    inside = share * edges
    front, left, back, right = inside.unbind(-1)
    ahead, aside = front - back, left - right
    cos, sin = b[..., 6].cos(), b[..., 6].sin()
    by_x, by_y = cos * ahead - sin * aside, sin * ahead + cos * aside
    by_yaw = -(inside * (middle - 0.5) * edges).sum(-1)  # the far ends of an edge move outwards
    none = torch.zeros_like(by_x)
    return torch.stack(
        (by_x, by_y, none, (front + back) / 2, (left + right) / 2, none, by_yaw), dim=-1
    )


def _height_gradient(a: Rows, b: Rows) -> Rows:
    half_a, half_b, dz = a[..., 5] / 2, b[..., 5] / 2, b[..., 2] - a[..., 2]
    tie = half_a.new_tensor(0.5)
    top = torch.heaviside(half_a - half_b - dz, tie)  # 1 if b's top is lower
    bottom = torch.heaviside(dz - half_b + half_a, tie)
    none = torch.zeros_like(top)
    return torch.stack((none, none, top - bottom, none, none, (top + bottom) / 2, none), dim=-1)


def _edges_inside(
    a: Rows, b: Rows
) -> tuple[Float64[Tensor, "*pairs 4"], Float64[Tensor, "*pairs 4"]]:
    """Compute the share of each edge of b inside a, and that part's middle on the edge (0 to 1).

    Clipping after Liang and Barsky 1984. An edge on the outline of a counts half.
    """
    u, v = _corners(a, b)
    enter_u, leave_u, weight_u = _stay_between(u, u.roll(-1, -1), a[..., 3, None] / 2)
    enter_v, leave_v, weight_v = _stay_between(v, v.roll(-1, -1), a[..., 4, None] / 2)
    enter, leave = torch.maximum(enter_u, enter_v), torch.minimum(leave_u, leave_v)
    share = (leave - enter).clamp(min=0) * weight_u * weight_v
    return share, (enter + leave) / 2


def _stay_between(start: Tensor, end: Tensor, bound: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Compute when (0 to 1) a moving number enters and leaves [-bound, bound]; weight at rest."""
    way = end - start
    first, second = (-bound - start) / _nonzero(way), (bound - start) / _nonzero(way)
    rests = way == 0
    weight = torch.heaviside(bound - start.abs(), bound.new_tensor(0.5))
    return (
        torch.where(rests, 0, torch.minimum(first, second).clamp(0, 1)),
        torch.where(rests, 1, torch.maximum(first, second).clamp(0, 1)),
        torch.where(rests, weight, 1),
    )


def _volume_gradient(a: Rows) -> Rows:
    length, width, height = a[..., 3], a[..., 4], a[..., 5]
    none = torch.zeros_like(length)
    by_size = (width * height, length * height, length * width)
    return torch.stack((none, none, none, *by_size, none), dim=-1)
