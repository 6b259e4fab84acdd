"""Network of the point first stage: foreground segmentation, and a box for each point."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from jaxtyping import Float, Int64
from torch import Tensor, nn

from sightline.detection3d.backbone import PointBackbone
from sightline.detection3d.box_coding import (
    BoxCodingConfig,
    decode_boxes,
    likeliest_code,
    split_prediction,
)
from sightline.detection3d.classes import CAR, RoadUserClass
from sightline.detection3d.config import PointBackboneConfig
from sightline.detection3d.foreground import prior_bias
from sightline.detection3d.point_layers import point_layers


@dataclass(frozen=True, kw_only=True)
class ProposalNetworkConfig:
    """Settings of the first stage; sizes from Shi et al. 2019 (PointRCNN)."""

    classes: tuple[RoadUserClass, ...] = (CAR,)
    """Classes to propose."""
    backbone: PointBackboneConfig = field(default_factory=PointBackboneConfig)
    """Backbone for point features."""
    coding: BoxCodingConfig = field(default_factory=BoxCodingConfig)
    """Encoding of boxes relative to points."""
    head_width: int = 128
    """Channels of each head's hidden layer."""
    dropout: float = 0.5
    """Dropout rate in the heads."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not self.classes or len({entry.name for entry in self.classes}) < len(self.classes):
            raise ValueError(f"classes must hold one or more different ones, got {self.classes}")
        if self.head_width < 1:
            raise ValueError(f"head_width must be at least 1, got {self.head_width}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout must be from 0 to below 1, got {self.dropout}")


class ProposalNetworkOutput(NamedTuple):
    """Output of the first stage for each point."""

    features: Float[Tensor, "batch num_points channels"]
    """Features of the backbone, which the second stage pools."""
    class_logits: Float[Tensor, "batch num_points num_classes"]
    """Logits that the point lies on an object of the class."""
    box_values: Float[Tensor, "batch num_points box_channels"]
    """Encoded box of the point; see `box_coding.split_prediction`."""


class ProposalNetwork(nn.Module):
    """Backbone and two heads: Shi et al. 2019 (PointRCNN), section 3.1."""

    def __init__(self, config: ProposalNetworkConfig) -> None:
        super().__init__()
        self.backbone = PointBackbone(config.backbone)
        self.class_head = _head(config, len(config.classes))
        self.box_head = _head(config, config.coding.channels)
        last: nn.Linear = self.class_head[-1]  # type: ignore[assignment]
        nn.init.constant_(last.bias, prior_bias())
        last = self.box_head[-1]  # type: ignore[assignment]
        nn.init.normal_(last.weight, std=0.001)

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"],
        found: Mapping[str, Tensor] | None = None,
    ) -> ProposalNetworkOutput:
        """Compute features, class logits and box values; each sweep needs at least one point.

        Args:
            points: x, y, z (LiDAR frame [m]).
            features: Further features of each point.
            found: Output of the backbone's `find`. None: it is computed here.
        """
        seen = self.backbone(points, features, found)
        return ProposalNetworkOutput(seen, self.class_head(seen), self.box_head(seen))


class DecodedBoxes(NamedTuple):
    """Decoded box of each point, in case it lies on an object."""

    boxes: Float[Tensor, "batch num_points 7"]
    """x, y, z, length, width, height, yaw (LiDAR frame, metres, radians)."""
    classes: Int64[Tensor, "batch num_points"]
    """Indices of the most likely classes."""
    scores: Float[Tensor, "batch num_points"]
    """Probability that the point lies on an object of that class."""


def tell_boxes(
    output: ProposalNetworkOutput,
    points: Float[Tensor, "batch num_points 3"],
    config: ProposalNetworkConfig,
) -> DecodedBoxes:
    """Decode the network's output for points [m]."""
    scores, classes = output.class_logits.sigmoid().max(dim=2)
    mean_sizes = points.new_tensor([entry.mean_size_m for entry in config.classes])
    code = likeliest_code(split_prediction(output.box_values.flatten(0, 1), config.coding))
    means = mean_sizes[classes].flatten(0, 1)
    boxes = decode_boxes(code, points.flatten(0, 1), means, config.coding)
    return DecodedBoxes(boxes.reshape(*points.shape[:2], 7), classes, scores)


def _head(config: ProposalNetworkConfig, out_channels: int) -> nn.Sequential:
    hidden = point_layers(config.backbone.out_channels, (config.head_width,), batch_norm=True)
    return nn.Sequential(
        *hidden, nn.Dropout(config.dropout), nn.Linear(config.head_width, out_channels)
    )
