"""Layers of point networks: set abstraction and feature propagation (Qi et al. 2017, PointNet++).

Features lie channels last: a layer is a matrix product over rows, on any device.
"""

from typing import NamedTuple, cast

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.functional import linear

from sightline.detection3d.config import AbstractionConfig, NeighbourhoodConfig
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
    """Centres of a level among the points of the finer one, and their neighbours.

    It depends on the coordinates alone. So it can be computed before a network runs, and exported
    files contain no search.
    """

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
        if self.norm is not None:
            values = self.norm(values.reshape(-1, values.shape[-1])).reshape(values.shape)
        return values.relu_()  # in place: no earlier layer needs its output


def point_layers(in_channels: int, widths: tuple[int, ...], *, batch_norm: bool) -> nn.Sequential:
    """Make layers that act on each point separately."""
    layers: list[nn.Module] = []
    for width in widths:
        layers += [
            nn.Linear(in_channels, width, bias=not batch_norm),
            NormAndRelu(width, batch_norm=batch_norm),
        ]
        in_channels = width
    return nn.Sequential(*layers)


class Neighbourhood(nn.Module):
    """Features of centres from their neighbours: shared layers, then the maximum.

    The input of the first layer is a neighbour's offset from the centre, and its features. The
    layer is linear, so its feature part is computed once per point instead of once per neighbour.
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
        neighbours: Int64[Tensor, "batch num_centers num_neighbours"] | None = None,
    ) -> Float[Tensor, "batch num_centers out_channels"]:
        """Compute the features of the centres; each needs a neighbour, as points of the cloud have.

        Args:
            points: Points of the finer level [m].
            features: Features of these points.
            centers: Centres of the level [m].
            neighbours: Output of `find`. None: it is computed here.
        """
        if neighbours is None:
            neighbours = self.find(points, centers)
        offset = group_points(points, neighbours) - centers[:, :, None]
        hidden = linear(offset, self.first.weight[:, :3], self.first.bias)
        if features.shape[2]:
            by_point = linear(features, self.first.weight[:, 3:])
            hidden = hidden + group_points(by_point, neighbours)
        values: Tensor = self.rest(self.activate(hidden))
        return values.amax(dim=2)

    def find(
        self,
        points: Float[Tensor, "batch num_points 3"],
        centers: Float[Tensor, "batch num_centers 3"],
    ) -> Int64[Tensor, "batch num_centers num_neighbours"]:
        """Find the indices of each centre's neighbours."""
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
        grouping: Grouping | None = None,
    ) -> PointFeatures:
        """Select the centres by farthest point sampling, and compute their features.

        A cloud with fewer points than centres keeps them all.

        Args:
            points: Points of the finer level [m].
            features: Features of these points.
            grouping: Output of `find`. None: it is computed here.
        """
        if grouping is None:
            grouping = self.find(points)
        centers = group_points(points, grouping.centers)
        seen = [
            scale(points, features, centers, near)
            for scale, near in zip(self.scales, grouping.neighbours, strict=True)
        ]
        return PointFeatures(centers, torch.cat(seen, dim=2))

    def find(self, points: Float[Tensor, "batch num_points 3"]) -> Grouping:
        """Find the centres and their neighbours."""
        centers = farthest_points(points, min(self.num_centers, points.shape[1]))
        places = group_points(points, centers)
        scales = cast("list[Neighbourhood]", list(self.scales))
        return Grouping(centers, tuple(scale.find(points, places) for scale in scales))


class FeaturePropagation(nn.Module):
    """Interpolate features to the points of a finer level from their three nearest points."""

    def __init__(self, in_channels: int, widths: tuple[int, ...], *, batch_norm: bool) -> None:
        super().__init__()
        self.layers = point_layers(in_channels, widths, batch_norm=batch_norm)

    def forward(
        self, coarse: PointFeatures, fine: PointFeatures, nearest: ThreeNearest | None = None
    ) -> Float[Tensor, "batch num_points out_channels"]:
        """Compute features of the finer points; their own features are concatenated.

        Args:
            coarse: Points with known features.
            fine: Points to interpolate at, with their own features.
            nearest: The three nearest coarse points of each fine point. None: it is computed here.
        """
        if nearest is None:
            nearest = three_nearest(coarse.points, fine.points)
        between = interpolate_points(coarse.features, nearest)
        features: Tensor = self.layers(torch.cat((between, fine.features), dim=2))
        return features
