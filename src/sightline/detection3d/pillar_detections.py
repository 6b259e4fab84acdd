"""Decoding of the compact first stage's output into boxes."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.center_coding import QUALITY, cell_middles, decode_centers
from sightline.detection3d.pillar_config import PillarNetworkConfig
from sightline.detection3d.pillar_network import PillarOutput
from sightline.detection3d.quality import iou_of_quality
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle
from sightline.ops.nms import nms_bev
from sightline.ops.rotated_iou import pairwise_iou_bev

_MOST_PAIRS = 2**25  # pairs of boxes for the IoU: 256 MB for each value per pair
QUALITY_FOCUS = 4  # power of the predicted IoU in the weight of a neighbour's box


@dataclass(frozen=True, kw_only=True)
class PillarDetectionConfig:
    """Settings for decoding heat maps into boxes."""

    min_heat: float = 0.05
    """Smallest heat of a cell that gives a box."""
    max_cells: int = 2000
    """Number of hottest cells of a sweep that are decoded."""
    max_boxes: int = 100
    """Largest number of boxes for a sweep."""
    suppression_iou: float = 0.1
    """IoU from above beyond which the lower-scored of two boxes of a class is removed."""
    quality_share: float = 0.5
    """Exponent of the predicted IoU in the score; the exponent of the heat is 1 less this."""
    mean_iou: float | None = 0.5
    """IoU from above beyond which boxes of the same class are averaged with a box, weighted by heat
    and predicted IoU. None: no averaging."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("min_heat", "suppression_iou", "quality_share"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"{name} must be from 0 to 1, got {value}")
        if self.mean_iou is not None and not 0 <= self.mean_iou < 1:
            raise ValueError(f"mean_iou must be None or from 0 to below 1, got {self.mean_iou}")
        if self.max_cells < 1 or self.max_boxes < 1:
            raise ValueError(
                "max_cells and max_boxes must be at least 1, got "
                f"{self.max_cells} and {self.max_boxes}"
            )
        if self.max_cells * self.max_boxes > _MOST_PAIRS:
            raise ValueError(
                f"max_cells times max_boxes must be up to {_MOST_PAIRS}, got {self.max_cells} "
                f"times {self.max_boxes}"
            )


class FoundBoxes(NamedTuple):
    """Boxes of a sweep by descending score."""

    boxes: Float[Tensor, "num_boxes 7"]
    """x, y, z, length, width, height, yaw (LiDAR frame, metres, radians)."""
    classes: Int64[Tensor, " num_boxes"]
    """Indices into the network's classes."""
    scores: Float[Tensor, " num_boxes"]
    """Scores from 0 to 1."""


class _Candidates(NamedTuple):
    """Boxes decoded from hot cells."""

    boxes: Float[Tensor, "num_cells 7"]
    classes: Int64[Tensor, " num_cells"]
    scores: Float[Tensor, " num_cells"]
    weights: Float[Tensor, " num_cells"]
    """Weights for averaging boxes."""


def find_boxes(
    output: PillarOutput,
    sweep: int,
    network: PillarNetworkConfig,
    config: PillarDetectionConfig = PillarDetectionConfig(),
) -> FoundBoxes:
    """Decode the boxes of one sweep of a batch.

    Cells that are the local maximum of 3x3 cells for their class give a box; non-maximum
    suppression from above removes duplicates. Each remaining box becomes the mean of the boxes of
    all hot cells around it, which is steadier than one cell's box.
    """
    heat = output.heat_logits[sweep].sigmoid()
    of_class, row, column = (heat >= config.min_heat).nonzero(as_tuple=True)
    order = heat[of_class, row, column].argsort(descending=True, stable=True)[: config.max_cells]
    of_class, row, column = of_class[order], row[order], column[order]
    warmth = heat[of_class, row, column]
    values = output.center_values[sweep, of_class, :, row, column]
    mean_sizes = values.new_tensor([entry.mean_size_m for entry in network.classes])
    middles = cell_middles(torch.stack((row, column), dim=1), network.grid).to(values.dtype)
    iou = iou_of_quality(values[:, QUALITY].sigmoid())
    found = _Candidates(
        decode_centers(values, middles, mean_sizes[of_class]),
        of_class,
        warmth ** (1 - config.quality_share) * iou**config.quality_share,
        warmth * iou**QUALITY_FOCUS,
    )
    is_peak = heat == F.max_pool2d(heat[None], 3, stride=1, padding=1)[0]
    peaks = is_peak[of_class, row, column].nonzero()[:, 0]
    kept = peaks[
        nms_bev(
            Boxes3D(found.boxes[peaks]).bev,
            found.scores[peaks],
            config.suppression_iou,
            labels=of_class[peaks],
            max_detections=config.max_boxes,
        )
    ]
    boxes = found.boxes[kept]
    if config.mean_iou is not None:
        boxes = _mean_boxes(found, kept, config.mean_iou)
    return FoundBoxes(boxes, of_class[kept], found.scores[kept])


def _mean_boxes(
    found: _Candidates, kept: Int64[Tensor, " num_kept"], min_iou: float
) -> Float[Tensor, "num_kept 7"]:
    """Average each kept box with the overlapping boxes of its class, by weight.

    Yaws are averaged as directions relative to the kept box: first the axis, then the front.
    """
    own = found.boxes[kept]
    iou = pairwise_iou_bev(Boxes3D(own).bev, Boxes3D(found.boxes).bev)
    is_around = (iou > min_iou) & (found.classes[kept, None] == found.classes)
    is_around[torch.arange(len(kept), device=kept.device), kept] = True
    weights = torch.where(is_around, found.weights, 0.0)
    weights = weights / weights.sum(dim=1, keepdim=True)
    turn = found.boxes[:, 6] - own[:, 6:]
    axis = torch.atan2(
        (weights * (2 * turn).sin()).sum(dim=1), (weights * (2 * turn).cos()).sum(dim=1)
    )
    is_front = (weights * (turn - axis[:, None] / 2).cos()).sum(dim=1) >= 0
    yaw = own[:, 6] + axis / 2 + torch.where(is_front, 0.0, torch.pi)
    return torch.cat((weights @ found.boxes[:, :6], wrap_angle(yaw)[:, None]), dim=1)
