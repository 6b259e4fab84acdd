"""Batches of sweeps for the 3D detectors."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Float, Float32, Int64, jaxtyped
from torch import Tensor

from sightline.data.kitti_labels import KittiObjects
from sightline.detection3d.targets import SweepTruth
from sightline.geometry.calibration import Calibration
from sightline.structures.batch import FieldwiseBatch


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameTruth:
    """Ground truth for scoring a frame."""

    objects: KittiObjects
    """Objects in the camera frame."""
    calibration: Calibration
    """Calibration for a LiDAR frame at KITTI's height, the frame of the detections."""
    image_size: tuple[int, int]
    """Height, width [px]."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class FirstStageRecord:
    """Saved first-stage output for a sweep; see `proposal_cache`."""

    made_by: str
    """Identity of the stage and its settings."""
    features: Float[Tensor, "num_points channels"]
    """Features of the points."""
    boxes: Float32[Tensor, "num_proposals 7"]
    classes: Int64[Tensor, " num_proposals"]
    """Indices into the detector's classes."""
    scores: Float32[Tensor, " num_proposals"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Detection3DBatch(FieldwiseBatch):
    """Batch of sweeps, each with any number of points."""

    sample_ids: tuple[str, ...]
    points: tuple[Float32[Tensor, "_ 4"], ...]
    """LiDAR frame, raised by the settings' height offset: x, y, z [m], reflectance."""
    truths: tuple[SweepTruth, ...]
    """Ground truth in the same frame."""
    seeds: tuple[int, ...]
    """Random seed of each sweep for the losses' sampling."""
    records: tuple[FirstStageRecord, ...] | None = None
    """Saved outputs that replace the first stage."""
    frames: tuple[FrameTruth, ...] | None = None
    """Ground truth for scoring."""
