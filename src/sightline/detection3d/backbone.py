"""The first stage's backbone: features of every point, by PointNet++ with several scales."""

from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.config import PointBackboneConfig
from sightline.detection3d.point_layers import FeaturePropagation, PointFeatures, SetAbstraction


class PointBackbone(nn.Module):
    """Set abstractions, then feature propagations back to all points: Qi et al. 2017 (PointNet++).

    Takes any number of points: a level has as many as there are, up to its number of centres.
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
    ) -> Float[Tensor, "batch num_points out_channels"]:
        """Features of every point [m], of one with a point at least.

        Args:
            points: x, y, z, LiDAR frame [m].
            features: What each point has besides; no channels where there is nothing.
        """
        levels = [PointFeatures(points, features)]
        for abstraction in self.abstractions:
            levels.append(abstraction(*levels[-1]))
        known = levels.pop()
        for propagation in reversed(self.propagations):
            fine = levels.pop()
            known = PointFeatures(fine.points, propagation(known, fine))
        return known.features
