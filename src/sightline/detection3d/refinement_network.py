"""Network of the plain second stage: a box and its confidence from the points of a region."""

from collections.abc import Mapping
from typing import NamedTuple, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.config import RefinementConfig
from sightline.detection3d.groupings import find_groupings, named_grouping
from sightline.detection3d.point_layers import PointFeatures, SetAbstraction, point_layers

_BOX_VALUES = 7


class RefinementOutput(NamedTuple):
    """Output of the second stage for each region of interest."""

    boxes: Float[Tensor, "num_rois 7"]
    """x, y, z, length, width, height, yaw in the frame of the points: metres, radians."""
    logits: Float[Tensor, " num_rois"]
    """Confidence before the sigmoid."""


class RefinementNetwork(nn.Module):
    """Set abstractions down to one vector for each region, and two heads.

    After Shi et al. 2019 (PointRCNN), section 3.3, in its plainest form: the points are in the
    frame of the sweep, boxes are regressed in absolute values, the proposal itself is not an input.
    """

    def __init__(self, config: RefinementConfig) -> None:
        super().__init__()
        batch_norm, channels = config.batch_norm, config.in_channels
        self.levels = nn.ModuleList()
        for level in config.levels:
            self.levels.append(SetAbstraction(channels, level, batch_norm=batch_norm))
            channels = level.out_channels
        self.together = point_layers(3 + channels, config.global_widths, batch_norm=batch_norm)
        self.box_head = _head(config, _BOX_VALUES)
        self.confidence_head = _head(config, 1)

    def forward(
        self,
        points: Float[Tensor, "num_rois roi_points 3"],
        features: Float[Tensor, "num_rois roi_points channels"],
        found: Mapping[str, Tensor] | None = None,
    ) -> RefinementOutput:
        """Compute a box and a logit for each region; the number of regions may be 0.

        Args:
            points: Points of the regions [m].
            features: Features of these points.
            found: Output of `find`. None: it is computed here.
        """
        if found is None:
            found = self.find(points)
        level = PointFeatures(points, features)
        for number, abstraction in enumerate(self.levels):
            level = abstraction(*level, named_grouping(found, number))
        region = self.together(torch.cat(level, dim=2)).amax(dim=1)
        return RefinementOutput(self.box_head(region), self.confidence_head(region)[:, 0])

    def find(self, points: Float[Tensor, "num_rois roi_points 3"]) -> dict[str, Tensor]:
        """Find each level's centres and neighbours, as `forward` takes them."""
        return find_groupings(points, cast("list[SetAbstraction]", list(self.levels)))[0]


def _head(config: RefinementConfig, out_channels: int) -> nn.Sequential:
    channels = (config.global_widths + config.head_widths)[-1]
    hidden = point_layers(
        config.global_widths[-1], config.head_widths, batch_norm=config.batch_norm
    )
    return nn.Sequential(*hidden, nn.Linear(channels, out_channels))
