"""Preparation of samples for training and scoring the 2D detectors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from sightline.augmentation.camera_chain import CameraChainConfig, change_camera
from sightline.augmentation.faults import Fault
from sightline.augmentation.sample_changes import ColorJitterConfig, jitter_color
from sightline.corruptions.corruption import Corrupted
from sightline.corruptions.drawing import CorruptionSampler
from sightline.corruptions.suites import CLEAN
from sightline.data.object_labels import kitti_from_labels
from sightline.detection2d.augmentation import (
    ViewConfig,
    draw_mirror,
    min_iou_crop,
    scaled_crop,
)
from sightline.detection2d.batch import DetectionBatch, FrameTruth
from sightline.detection2d.config import InputConfig, check_range
from sightline.detection2d.health import health, known_by_points
from sightline.detection2d.placement import (
    camera_image,
    lidar_image,
    padded,
    place,
    scale_of,
    whole_strides,
)
from sightline.detection2d.targets import TargetConfig, make_targets
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample
from sightline.structures.sweep_checks import check_finite_points
from sightline.training.data import SamplePreparation

_SOUND = CorruptionSampler(probabilities={CLEAN: 1.0})
_HALF_LEVEL = 127  # threshold of a mask painted as an image


@dataclass(frozen=True, kw_only=True)
class ExampleConfig:
    """Settings of examples for training and scoring, and of the training augmentations."""

    input: InputConfig = InputConfig()  # noqa: RUF009 - frozen
    """Preparation of frames: as in the network's own settings."""
    pad_to: int = 1
    """Divisor of the padded height and width: the network's stride."""
    crop_size: tuple[int, int] | None = None
    """Height, width [px] of training crops. None: whole frames, or patches of them, at the
    network's input size."""
    view: ViewConfig = ViewConfig()  # noqa: RUF009
    """Sampling of training views."""
    color_jitter: ColorJitterConfig | None = None
    """Colour changes in training. None: none."""
    camera: CameraChainConfig | None = None
    """Variation of the camera in training. None: none."""
    cases: CorruptionSampler | None = None
    """Corruptions in training. None: none."""
    health: bool = False
    """Whether training examples have health maps: the parts of the sensors' images that their case
    has not broken."""
    fault_share: float = 0.5
    """Share of training examples with an additional fault. Of these faults, health contains only a
    missing camera."""
    targets: TargetConfig = TargetConfig()  # noqa: RUF009
    """Ground-truth objects that training uses as targets."""

    def __post_init__(self) -> None:
        """Checks the ranges, and that related settings match."""
        check_range("fault_share", self.fault_share, 0, 1)
        check_range("pad_to", self.pad_to, 1, 1024)
        if self.crop_size is None and self.input.size is None:
            raise ValueError(
                "frames of any size make no batches: set crop_size, or input.size to resize all"
            )
        if self.crop_size is not None and self.view.min_iou_crop:
            raise ValueError("view.min_iou_crop cuts patches of its own: set crop_size to null")


class DetectionExamples(SamplePreparation):
    """Examples for training and scoring detection, each a batch of one."""

    parts = frozenset({"image", "points", "objects"})

    def __init__(
        self,
        settings: ExampleConfig = ExampleConfig(),
        faults: Sequence[Fault] = (),
    ) -> None:
        """Take the settings.

        Args:
            settings: Contents of the examples.
            faults: Additional sensor faults in training, equally likely.
        """
        self.settings = settings
        self.faults = tuple(faults)

    def for_update(self, rng: np.random.Generator) -> "DetectionExamples":
        """Draw one case for all samples of a batch, if the settings ask for it."""
        cases = self.settings.cases
        if cases is None or cases.per == "image":
            return self
        (case,) = cases.draw(rng)
        only = replace(cases, probabilities={case.name: 1.0}, per="image")
        return DetectionExamples(replace(self.settings, cases=only), self.faults)

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> DetectionBatch:
        """Prepare a `training_example` or a `scoring_example`.

        Raises:
            ValueError: The sample has no labels, or points that are not finite.
        """
        if sample.objects is None:
            raise ValueError(
                f"sample {sample.sample_id} has no labels to train on or to score against; give "
                "data with label_2"
            )
        check_finite_points(sample)
        if training:
            return training_example(sample, self.settings, self.faults, rng)
        return scoring_example(sample, self.settings)


