"""Batches of samples for the 2D detectors."""

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
    """Ground truth for scoring a frame."""

    placement: Placement
    objects: KittiObjects
    """Objects in the frame's own pixels."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionBatch(FieldwiseBatch):
    """Samples of one size. A missing sensor is an image of zeros."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    lidar: Float32[Tensor, "batch 3 height width"]
    """Depth, height and intensity in [0, 1] at points, else 0."""
    targets: tuple[DetectionTargets, ...]
    camera_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's pixels with a working camera, to train gates: 1 except for simulated
    faults. NaN: unknown."""
    lidar_health: Float32[Tensor, "batch 1 rows columns"] | None = None
    """Share of each cell's points with a working LiDAR; NaN in cells without points in the intact
    sweep."""
    frames: tuple[FrameTruth, ...] | None = None
    """Ground truth for scoring."""
