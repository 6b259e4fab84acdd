"""Layers of point networks, and the backbone: Qi et al. 2017 (PointNet++).

Features lie channels last: a layer is a matrix product over rows, on any device. Centres,
neighbours and interpolation sources depend on the coordinates alone. So they are found before a
network runs (`find`), and exported files contain no search.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import linear

from sightline.detection3d.points.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    PointBackboneConfig,
)
from sightline.ops.ball_query import ball_query
from sightline.ops.farthest_points import farthest_points
from sightline.ops.group_points import group_points
from sightline.ops.interpolate_points import interpolate_points
from sightline.ops.three_nearest import ThreeNearest, three_nearest


class PointFeatures(NamedTuple):
    """Points of a level with their features."""

    points: Float[Tensor, "batch num_points 3"]
    """Point coordinates [m]."""
    features: Float[Tensor, "batch num_points channels"]


class Grouping(NamedTuple):
    """Centres of a level among the points of the finer one, and their neighbours."""

    centers: Int64[Tensor, "batch num_centers"]
    """Indices into the finer level's points."""
    neighbours: tuple[Int64[Tensor, "batch num_centers num_neighbours"], ...]
    """Indices into the finer level's points, for each scale."""


class NormAndRelu(nn.Module):
    """Optional batch normalisation over all rows, and ReLU."""

    def __init__(self, channels: int, *, batch_norm: bool) -> None:
        super().__init__()
        self.norm = nn.BatchNorm1d(channels) if batch_norm else None

    def forward(self, values: Float[Tensor, "*rows channels"]) -> Float[Tensor, "*rows channels"]:
        """Normalise and rectify each row; `values` may be overwritten."""
        if self.norm is None:
            return values.relu_()  # in place: no earlier layer needs its output
        rows: Tensor = self.norm(values.reshape(-1, values.shape[-1]))
        # rectified before the view, whose gradient would be copied
        return rows.relu_().reshape(values.shape)


def point_layers(in_channels: int, widths: tuple[int, ...], *, batch_norm: bool) -> nn.Sequential:
    """Make layers that act on each point separately."""
    layers: list[nn.Module] = []
    for before, width in pairwise((in_channels, *widths)):
        layers.append(nn.Linear(before, width, bias=not batch_norm))
        layers.append(NormAndRelu(width, batch_norm=batch_norm))
    return nn.Sequential(*layers)