def training_example(
    sample: CameraLidarSample,
    config: ExampleConfig,
    faults: Sequence[Fault],
    rng: np.random.Generator,
) -> DetectionBatch:
    """Prepare a batch of one: a view of the frame, maybe with a sensor fault, and its ground truth.

    Colours are changed first, so that pixels blackened by a corruption stay black. Sensors are
    broken next, on the original frame: some faults depend on the order of its points, which
    mirroring destroys. Lens and image sensor effects come last, where the camera is not broken.
    """
    if config.color_jitter is not None:
        sample = jitter_color(sample, rng, config.color_jitter)
    if faults and rng.random() < config.fault_share:
        sample = faults[int(rng.integers(len(faults)))](sample, rng)
    (case,) = (config.cases or _SOUND).draw(rng)
    corrupted = case.corruption.corrupt(sample, rng)
    seed = int(rng.integers(2**63))  # the same view for sample, masks and intact sweep
    view = _view(corrupted.sample, config, np.random.default_rng(seed))
    assert view.objects is not None, "checked when it was prepared"
    targets = make_targets(view.objects, config.targets)
    camera_mask = lidar_mask = torch.zeros(view.image_size, dtype=torch.bool)
    are_masks_used = config.health or config.camera is not None
    if are_masks_used and (corrupted.camera_mask.any() or corrupted.lidar_mask.any()):
        camera_mask, lidar_mask = _seen_masks(corrupted, config, np.random.default_rng(seed))
    if config.camera is not None:
        view = _through_camera(view, camera_mask, config.camera, rng)
    size = whole_strides(config.crop_size or view.image_size, config.pad_to)
    maps = _maps(view, config.input, size)
    camera_health = lidar_health = None
    if config.health:
        nothing_left = case.corruption.leaves_nothing
        sound = maps["lidar"]
        if lidar_mask.any():
            sound_view = _view(replace(sample, image=None), config, np.random.default_rng(seed))
            sound = padded(lidar_image(sound_view, config.input), size)
        camera_health = health(camera_mask, size, nothing_left=nothing_left)[None]
        if view.image is None:  # missing in the data, not by a case
            camera_health = torch.zeros_like(camera_health)
        lidar_health = health(lidar_mask, size, nothing_left=nothing_left)
        lidar_health = known_by_points(lidar_health, sound)[None]
    return DetectionBatch(
        sample_ids=(sample.sample_id,),
        targets=(targets,),
        image=maps["image"][None],
        lidar=maps["lidar"][None],
        camera_health=camera_health,
        lidar_health=lidar_health,
    )


def scoring_example(sample: CameraLidarSample, config: ExampleConfig) -> DetectionBatch:
    """Prepare a batch of one: the whole frame without changes, with all of its labels."""
    assert sample.objects is not None, "checked when it was prepared"
    given, placement = place(sample, config.input)
    assert given.objects is not None, "as before"
    size = whole_strides(given.image_size, config.pad_to)
    maps = _maps(given, config.input, size)
    level = level_sample(sample)
    assert level.objects is not None, "as before"
    truth = FrameTruth(
        placement=placement, objects=kitti_from_labels(level.objects, level.calibration)
    )
    return DetectionBatch(
        sample_ids=(sample.sample_id,),
        targets=(make_targets(given.objects, config.targets),),
        frames=(truth,),
        image=maps["image"][None],
        lidar=maps["lidar"][None],
    )


def _view(
    sample: CameraLidarSample, config: ExampleConfig, rng: np.random.Generator
) -> CameraLidarSample:
    # The depth map of simulated frames is not needed, and takes as long to resize as the image.
    sample = draw_mirror(replace(sample, depth=None), config.view, rng)
    if config.crop_size is not None:
        scale = scale_of(sample, config.input)
        return scaled_crop(sample, config.crop_size, scale, config.view, rng)
    if config.view.min_iou_crop:
        sample = min_iou_crop(sample, rng)
    return place(sample, config.input)[0]


def _seen_masks(
    corrupted: Corrupted, config: ExampleConfig, rng: np.random.Generator
) -> tuple[Bool[Tensor, "height width"], Bool[Tensor, "height width"]]:
    """Transform the masks of camera and LiDAR to a view, like an image."""
    masks = torch.stack(
        (corrupted.camera_mask, corrupted.lidar_mask, torch.zeros_like(corrupted.camera_mask))
    )
    painted = replace(corrupted.sample, image=masks.byte() * 255, points=None)
    image = _view(painted, config, rng).image
    assert image is not None, "it was given one"
    return image[0] > _HALF_LEVEL, image[1] > _HALF_LEVEL


def _through_camera(
    view: CameraLidarSample,
    broken: Bool[Tensor, "height width"],
    config: CameraChainConfig,
    rng: np.random.Generator,
) -> CameraLidarSample:
    changed = change_camera(view, rng, config)
    if changed.image is None or view.image is None or not broken.any():
        return changed
    return replace(changed, image=torch.where(broken, view.image, changed.image))


def _maps(
    sample: CameraLidarSample, config: InputConfig, size: tuple[int, int]
) -> dict[str, Tensor]:
    """Make the sensors' images, padded to a size."""
    return {
        "image": padded(camera_image(sample), size),
        "lidar": padded(lidar_image(sample, config), size),
    }
