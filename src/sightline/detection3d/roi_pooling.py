"""What lies in and around each proposal: the second stage's input."""

from dataclasses import dataclass
from typing import NamedTuple

from jaxtyping import Float, Int64
from torch import Tensor

from sightline.ops.group_points import group_points
from sightline.ops.roi_points import roi_points

_LARGEST_MARGIN_M = 100.0
_MOST_POINTS = 2**14


@dataclass(frozen=True, kw_only=True)
class RoiPoolingConfig:
    """How proposals are filled with points: Shi et al. 2019 (PointRCNN), section 3.2."""

    margin_m: float = 1.0
    """How far every face of a proposal is moved outwards, so that its surroundings are seen."""
    num_points: int = 512
    """Points of each proposal."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.margin_m <= _LARGEST_MARGIN_M:
            raise ValueError(
                f"margin_m must be from 0 to {_LARGEST_MARGIN_M:g}, got {self.margin_m}"
            )
        if not 1 <= self.num_points <= _MOST_POINTS:
            raise ValueError(f"num_points must be from 1 to {_MOST_POINTS}, got {self.num_points}")


class PooledRois(NamedTuple):
    """The proposals that hold points, in their order."""

    proposal: Int64[Tensor, " num_rois"]
    """Their places among all proposals."""
    boxes: Float[Tensor, "num_rois 7"]
    """As proposed, without the margin."""
    points: Float[Tensor, "num_rois roi_points 3"]
    """LiDAR frame [m]."""
    features: Float[Tensor, "num_rois roi_points channels"]


def pool_rois(
    points: Float[Tensor, "num_points 3"],
    features: Float[Tensor, "num_points channels"],
    proposals: Float[Tensor, "num_proposals 7"],
    config: RoiPoolingConfig = RoiPoolingConfig(),
    *,
    seed: int,
) -> PooledRois:
    """Draws so many of the points in each proposal; proposals without any are left out.

    Of more points a random choice stays, of fewer all and random repetitions (`ops.roi_points`).
    All-zero proposals, which fill up a frame, are left out, too. Differentiable by the features.

    Args:
        points: Of one sweep, LiDAR frame [m].
        features: Of the points.
        proposals: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        config: Margin and number.
        seed: Of the draw; the same one draws the same.

    Raises:
        ValueError: A coordinate or a box is not finite, a size negative or the seed out of range.
    """
    drawn = roi_points(
        points[None],
        proposals[None],
        margin_m=config.margin_m,
        count=config.num_points,
        seed=seed,
    )
    kept = drawn.num_inside[0].nonzero()[:, 0]
    index = drawn.indices[:, kept]
    return PooledRois(
        proposal=kept,
        boxes=proposals[kept],
        points=group_points(points[None], index)[0],
        features=group_points(features[None], index)[0],
    )
