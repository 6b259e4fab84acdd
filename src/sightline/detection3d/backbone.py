"""Backbone of the first stage: multi-scale PointNet++ features of every point."""

from collections.abc import Mapping
from itertools import pairwise
from typing import cast

from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.config import PointBackboneConfig
from sightline.detection3d.groupings import find_groupings, named_grouping
from sightline.detection3d.point_layers import FeaturePropagation, PointFeatures, SetAbstraction
from sightline.ops.three_nearest import ThreeNearest, three_nearest


class PointBackbone(nn.Module):
    """Set abstractions, then feature propagations back to all points: Qi et al. 2017 (PointNet++).

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
        found: Mapping[str, Tensor] | None = None,
    ) -> Float[Tensor, "batch num_points out_channels"]:
        """Compute the features of every point; at least one point is needed.

        Args:
            points: x, y, z, LiDAR frame [m].
            features: Further features of each point; zero channels if there are none.
            found: Output of `find`. None: it is computed here.
        """
        if found is None:
            found = self.find(points)
        levels = [PointFeatures(points, features)]
        for number, abstraction in enumerate(self.abstractions):
            levels.append(abstraction(*levels[-1], named_grouping(found, number)))
        known = levels.pop()
        for number, propagation in reversed(list(enumerate(self.propagations))):
            fine = levels.pop()
            nearest = ThreeNearest(found[f"nearest_{number}"], found[f"distances_{number}"])
            known = PointFeatures(fine.points, propagation(known, fine, nearest))
        return known.features

    def find(self, points: Float[Tensor, "batch num_points 3"]) -> dict[str, Tensor]:
        """Find each level's centres, neighbours and interpolation sources, as `forward` takes them.

        Exported files need no search then: it is done before the network runs.
        """
        abstractions = cast("list[SetAbstraction]", list(self.abstractions))
        found, levels = find_groupings(points, abstractions)
        for number, (fine, coarse) in enumerate(pairwise(levels)):
            nearest = three_nearest(coarse, fine)
            found[f"nearest_{number}"] = nearest.indices
            found[f"distances_{number}"] = nearest.squared_distance_m2
        return found
