"""Bin-based box encoding of the first stage: Shi et al. 2019 (PointRCNN), section 3.1.

A box is encoded from one of its points. The centre's offsets along x and y, and the heading, are
each a bin and a residual within it: the bin is a choice among few, and the residual is small. The
height of the centre is encoded by its offset, the size by its deviation from the class's mean.

Departures: residuals are not clipped where a centre lies beyond the outermost bins, so that
decoding restores every box; and everything is in the LiDAR frame about the geometric centre.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.points.config import BoxCodingConfig
from sightline.geometry.transforms import wrap_angle

_MIN_SIZE = 0.01  # share of the mean size


class ProposalNetworkOutput(NamedTuple):
    """Output of the first stage for each point."""

    features: Float[Tensor, "batch num_points channels"]
    """Features of the backbone, which the second stage pools."""
    class_logits: Float[Tensor, "batch num_points num_classes"]
    """Logits that the point lies on an object of the class."""
    box_values: Float[Tensor, "batch num_points box_channels"]
    """Encoded box of the point; see `split_prediction`."""


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
    """Offset from the bin's middle, in bins."""
    y_residual: Float[Tensor, " n"]
    """Offset from the bin's middle, in bins."""
    heading_residual: Float[Tensor, " n"]
    """Offset from the bin's middle, in half bins."""
    z_offset: Float[Tensor, " n"]
    """Height of the box's centre above the point [m]."""
    size_residual: Float[Tensor, "n 3"]
    """(Size - mean) / mean, for length, width and height."""


def split_prediction(values: Float[Tensor, "n channels"], config: BoxCodingConfig) -> BoxPrediction:
    """Split the channels of the network's last layer by meaning."""
    return BoxPrediction(*torch.split(values, list(config.widths), dim=1))


def encode_boxes(
    boxes: Float[Tensor, "n 7"],
    points: Float[Tensor, "n 3"],
    mean_sizes: Float[Tensor, "n 3"],
    config: BoxCodingConfig,
) -> BoxCode:
    """Encode each box relative to a point of it, with the mean sizes of its class.

    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
    """
    offset = boxes[:, :3] - points
    x_bin, x_residual = _center_code(offset[:, 0], config)
    y_bin, y_residual = _center_code(offset[:, 1], config)
    width = config.heading_bin_rad
    turned = wrap_angle(boxes[:, 6] + width / 2 - math.pi) + math.pi  # from 0 to a full turn
    heading_bin = (turned / width).long().clamp(0, config.heading_bins - 1)
    heading_residual = 2 * (turned / width - heading_bin) - 1
    bins, residuals = (x_bin, y_bin, heading_bin), (x_residual, y_residual, heading_residual)
    size_residual = (boxes[:, 3:6] - mean_sizes) / mean_sizes
    return BoxCode(*bins, *residuals, offset[:, 2], size_residual)


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
    sizes = mean_sizes * (1 + code.size_residual).clamp(min=_MIN_SIZE)
    center = torch.stack((x, y, points[:, 2] + code.z_offset), dim=1)
    return torch.cat((center, sizes, yaw[:, None]), dim=1)


def likeliest_code(prediction: BoxPrediction) -> BoxCode:
    """Select the bins with the highest scores, and their residuals."""
    bins = [scores.argmax(dim=1) for scores in prediction[:3]]
    residuals = [at_bin(*pair) for pair in zip(prediction[3:6], bins, strict=True)]
    code = (*bins, *residuals, prediction.z_offset[:, 0], prediction.size_residual)
    return BoxCode(*code)


def at_bin(residuals: Float[Tensor, "n bins"], chosen: Int64[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Select the residual of the chosen bin."""
    return residuals.gather(1, chosen[:, None])[:, 0]
