"""Bin-based box encoding of the first stage: Shi et al. 2019 (PointRCNN), section 3.1.

A box is encoded from one of its points. The centre's offsets along x and y, and the heading, are
each a bin and a residual within it: the bin is a choice among few, and the residual is small. The
height of the centre is encoded by its offset, the size by its deviation from the class's mean.

Departures: residuals are not clipped where a centre lies beyond the outermost bins, so that
decoding restores every box; and everything is in the LiDAR frame about the geometric centre.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.geometry.transforms import wrap_angle

_LEAST_SIZE = 0.01  # share of the mean size


@dataclass(frozen=True, kw_only=True)
class BoxCodingConfig:
    """Bins of the box encoding."""

    scope_m: float = 3.0
    """Largest distance of a centre from its point, along x and along y."""
    bin_m: float = 0.5
    """Length of a bin of the centre."""
    heading_bins: int = 12
    """Number of bins over the full turn; the first is centred on yaw 0."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        bins = 2 * self.scope_m / self.bin_m if self.bin_m > 0 else 0.0
        if not (0 < self.scope_m < math.inf and 1 <= bins < math.inf and bins == round(bins)):
            raise ValueError(
                f"2 * scope_m must be a multiple of bin_m, both positive, got {self.scope_m} and "
                f"{self.bin_m}"
            )
        if self.heading_bins < 1:
            raise ValueError(f"heading_bins must be at least 1, got {self.heading_bins}")

    @property
    def center_bins(self) -> int:
        """Number of bins along x, and also along y."""
        return round(2 * self.scope_m / self.bin_m)

    @property
    def heading_bin_rad(self) -> float:
        """Width of a bin of the heading."""
        return 2 * math.pi / self.heading_bins

    @property
    def channels(self) -> int:
        """Number of channels of the prediction for one point."""
        return 4 * self.center_bins + 2 * self.heading_bins + 4


class BoxPrediction(NamedTuple):
    """Network output for each point, by meaning: bin scores, and a residual for each bin."""

    x_bins: Float[Tensor, "n center_bins"]
    y_bins: Float[Tensor, "n center_bins"]
    heading_bins: Float[Tensor, "n heading_bins"]
    x_residuals: Float[Tensor, "n center_bins"]
    y_residuals: Float[Tensor, "n center_bins"]
    heading_residuals: Float[Tensor, "n heading_bins"]
    z_offset: Float[Tensor, "n 1"]
    size_residual: Float[Tensor, "n 3"]


class BoxCode(NamedTuple):
    """Encoded box, relative to a point."""

    x_bin: Int64[Tensor, " n"]
    y_bin: Int64[Tensor, " n"]
    heading_bin: Int64[Tensor, " n"]
    x_residual: Float[Tensor, " n"]
    """Offset from the bin's middle, in bins; the same for y."""
    y_residual: Float[Tensor, " n"]
    heading_residual: Float[Tensor, " n"]
    """Offset from the bin's middle, in half bins."""
    z_offset: Float[Tensor, " n"]
    """Height of the box's centre above the point [m]."""
    size_residual: Float[Tensor, "n 3"]
    """(Size - mean) / mean, for length, width and height."""


def split_prediction(values: Float[Tensor, "n channels"], config: BoxCodingConfig) -> BoxPrediction:
    """Split the channels of the network's last layer by meaning."""
    center, heading = config.center_bins, config.heading_bins
    widths = [center, center, heading, center, center, heading, 1, 3]
    return BoxPrediction(*torch.split(values, widths, dim=1))


def encode_boxes(
    boxes: Float[Tensor, "n 7"],
    points: Float[Tensor, "n 3"],
    mean_sizes: Float[Tensor, "n 3"],
    config: BoxCodingConfig,
) -> BoxCode:
    """Encode each box relative to its point.

    Args:
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        points: One point of each box, LiDAR frame [m].
        mean_sizes: Length, width, height of the box's class [m].
        config: Bins.
    """
    offset = boxes[:, :3] - points
    x_bin, x_residual = _center_code(offset[:, 0], config)
    y_bin, y_residual = _center_code(offset[:, 1], config)
    width = config.heading_bin_rad
    turned = wrap_angle(boxes[:, 6] + width / 2 - math.pi) + math.pi  # from 0 to a full turn
    heading_bin = (turned / width).long().clamp(0, config.heading_bins - 1)
    heading_residual = 2 * (turned / width - heading_bin) - 1
    return BoxCode(
        x_bin=x_bin,
        y_bin=y_bin,
        heading_bin=heading_bin,
        x_residual=x_residual,
        y_residual=y_residual,
        heading_residual=heading_residual,
        z_offset=offset[:, 2],
        size_residual=(boxes[:, 3:6] - mean_sizes) / mean_sizes,
    )


def _center_code(
    offset: Float[Tensor, " n"], config: BoxCodingConfig
) -> tuple[Int64[Tensor, " n"], Float[Tensor, " n"]]:
    shifted = (offset + config.scope_m) / config.bin_m
    center_bin = shifted.floor().clamp(0, config.center_bins - 1)
    return center_bin.long(), shifted - (center_bin + 0.5)


def decode_boxes(
    code: BoxCode,
    points: Float[Tensor, "n 3"],
    mean_sizes: Float[Tensor, "n 3"],
    config: BoxCodingConfig,
) -> Float[Tensor, "n 7"]:
    """Decode boxes: the inverse of `encode_boxes`. Yaws are in [-pi, pi).

    Sizes are at least a hundredth of the mean: an untrained network may predict negative ones.
    """
    x, y = (
        points[:, axis] + (center_bin + 0.5 + residual) * config.bin_m - config.scope_m
        for axis, center_bin, residual in (
            (0, code.x_bin, code.x_residual),
            (1, code.y_bin, code.y_residual),
        )
    )
    yaw = wrap_angle((code.heading_bin + code.heading_residual / 2) * config.heading_bin_rad)
    sizes = mean_sizes * (1 + code.size_residual).clamp(min=_LEAST_SIZE)
    center = torch.stack((x, y, points[:, 2] + code.z_offset), dim=1)
    return torch.cat((center, sizes, yaw[:, None]), dim=1)


def likeliest_code(prediction: BoxPrediction) -> BoxCode:
    """Select the bins with the highest scores, and their residuals."""
    x_bin, y_bin, heading_bin = (
        scores.argmax(dim=1)
        for scores in (prediction.x_bins, prediction.y_bins, prediction.heading_bins)
    )
    return BoxCode(
        x_bin=x_bin,
        y_bin=y_bin,
        heading_bin=heading_bin,
        x_residual=at_bin(prediction.x_residuals, x_bin),
        y_residual=at_bin(prediction.y_residuals, y_bin),
        heading_residual=at_bin(prediction.heading_residuals, heading_bin),
        z_offset=prediction.z_offset[:, 0],
        size_residual=prediction.size_residual,
    )


def at_bin(residuals: Float[Tensor, "n bins"], chosen: Int64[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Select the residual of the chosen bin."""
    return residuals.gather(1, chosen[:, None])[:, 0]
