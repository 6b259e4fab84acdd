"""Pooling of the points in and around each proposal: the plain second stage's input."""

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
    """Settings for pooling points: Shi et al. 2019 (PointRCNN), section 3.2."""

    margin_m: float = 1.0
    """Margin around a proposal, to include its surroundings."""
    num_points: int = 512
    """Number of points for each proposal."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.margin_m <= _LARGEST_MARGIN_M:
            raise ValueError(
                f"margin_m must be from 0 to {_LARGEST_MARGIN_M:g}, got {self.margin_m}"
            )
        if not 1 <= self.num_points <= _MOST_POINTS:
            raise ValueError(f"num_points must be from 1 to {_MOST_POINTS}, got {self.num_points}")


class PooledRois(NamedTuple):
    """Proposals that contain points, in their order."""

    proposal: Int64[Tensor, " num_rois"]
    """Indices into all proposals."""
    boxes: Float[Tensor, "num_rois 7"]
    """Boxes without the margin."""
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
    """Draw a fixed number of points for each proposal; proposals without points are dropped.

    From more points a random subset is drawn; of fewer, all are taken and some repeated at random
    (`ops.roi_points`). All-zero proposals, which pad a frame, are dropped too. Differentiable with
    respect to the features.

    Args:
        points: Points of one sweep, LiDAR frame [m].
        features: Features of the points.
        proposals: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        config: Margin and number.
        seed: Seed of the draw, which is reproducible.

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
