"""What the detectors' networks give, on the way and in the end."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class HeadReading(NamedTuple):
    """What one head says of every place of the image that it looks at, over all its maps."""

    class_logits: Float[Tensor, "batch places values"]
    box_logits: Float[Tensor, "batch places box_values"]
    places: Float[Tensor, "places 4"]
    """Centre x, y, width and height [px] of each place: a prior, or a cell of a map."""


class GateReading(NamedTuple):
    """How far the features of each sensor are let through at one map, before the sigmoid."""

    camera_logits: Float[Tensor, "batch groups rows columns"]
    lidar_logits: Float[Tensor, "batch groups rows columns"]


class Readings(NamedTuple):
    """All that a detector reads off its inputs."""

    heads: tuple[HeadReading, ...]
    """One; of late fusion one for the camera and one for the LiDAR."""
    gates: tuple[GateReading, ...]
    """Of each map, the finest first; none where nothing is gated."""
    auxiliary: dict[str, HeadReading]
    """Of the heads that single streams have, by sensor."""


class DetectorOutput(NamedTuple):
    """Every place's box, and the gates of the finest map."""

    scores: Float[Tensor, "batch places classes"]
    """Probability of each class."""
    boxes: Float[Tensor, "batch places 4"]
    """x_min, y_min, x_max, y_max in pixels of the input; may reach beyond it."""
    camera_gate: Float[Tensor, "batch groups rows columns"] | None
    """From 0, where the camera's features are not used, to 1; None where nothing is gated."""
    lidar_gate: Float[Tensor, "batch groups rows columns"] | None
