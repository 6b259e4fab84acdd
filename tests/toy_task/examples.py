"""What it trains on: images, points, and the boxes of each frame, as many as there are."""

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
    """Samples of one image size, each with truth of its own length."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]
    boxes: tuple[Boxes2D, ...]
    """Of the objects of each frame: ragged."""


def inputs_of(sample: CameraLidarSample) -> dict[str, Tensor]:
    """What the network takes of a sample: a batch of one."""
    depth = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    image = torch.zeros(3, *sample.image_size) if sample.image is None else sample.image / 255
    return {"image": image[None].float(), "sparse_depth_m": depth[None, None]}


class FinderExamples(SamplePreparation):
    """Crops at random places, every second one in a mirror, with the labels that they show."""

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
        return FinderBatch(sample_ids=(sample.sample_id,), boxes=(boxes,), **inputs_of(part))
