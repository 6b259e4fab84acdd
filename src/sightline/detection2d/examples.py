"""Preparation of samples for training and scoring the 2D detectors, and training views."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64
from torch import Tensor

from sightline.augmentation.camera_chain import CameraChainConfig, change_camera
from sightline.augmentation.faults import Fault
from sightline.augmentation.sample_changes import ColorJitterConfig, crop, jitter_color, mirror
from sightline.augmentation.scene_changes import resize
from sightline.corruptions.corruption import Corrupted
from sightline.corruptions.drawing import CorruptionSampler
from sightline.corruptions.suites import CLEAN
from sightline.data.formats.kitti_conversion import kitti_from_labels
from sightline.detection2d import graded_health
from sightline.detection2d.config import CLASSES, Detection2DConfig, InputConfig
from sightline.detection2d.graded_health import with_point_health
from sightline.detection2d.loss import health, known_by_points
from sightline.detection2d.placement import (
    camera_image,
    lidar_image,
    padded,
    place,
    scale_of,
    whole_strides,
)
from sightline.detection2d.targets import DetectionBatch, FrameTruth, TargetConfig, make_targets
from sightline.detection2d.views import draw_band
from sightline.files.settings import NetworkConfig
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.projection import DHI_RANGE_M
from sightline.geometry.ranges import check_range
from sightline.structures.labels import ObjectLabels
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample, check_points
from sightline.training.data import SamplePreparation, check_agrees

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
    bands: bool = False
    """Cutting of crops of a fixed size from the bands along the horizon that the network is
    shown in use, one of a frame's bands each time, at its scale (`detection2d.views`)."""

    def __post_init__(self) -> None:
        """Check the ranges."""
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
        min(side, max(round(target / scale), 1))
        for side, target in zip(sample.image_size, size, strict=True)
    )
    top, left = _corner(sample, height, width, config, rng)
    part = crop(sample, top, left, height, width)
    new_size = tuple(
        min(max(round(side * scale), 1), target)
        for side, target in zip((height, width), size, strict=True)
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


_SOUND = CorruptionSampler(probabilities={CLEAN: 1.0})
_HALF_LEVEL = 127  # threshold of a mask painted as an image


@dataclass(frozen=True, kw_only=True)
class ExampleConfig:
    """Settings of examples for training and scoring, and of the training augmentations."""

    input: InputConfig | None = None
    """Preparation of frames. None: as in the network's settings."""
    pad_to: int = 32
    """Divisor of the padded height and width: the network's stride."""
    crop_size: tuple[int, int] | None = (384, 640)
    """Height, width [px] of training crops. None: whole frames, or patches of them, at the
    network's input size."""
    view: ViewConfig = ViewConfig()
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
    graded: bool = False
    """Graded health for every kind of corruption: the signal that is left in each cell,
    with noise, blur and moved points (`detection2d.graded_health`), not only what is gone."""
    fault_share: float = 0.5
    """Share of training examples with an additional fault. Of these faults, health contains only a
    missing camera."""
    targets: TargetConfig = TargetConfig()  # noqa: RUF009
    """Ground-truth objects that training uses as targets."""

    def __post_init__(self) -> None:
        """Check the ranges, and that related settings match."""
        check_range("fault_share", self.fault_share, 0, 1)
        check_range("pad_to", self.pad_to, 1, 1024)
        if self.graded and not self.health:
            raise ValueError("graded is of health maps: set health to true, or graded to false")
        if self.crop_size is not None and self.view.min_iou_crop:
            raise ValueError("view.min_iou_crop cuts patches of its own: set crop_size to null")
        if self.crop_size is None and self.view.bands:
            raise ValueError(
                "view.bands is of crops of a fixed size: set crop_size, or it to false"
            )

    @property
    def network_input(self) -> InputConfig:
        """Preparation of frames in use: by default the default of networks."""
        return self.input or InputConfig()


class DetectionExamples(SamplePreparation):
    """Examples for training and scoring detection, each a batch of one."""

    parts = frozenset({"image", "points", "objects"})
    learned_box = "2D"

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
        self.learned_occlusion = settings.targets.max_occlusion

    def for_network(self, config: NetworkConfig) -> "DetectionExamples":
        """Take the input of the network."""
        assert isinstance(config, Detection2DConfig), "it is the network of this task"
        check_agrees("input", self.settings.input, config.input)
        if self.settings.crop_size is None and config.input.size is None:
            raise ValueError(
                "frames of any size make no batches: set crop_size of the preparation, or the "
                "network's input.size to resize all"
            )
        return DetectionExamples(replace(self.settings, input=config.input), self.faults)

    def for_update(self, rng: np.random.Generator) -> "DetectionExamples":
        """Draw one case for all samples of a batch, if the settings require it."""
        cases = self.settings.cases
        if cases is None or cases.per == "image":
            return self
        (case,) = cases.draw(rng)
        only = replace(cases, probabilities={case.name: 1.0}, per="image")
        return DetectionExamples(replace(self.settings, cases=only), self.faults)

    def learned_classes(self) -> tuple[str, ...]:
        """Name the classes to detect."""
        return CLASSES

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> DetectionBatch:
        """Prepare a `training_example` or a `scoring_example`.

        Raises:
            ValueError: The sample has no labels, or points that `check_points` refuses.
        """
        if sample.objects is None:
            raise ValueError(
                f"sample {sample.sample_id} has no labels to train on or to score against; give "
                "data with label_2"
            )
        check_points(sample)
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
    view, range_m = _ranged_view(corrupted.sample, config, np.random.default_rng(seed))
    assert view.objects is not None, "checked when it was prepared"
    targets = make_targets(view.objects, config.targets)
    camera_mask = lidar_mask = torch.zeros(view.image_size, dtype=torch.bool)
    are_masks_used = config.health or config.camera is not None
    if are_masks_used and (corrupted.camera_mask.any() or corrupted.lidar_mask.any()):
        camera_mask, lidar_mask = _seen_masks(corrupted, config, np.random.default_rng(seed))
    before_lens = view
    if config.camera is not None:
        view = _through_camera(view, camera_mask, config.camera, rng)
    size = whole_strides(config.crop_size or view.image_size, config.pad_to)
    maps = _maps(view, config.network_input, size, range_m=range_m)
    camera_health = lidar_health = None
    if config.graded:
        camera_health, lidar_health = _graded_health(sample, corrupted, before_lens, config, seed)
    elif config.health:
        nothing_left = case.corruption.leaves_nothing
        sound = maps["lidar"]
        if lidar_mask.any():
            sound_view = _view(replace(sample, image=None), config, np.random.default_rng(seed))
            sound = padded(lidar_image(sound_view, config.network_input), size)
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


def _graded_health(
    sound: CameraLidarSample,
    corrupted: Corrupted,
    view: CameraLidarSample,
    config: ExampleConfig,
    seed: int,
) -> tuple[Float32[Tensor, "1 1 rows columns"], Float32[Tensor, "1 1 rows columns"]]:
    """Compute the graded health of both sensors; `view` is the corrupted sample's of the seed."""
    size = whole_strides(config.crop_size or view.image_size, config.pad_to)
    valued = _view(with_point_health(sound, corrupted), config, np.random.default_rng(seed))
    of_camera = graded_health.camera_health(camera_image(valued), camera_image(view), size)
    if view.image is None:  # missing in the data
        of_camera = torch.zeros_like(of_camera)
    return of_camera[None], graded_health.lidar_health(valued, size)[None]


def scoring_example(sample: CameraLidarSample, config: ExampleConfig) -> DetectionBatch:
    """Prepare a batch of one: the whole frame without changes, with all of its labels."""
    assert sample.objects is not None, "checked when it was prepared"
    given, placement = place(sample, config.network_input)
    assert given.objects is not None, "as before"
    size = whole_strides(given.image_size, config.pad_to)
    maps = _maps(given, config.network_input, size)
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
    return _ranged_view(sample, config, rng)[0]


def _ranged_view(
    sample: CameraLidarSample, config: ExampleConfig, rng: np.random.Generator
) -> tuple[CameraLidarSample, float]:
    """Draw a view, and the far end of its LiDAR image's depth [m]."""
    # The depth map of simulated frames is not needed, and takes as long to resize as the image.
    sample = draw_mirror(replace(sample, depth=None), config.view, rng)
    if config.crop_size is not None:
        scale, range_m = scale_of(sample, config.network_input), DHI_RANGE_M
        if config.view.bands:
            sample, scale, range_m = draw_band(sample, config.network_input, config.pad_to, rng)
        return scaled_crop(sample, config.crop_size, scale, config.view, rng), range_m
    if config.view.min_iou_crop:
        sample = min_iou_crop(sample, rng)
    return place(sample, config.network_input)[0], DHI_RANGE_M


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
    sample: CameraLidarSample,
    config: InputConfig,
    size: tuple[int, int],
    *,
    range_m: float = DHI_RANGE_M,
) -> dict[str, Tensor]:
    """Make the sensors' images, padded to a size."""
    return {
        "image": padded(camera_image(sample), size),
        "lidar": padded(lidar_image(sample, config, range_m=range_m), size),
    }
