"""Training views of a sample: crops, scales, mirror images."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from sightline.augmentation.sample_changes import crop, mirror
from sightline.augmentation.scene_changes import resize
from sightline.detection2d.config import CLASSES, check_range
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample

_MIN_OVERLAPS = (0.1, 0.3, 0.5, 0.7, 0.9, 0.0)  # the last one: any patch
_SMALLEST_SIDE, _ASPECT = 0.3, 2.0  # of a patch, relative to the image
_TRIES = 50
_NEAR_OBJECT = (0.15, 0.85)  # place in a crop of a chosen object's centre


@dataclass(frozen=True, kw_only=True)
class ViewConfig:
    """Sampling of training views."""

    min_iou_crop: bool = False
    """Whether to cut out a patch as SSD does, and stretch it to the network's input."""
    scales: tuple[float, float] = (1.0, 1.0)
    """Smallest and largest factor on the sides of the image, for crops of a fixed size."""
    object_share: float = 0.75
    """Share of fixed-size crops that are placed to show an object. Its class is drawn evenly from
    the frame's classes, since rare ones would hardly appear otherwise."""
    mirror: bool = True
    """Whether every second example is mirrored."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        low, high = self.scales
        if not 0 < low <= high < math.inf:
            raise ValueError(f"view.scales must be positive and in order, got {self.scales}")
        check_range("view.object_share", self.object_share, 0, 1)


def draw_mirror(
    sample: CameraLidarSample, config: ViewConfig, rng: np.random.Generator
) -> CameraLidarSample:
    """Mirror the sample at random."""
    return mirror(sample) if config.mirror and rng.random() < 0.5 else sample


def min_iou_crop(sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
    """Cut out a random patch: Liu et al. 2016 (SSD), section 2.2, data augmentation.

    The result is the whole image, a patch that overlaps an object by at least a drawn IoU, or any
    patch. Patches have 0.3 to 1 of each side of the image, and change its aspect ratio by at most a
    factor of 2. Departure: objects with their centre outside are not dropped; their truncation
    grows, and `TargetConfig` ignores them by it.
    """
    choice = int(rng.integers(len(_MIN_OVERLAPS) + 1))
    if choice == len(_MIN_OVERLAPS) or sample.objects is None or not len(sample.objects):
        return sample
    boxes = Boxes2D(sample.objects.boxes2d.tensor)
    height, width = sample.image_size
    for _ in range(_TRIES):
        shares = rng.uniform(_SMALLEST_SIDE, 1, size=2)
        new_height, new_width = int(shares[0] * height), int(shares[1] * width)
        top = int(rng.integers(height - new_height + 1))
        left = int(rng.integers(width - new_width + 1))
        if not 1 / _ASPECT <= shares[0] / shares[1] <= _ASPECT:
            continue
        patch = torch.tensor(
            [[left, top, left + new_width - 1, top + new_height - 1]], dtype=boxes.tensor.dtype
        )
        if float(pairwise_iou2d(Boxes2D(patch), boxes).max()) >= _MIN_OVERLAPS[choice]:
            return crop(sample, top, left, new_height, new_width)
    return sample


def scaled_crop(
    sample: CameraLidarSample,
    size: tuple[int, int],
    scale: float,
    config: ViewConfig,
    rng: np.random.Generator,
) -> CameraLidarSample:
    """Cut out a part of the image at a random scale, of `size`, or smaller at the image's border.

    Args:
        sample: The sample at its own size.
        size: Height, width [px] of the crop.
        scale: Factor on the random scale.
        config: Sampling of the view.
        rng: Source of all randomness.
    """
    scale *= math.exp(rng.uniform(math.log(config.scales[0]), math.log(config.scales[1])))
    height, width = (
        min(side, max(round(wanted / scale), 1))
        for side, wanted in zip(sample.image_size, size, strict=True)
    )
    top, left = _corner(sample, height, width, config, rng)
    part = crop(sample, top, left, height, width)
    new_size = tuple(
        min(max(round(side * scale), 1), wanted)
        for side, wanted in zip((height, width), size, strict=True)
    )
    return part if new_size == part.image_size else resize(part, *new_size)


def _corner(
    sample: CameraLidarSample,
    height: int,
    width: int,
    config: ViewConfig,
    rng: np.random.Generator,
) -> tuple[int, int]:
    """Draw top and left of a crop."""
    spare = np.subtract(sample.image_size, (height, width))
    anywhere = rng.integers(spare + 1)
    is_aimed = rng.random() < config.object_share
    within = rng.uniform(*_NEAR_OBJECT, size=2)
    pick = rng.random()
    if not is_aimed or sample.objects is None or not sample.objects.has_box3d.any():
        return int(anywhere[0]), int(anywhere[1])
    box = _picked_box(sample.objects.select(sample.objects.has_box3d), pick)
    middle = ((box[:2] + box[2:]) / 2).flip(0).numpy()
    corner = np.rint(middle - within * (height, width)).clip(0, spare)
    return int(corner[0]), int(corner[1])


def _picked_box(objects: ObjectLabels, pick: float) -> Float64[Tensor, "4"]:
    """Pick an object's box: `pick`, in [0, 1), selects its class, then the object in the class."""
    names = objects.class_names
    classes = sorted({name for name in names if name in CLASSES}) or sorted(set(names))
    place = pick * len(classes)
    of_class = [index for index, name in enumerate(names) if name == classes[int(place)]]
    return objects.boxes2d.tensor[of_class[int(place % 1 * len(of_class))]]
