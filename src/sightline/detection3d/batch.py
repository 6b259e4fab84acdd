"""Several sweeps as the detectors take them."""

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
    """The truth that a frame is scored by."""

    objects: KittiObjects
    """In the camera frame."""
    calibration: Calibration
    """Of a LiDAR frame as high as KITTI's, in which detections are told."""
    image_size: tuple[int, int]
    """Height, width [px]."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class FirstStageRecord:
    """What a first stage once gave for a sweep; see `proposal_cache`."""

    made_by: str
    """Identity of the stage and its settings."""
    features: Float[Tensor, "num_points channels"]
    """Of the points."""
    boxes: Float32[Tensor, "num_proposals 7"]
    classes: Int64[Tensor, " num_proposals"]
    """Places among the detector's classes."""
    scores: Float32[Tensor, " num_proposals"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Detection3DBatch(FieldwiseBatch):
    """Sweeps of any number of points each."""

    sample_ids: tuple[str, ...]
    points: tuple[Float32[Tensor, "_ 4"], ...]
    """LiDAR frame, raised by the settings' height offset: x, y, z [m], reflectance."""
    truths: tuple[SweepTruth, ...]
    """In the same frame."""
    seeds: tuple[int, ...]
    """Of what the losses draw for each sweep."""
    records: tuple[FirstStageRecord, ...] | None = None
    """In place of a first stage's work."""
    frames: tuple[FrameTruth, ...] | None = None
    """For scoring."""