class Neighbourhood(nn.Module):
    """Features of centres from their neighbours: shared layers, then the maximum.

    The input of the first layer is a neighbour's offset from the centre, and its features. The
    layer is linear, so its feature part is computed once per point instead of once per neighbour.
    Repeated neighbours do not change a maximum, so only distinct ones are computed; but exported
    graphs have fixed shapes, and repetitions count for the statistics of a batch.
    """

    def __init__(self, in_channels: int, config: NeighbourhoodConfig, *, batch_norm: bool) -> None:
        super().__init__()
        self.radius_m, self.num_neighbours = config.radius_m, config.num_neighbours
        self.first = nn.Linear(3 + in_channels, config.widths[0], bias=not batch_norm)
        self.activate = NormAndRelu(config.widths[0], batch_norm=batch_norm)
        self.rest = point_layers(config.widths[0], config.widths[1:], batch_norm=batch_norm)

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"],
        centers: Float[Tensor, "batch num_centers 3"],
        neighbours: Int64[Tensor, "batch num_centers num_neighbours"],
    ) -> Float[Tensor, "batch num_centers out_channels"]:
        """Compute the features of the centres from the output of `find`."""
        weight, bias = self.first.weight, self.first.bias
        by_point = linear(features, weight[:, 3:]) if features.shape[2] else None
        is_of_batch = self.training and self.activate.norm is not None
        if torch.compiler.is_compiling() or is_of_batch:
            hidden = linear(
                group_points(points, neighbours) - centers[:, :, None], weight[:, :3], bias
            )
            if by_point is not None:
                hidden = hidden + group_points(by_point, neighbours)
            every: Tensor = self.rest(self.activate(hidden))
            if is_of_batch:  # amax shares the gradient among equal rows, three times as slowly
                return every.max(dim=2).values
            return every.amax(dim=2)
        batch, num_centers, _ = neighbours.shape
        start = torch.arange(batch, device=points.device)[:, None, None] * points.shape[1]
        ordered = (neighbours + start).flatten(0, 1).sort(dim=1).values
        is_new = torch.ones_like(ordered, dtype=torch.bool)
        is_new[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
        center, point = is_new.nonzero()[:, 0], ordered[is_new]
        offset = points.flatten(0, 1)[point] - centers.flatten(0, 1)[center]
        hidden = linear(offset, weight[:, :3], bias)
        if by_point is not None:
            hidden = hidden + by_point.flatten(0, 1).index_select(0, point)
        values: Tensor = self.rest(self.activate(hidden))
        largest = values.new_zeros(batch * num_centers, values.shape[1])
        places = center[:, None].expand_as(values)
        # rectified values are at least 0; leaving these zeros out would double the gradient's time
        largest = largest.scatter_reduce(0, places, values, "amax")
        return largest.reshape(batch, num_centers, values.shape[1])

    def find(
        self,
        points: Float[Tensor, "batch num_points 3"],
        centers: Float[Tensor, "batch num_centers 3"],
    ) -> Int64[Tensor, "batch num_centers num_neighbours"]:
        """Find each centre's neighbours; it needs one, as points of the cloud have."""
        near = ball_query(points, centers, radius_m=self.radius_m, count=self.num_neighbours)
        return near.indices


class SetAbstraction(nn.Module):
    """Subsampling of points with features of their neighbourhoods, at one or several scales."""

    def __init__(self, in_channels: int, config: AbstractionConfig, *, batch_norm: bool) -> None:
        super().__init__()
        self.num_centers = config.num_centers
        self.scales = nn.ModuleList(
            Neighbourhood(in_channels, scale, batch_norm=batch_norm) for scale in config.scales
        )

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"],
        grouping: Grouping,
    ) -> PointFeatures:
        """Compute the features of the centres from the output of `find`."""
        centers = group_points(points, grouping.centers)
        seen = [
            scale(points, features, centers, near)
            for scale, near in zip(self.scales, grouping.neighbours, strict=True)
        ]
        return PointFeatures(centers, torch.cat(seen, dim=2))

    def find(self, points: Float[Tensor, "batch num_points 3"]) -> Grouping:
        """Choose centres by farthest point sampling (all of fewer points), and neighbours."""
        centers = farthest_points(points, min(self.num_centers, points.shape[1]))
        places = group_points(points, centers)
        scales = cast("list[Neighbourhood]", list(self.scales))
        return Grouping(centers, tuple(scale.find(points, places) for scale in scales))


def find_groupings(
    points: Float[Tensor, "batch num_points 3"],
    levels: nn.ModuleList,
    sources: Int64[Tensor, "batch num_points"] | None = None,
) -> tuple[dict[str, Tensor], list[Tensor]]:
    """Find the groupings of successive levels by name, and each level's points, the input first.

    Points with the same source are copies; each neighbour is the first of its copies.
    """
    found: dict[str, Tensor] = {}
    clouds = [points]
    for number, level in enumerate(cast("list[SetAbstraction]", list(levels))):
        grouping = level.find(clouds[-1])
        found[f"centers_{number}"] = grouping.centers
        for scale, neighbours in enumerate(grouping.neighbours):
            near = neighbours
            if sources is not None:
                near = _first_copies(sources).gather(1, near.flatten(1)).reshape(near.shape)
            found[f"neighbours_{number}_{scale}"] = near
        sources = None if sources is None else sources.gather(1, grouping.centers)
        clouds.append(group_points(clouds[-1], grouping.centers))
    return found, clouds


