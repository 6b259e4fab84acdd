"""Several samples as the detectors take them."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor

from sightline.data.kitti_labels import KittiObjects
from sightline.detection2d.placement import Placement
from sightline.detection2d.targets import DetectionTargets
from sightline.structures.batch import FieldwiseBatch


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameTruth:
    """The truth that a frame is scored by."""

    placement: Placement
    objects: KittiObjects
    """In the frame's own pixels."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionBatch(FieldwiseBatch):
    """Samples at one size. A sensor that delivered nothing is an image of zeros."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    lidar: Float32[Tensor, "batch 3 height width"]
    """Depth, height and intensity in [0, 1] where a point falls, else 0."""
    targets: tuple[DetectionTargets, ...]
    camera_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's pixels that the camera still delivers: 1 but where it was broken for
    training. NaN: unknown. To teach gates."""
    lidar_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's points that the LiDAR still delivers; NaN where even a sound sweep has
    none."""
    frames: tuple[FrameTruth, ...] | None = None
    """For scoring."""
