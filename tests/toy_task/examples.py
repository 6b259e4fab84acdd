"""Training samples: images, points and the boxes of each frame."""

from dataclasses import dataclass

import numpy as np
import torch
from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor

from sightline.augmentation.sample_changes import crop, mirror
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.batch import FieldwiseBatch
from sightline.structures.sample import CameraLidarSample
from sightline.training.data import SamplePreparation


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class FinderBatch(FieldwiseBatch):
    """Samples of one image size, each with its own number of boxes."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]
    boxes: tuple[Boxes2D, ...]
    """Boxes of each frame's objects: ragged."""


def network_inputs(sample: CameraLidarSample) -> dict[str, Tensor]:
    """Network inputs of a sample: a batch of one."""
    depth = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    image = torch.zeros(3, *sample.image_size) if sample.image is None else sample.image / 255
    return {"image": image[None].float(), "sparse_depth_m": depth[None, None]}


class FinderExamples(SamplePreparation):
    """Crops at random positions, half of them mirrored, with their labels."""

    parts = frozenset({"image", "points", "objects"})

    def __init__(self, crop_size: tuple[int, int] = (8, 24)) -> None:
        self.crop_size = crop_size

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> FinderBatch:
        spare = np.subtract(sample.image_size, self.crop_size)
        top, left = rng.integers(spare + 1) if training else spare // 2
        part = crop(sample, int(top), int(left), *self.crop_size)
        if training and rng.random() < 0.5:
            part = mirror(part)
        boxes = part.objects.boxes2d[part.objects.has_box3d]
        return FinderBatch(sample_ids=(sample.sample_id,), boxes=(boxes,), **network_inputs(part))