def _first_copies(
    sources: Int64[Tensor, "batch num_points"],
) -> Int64[Tensor, "batch num_points"]:
    """Place of the first point with the same source."""
    batch, num_points = sources.shape
    places = torch.arange(num_points, device=sources.device).expand(batch, -1)
    first = sources.new_full((batch, int(sources.max()) + 1), num_points)
    return first.scatter_reduce(1, sources, places, "amin").gather(1, sources)


def abstract(
    points: PointFeatures, levels: nn.ModuleList, found: Mapping[str, Tensor]
) -> list[PointFeatures]:
    """Run successive levels on the groupings of `find_groupings`; the input is the first result."""
    clouds = [points]
    for number, level in enumerate(cast("list[SetAbstraction]", list(levels))):
        scales = range(len(level.scales))
        near = tuple(found[f"neighbours_{number}_{scale}"] for scale in scales)
        clouds.append(level(*clouds[-1], Grouping(found[f"centers_{number}"], near)))
    return clouds


class FeaturePropagation(nn.Module):
    """Interpolate features to the points of a finer level from their three nearest points."""

    def __init__(self, in_channels: int, widths: tuple[int, ...], *, batch_norm: bool) -> None:
        super().__init__()
        self.layers = point_layers(in_channels, widths, batch_norm=batch_norm)

    def forward(
        self,
        coarse: Float[Tensor, "batch num_coarse coarse_channels"],
        fine: Float[Tensor, "batch num_points fine_channels"],
        nearest: ThreeNearest,
    ) -> Float[Tensor, "batch num_points out_channels"]:
        """Compute features of the finer points; their own features are concatenated."""
        between = interpolate_points(coarse, nearest)
        features: Tensor = self.layers(torch.cat((between, fine), dim=2))
        return features


class PointBackbone(nn.Module):
    """Set abstractions, then feature propagations back to all points.

    Accepts any number of points: a level has as many as there are, up to its number of centres.
    """

    def __init__(self, config: PointBackboneConfig) -> None:
        super().__init__()
        channels = (config.in_channels, *(level.out_channels for level in config.levels))
        self.abstractions = nn.ModuleList(
            SetAbstraction(in_channels, level, batch_norm=True)
            for in_channels, level in zip(channels, config.levels, strict=False)
        )
        coarser = (*(widths[-1] for widths in config.propagation_widths[1:]), channels[-1])
        self.propagations = nn.ModuleList(
            FeaturePropagation(own + below, widths, batch_norm=True)
            for own, below, widths in zip(
                channels, coarser, config.propagation_widths, strict=False
            )
        )

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"],
        found: Mapping[str, Tensor],
    ) -> Float[Tensor, "batch num_points out_channels"]:
        """Compute the features of every point [m] from the output of `find`."""
        levels = abstract(PointFeatures(points, features), self.abstractions, found)
        known = levels.pop().features
        for number, propagation in reversed(list(enumerate(self.propagations))):
            nearest = ThreeNearest(found[f"nearest_{number}"], found[f"distances_{number}"])
            known = propagation(known, levels.pop().features, nearest)
        return known

    def find(self, points: Float[Tensor, "batch num_points 3"]) -> dict[str, Tensor]:
        """Find each level's centres, neighbours and interpolation sources; needs a point."""
        found, levels = find_groupings(points, self.abstractions)
        for number, (fine, coarse) in enumerate(pairwise(levels)):
            nearest = three_nearest(coarse, fine)
            found[f"nearest_{number}"] = nearest.indices
            found[f"distances_{number}"] = nearest.squared_distance_m2
        return found


def head_layers(
    in_channels: int,
    widths: tuple[int, ...],
    out_channels: int,
    *,
    batch_norm: bool,
    dropout: float | None = None,
) -> nn.Sequential:
    """Make a head: hidden layers, dropout if any, and a linear layer."""
    hidden = point_layers(in_channels, widths, batch_norm=batch_norm)
    between: Sequence[nn.Module] = () if dropout is None else (nn.Dropout(dropout),)
    return nn.Sequential(*hidden, *between, nn.Linear((in_channels, *widths)[-1], out_channels))
