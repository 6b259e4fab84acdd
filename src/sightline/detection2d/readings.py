"""Outputs of the detectors' networks, intermediate and final."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class HeadReading(NamedTuple):
    """Output of one head for all places of all its maps."""

    class_logits: Float[Tensor, "batch places values"]
    box_logits: Float[Tensor, "batch places box_values"]
    places: Float[Tensor, "places 4"]
    """Centre x, y, width and height [px] of each place: a prior, or a cell of a map."""


class GateReading(NamedTuple):
    """Logits of the gates for each sensor's features at one map."""

    camera_logits: Float[Tensor, "batch groups rows columns"]
    lidar_logits: Float[Tensor, "batch groups rows columns"]


class HeadOutputs(NamedTuple):
    """Outputs of a detector's heads and gates."""

    heads: tuple[HeadReading, ...]
    """One head; in late fusion one for the camera and one for the LiDAR."""
    gates: tuple[GateReading, ...]
    """Gates of each map, the finest first; empty without gates."""
    auxiliary: dict[str, HeadReading]
    """Outputs of the single streams' heads, by sensor."""


class DetectorOutput(NamedTuple):
    """Box of every place, and the gates of the finest map."""

    scores: Float[Tensor, "batch places classes"]
    """Probabilities of the classes."""
    boxes: Float[Tensor, "batch places 4"]
    """x_min, y_min, x_max, y_max in pixels of the input; may reach beyond it."""
    camera_gate: Float[Tensor, "batch groups rows columns"] | None
    """Camera gate, from 0 (its features are not used) to 1; None without gates."""
    lidar_gate: Float[Tensor, "batch groups rows columns"] | None
