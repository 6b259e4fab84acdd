"""Training and validation examples from samples."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from beartype import beartype
from jaxtyping import Float32, jaxtyped
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

from sightline.augmentation.camera_chain import CameraChainConfig, change_camera
from sightline.augmentation.faults import FalseEchoes, NoCamera, draw_turned_lidar
from sightline.augmentation.sample_changes import (
    ColorJitterConfig,
    crop,
    jitter_color,
    thin_rings,
)
from sightline.corruptions.blank import LidarBlank
from sightline.corruptions.lidar_loss import LidarSector
from sightline.corruptions.occlusion import LidarOcclusion
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.formats.rings import NUM_RINGS
from sightline.depth_completion.method_names import Filling
from sightline.depth_completion.methods import starting_depth
from sightline.depth_completion.street_depth import street_depth, to_focal_length
from sightline.depth_completion.truth_shaping import (
    AS_SIMULATED,
    TruthShaping,
    pixel_weights,
    widen_near_surfaces,
)
from sightline.evaluation.held_out_frame import (
    BEAMS,
    CROP_SIZE,
    FIRST_HELD_OUT,
    HELD_OUT_EVERY,
    HeldOutFrame,
    dense_truth_in_reach,
    split_rings,
)
from sightline.geometry.choices import check_choices
from sightline.geometry.projection import sparse_depth_map
from sightline.geometry.ranges import check_range
from sightline.structures.batch import FieldwiseBatch
from sightline.structures.sample import CameraLidarSample
from sightline.training.data import SamplePreparation


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBatch(FieldwiseBatch):
    """Batch of samples of one image size. Depth maps: metres along the optical axis, 0 = none.

    A missing camera image is black, like the image of a dead camera.
    """

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    """RGB in [0, 1]."""
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]
    """The sweep projected into the image."""
    filled_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """The sparse map completed by a classical method, for networks that start from one."""
    depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Ground truth for training or scoring."""
    dense_depth_m: Float32[Tensor, "batch 1 height width"] | None = None
    """Additional dense ground truth for training, where `depth_m` contains only a few rings."""
    weight: Float32[Tensor, "batch 1 height width"] | None = None
    """Weight of each pixel of `depth_m` in the loss; None: all equal."""


_SETTINGS = "--data.init_args.preparation.init_args.settings"
_LOOKED_AT = 20  # frames of a data set, before a training

TruthKind = Literal["depth", "held_out", "both"]
"""Kind of ground truth. `depth`: the depth map of the data set, dense from the simulator or the
benchmark's. `held_out`: every eighth ring of the sweep, removed from the network's input
(self-supervision; the sweep must be in KITTI's order). `both`: held-out rings, and the depth map
as additional dense truth with its own loss weight.
"""

_MAX_TRUTH_M = 256  # range of KITTI's depth maps
_SECTOR_DEG = (10.0, 60.0)
_EDGE_PADDED = ("image", "filled_depth_m")  # other maps hold 0 where nothing is known
_SIZE_STEP = 32  # validation crops are multiples of it, which suits all our networks


@dataclass(frozen=True, kw_only=True)
class AugmentationConfig:
    """Augmentation of training examples: sensor faults, other views of the scene."""

    yaw_error_deg: float = 0.0
    """Standard deviation of the LiDAR's yaw error [deg]; half as much in pitch and roll."""
    outliers: float = 0.0
    """Largest share of returns with a wrong range."""
    camera_dropout: float = 0.0
    """Share of examples without a camera."""
    lidar_occlusion: float = 0.0
    """Share of examples with an occluded part of the sweep."""
    lidar_sector: float = 0.0
    """Share of examples without the returns of a random wedge of 10 to 60 degrees."""
    lidar_dropout: float = 0.0
    """Share of examples without any return."""
    color_jitter: ColorJitterConfig | None = None
    """Random brightness, contrast, gamma and saturation of the image."""
    camera: CameraChainConfig | None = None
    """Images as by other lenses and sensors."""
    mirror: bool = False
    """Whether half of the examples are mirrored."""
    random_crop: bool = True
    """Whether the crop's position is random; otherwise it is the bottom centre."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_range("yaw_error_deg", self.yaw_error_deg, 0, 90)
        for name in (
            "outliers",
            "camera_dropout",
            "lidar_occlusion",
            "lidar_sector",
            "lidar_dropout",
        ):
            check_range(name, getattr(self, name), 0, 1)


@dataclass(frozen=True, kw_only=True)
class ExampleConfig:
    """Contents of examples for training and scoring, and their augmentation in training."""

    truth: TruthKind = "depth"
    """Source of the true depth."""
    filled: bool = False
    """Whether examples contain completed depth, the input that `filled_input` adds to a network."""
    filling: Filling = "first"
    """Kind of completion; must be the network's."""
    focal_px: float | None = None
    """Focal length to which images are resized [px]; must be the network's. Smaller ones than the
    crop are padded, as in use. None: the image's own."""
    shaping: TruthShaping = AS_SIMULATED
    """Changes and pixel weights of dense truth for training."""
    farthest_m: float = 90.0
    """Largest used true depth: sweeps do not reach farther, and KITTI's truth ends before."""
    crop_size: tuple[int, int] | None = None
    """Height and width of the crop [px]; None: the benchmark's 352 x 1216."""
    beams: tuple[int, ...] = (64,)
    """Densities to draw from, in beams of 64; repeat a number to draw it more often. With held-out
    rings, those that divide the sensor's number of beams are drawn: of 16, 16 and 8."""
    augmentation: AugmentationConfig = AugmentationConfig()
    """Augmentation in training."""

    def __post_init__(self) -> None:
        """Check the choices and the ranges."""
        check_choices(self)
        if self.shaping != AS_SIMULATED and self.truth != "depth":
            raise ValueError(f"shaping needs dense truth: set truth to depth, got {self.truth}")
        if not 0 < self.farthest_m <= _MAX_TRUTH_M:
            raise ValueError(
                f"farthest_m must be above 0 and at most {_MAX_TRUTH_M}, got {self.farthest_m}"
            )
        if self.crop_size is not None and min(self.crop_size) < 1:
            raise ValueError(
                f"crop_size must be at least 1 x 1 (height x width), got {self.crop_size}"
            )
        if not self.beams or not set(self.beams) <= set(BEAMS):
            raise ValueError(
                f"beams must be some of {', '.join(map(str, BEAMS))}, got {self.beams}"
            )


class DepthExamples(SamplePreparation):
    """Examples for training and scoring depth completion, each a batch of one."""

    def __init__(self, settings: ExampleConfig = ExampleConfig()) -> None:
        """Store the settings; request samples with a depth map if it is the truth."""
        self.settings = settings
        if settings.truth != "held_out":
            self.parts = frozenset({"image", "points", "depth"})

    def for_training(
        self, datasets: Sequence[SampleDataset], rng: np.random.Generator
    ) -> "DepthExamples":
        """Refuse training data whose depth maps are empty, by frames spread over each data set.

        Densities that the sensor of a data set's first frame cannot have are told.

        Raises:
            ValueError: No map of `_LOOKED_AT` frames of each data set has a depth in reach, or a
                sensor can have none of the densities.
        """
        del rng
        if self.settings.truth != "depth":
            for line in dict.fromkeys(_beams_note(each[0], self.settings) for each in datasets):
                if line is not None:
                    rank_zero_only(print)(line, file=sys.stderr)
        if self.settings.truth == "held_out":
            return self
        for dataset in datasets:
            chosen = _spread(dataset)
            if not any(self._has_truth(dataset[index]) for index in chosen):
                first, last = (dataset.sample_ids[chosen[end]] for end in (0, -1))
                raise ValueError(
                    f"the depth maps of {len(chosen)} training frames, {first} to {last}, have no "
                    f"depth from 0 to {self.settings.farthest_m:g} m to learn from; leave out "
                    "frames without depth, or check that maps hold metres times 256 (sightline "
                    "check)"
                )
        return self

    def _has_truth(self, sample: CameraLidarSample) -> bool:
        """Test if a depth map has a depth in reach; without a map, `prepare` says so."""
        depth_m = sample.depth
        return depth_m is None or bool((_without_far(self.settings.farthest_m, depth_m) > 0).any())

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> DepthBatch:
        """Make an example; see `make_example`."""
        return make_example(sample, self.settings, rng, training=training)


def _spread(dataset: SampleDataset) -> list[int]:
    """Choose frames spread over a data set."""
    chosen = np.linspace(0, len(dataset) - 1, min(_LOOKED_AT, len(dataset))).astype(int)
    return [int(index) for index in chosen]


def make_example(
    sample: CameraLidarSample,
    config: ExampleConfig,
    rng: np.random.Generator,
    *,
    training: bool,
) -> DepthBatch:
    """Make a batch of one: image, sparse depth without held-out rings, and the truth.

    In validation nothing is perturbed and the crop is the bottom centre. The density is still
    drawn: a generator seeded by the sample alone gives the same example every time.

    Raises:
        ValueError: The sample lacks its sweep or the requested truth, or is too small.
    """
    sample = to_focal_length(sample, config.focal_px)
    inputs, dense_m = _split_truth(sample, config, rng, training=training)
    if training:
        inputs = _perturbed(inputs, config.augmentation, rng)
    assert inputs.points is not None, "checked by _split_truth"
    assert inputs.depth is not None, "set by _split_truth"
    sparse_m = sparse_depth_map(inputs.points, inputs.calibration, inputs.image_size)
    image = inputs.image
    truth_m = _without_far(config.farthest_m, inputs.depth)
    maps = {
        "image": torch.zeros(3, *inputs.image_size) if image is None else image.float() / 255,
        "sparse_depth_m": sparse_m[None],
        "depth_m": truth_m[None],
    }
    if dense_m is not None:
        maps["dense_depth_m"] = _without_far(config.farthest_m, dense_m)[None]
    if config.filled:  # over the whole width: a crop shows too little of the ring spacing
        maps["filled_depth_m"] = (
            street_depth(inputs)
            if config.filling == "street"
            else starting_depth(sparse_m, config.filling).depth_m
        )[None]
    if training and config.shaping != AS_SIMULATED:
        whole = _bottom_centre(sample, inputs.image_size)
        assert whole.points is not None, "checked by _split_truth"
        all_beams_m = sparse_depth_map(whole.points, whole.calibration, whole.image_size)
        maps |= _shaped(maps, all_beams_m, config.shaping)
    if config.focal_px is not None and config.crop_size is not None:
        maps = {name: _padded(item, config.crop_size, name) for name, item in maps.items()}
    size = maps["image"].shape[1], maps["image"].shape[2]
    top, left, height, width = _window(size, config, rng, training=training)
    cropped = {
        name: item[:, top : top + height, left : left + width] for name, item in maps.items()
    }
    if training and config.augmentation.mirror and rng.random() < 0.5:
        cropped = {name: item.flip(-1) for name, item in cropped.items()}
    stacked = {name: item[None].contiguous() for name, item in cropped.items()}
    return DepthBatch(sample_ids=(sample.sample_id,), **stacked)


def _shaped(
    maps: Mapping[str, Tensor], all_beams_m: Tensor, shaping: TruthShaping
) -> dict[str, Tensor]:
    """Widen the truth's contours and compute the pixels' weights."""
    truth_m, sparse_m = maps["depth_m"][0].numpy(), maps["sparse_depth_m"][0].numpy()
    filled_m = maps["filled_depth_m"][0].numpy() if "filled_depth_m" in maps else None
    weights = pixel_weights(truth_m, sparse_m, filled_m, shaping, all_beams_m=all_beams_m.numpy())
    widened = widen_near_surfaces(truth_m, shaping)
    return {"depth_m": torch.from_numpy(widened)[None], "weight": torch.from_numpy(weights)[None]}


def _without_far(farthest_m: float, depth_m: Tensor) -> Tensor:
    return torch.where(depth_m <= farthest_m, depth_m, 0.0)


def _split_truth(
    sample: CameraLidarSample, config: ExampleConfig, rng: np.random.Generator, *, training: bool
) -> tuple[CameraLidarSample, Tensor | None]:
    """Split a sample into the network's input, with the truth as its depth map, and dense truth."""
    if sample.points is None:
        raise ValueError(
            f"sample {sample.sample_id} has no sweep, so there is no depth to complete; give data "
            "with LiDAR points"
        )
    if config.truth != "held_out" and sample.depth is None:
        raise ValueError(
            f"sample {sample.sample_id} has no true depth, but truth is {config.truth}: give "
            "simulated data or KITTI's depth tree, or set truth to held_out"
        )
    max_size = _max_crop_size(sample)
    if config.truth == "depth":  # the truth is not from the sweep: no ring is held out
        if config.shaping.in_reach:
            sample = replace(sample, depth=dense_truth_in_reach(sample))
        keep_every = NUM_RINGS // int(rng.choice(config.beams))
        if keep_every > 1:
            first = int(rng.integers(keep_every)) if training else 0
            with _ring_remedy():
                sample = thin_rings(sample, keep_every, first)
        return _bottom_centre(sample, max_size), None
    first = int(rng.integers(HELD_OUT_EVERY)) if training else FIRST_HELD_OUT
    with _ring_remedy():
        frame = split_rings(sample, first_held_out=first)
    beams = int(rng.choice(_fitting_beams(frame, config)))
    start = int(rng.integers(frame.sensor_beams // beams)) if training else 0
    inputs = frame.with_beams(beams, start=start)
    dense_m = None
    if config.truth == "both":
        dense_m = _bottom_centre(_bottom_centre(sample, inputs.image_size), max_size).depth
    inputs = _bottom_centre(replace(inputs, depth=frame.truth_m), max_size)
    return inputs, dense_m


def _fitting_beams(frame: HeldOutFrame, config: ExampleConfig) -> list[int]:
    """Select the densities that divide the sensor's number of beams.

    Raises:
        ValueError: There is none.
    """
    fitting = [beams for beams in config.beams if frame.sensor_beams % beams == 0]
    if not fitting:
        given = ", ".join(map(str, config.beams))
        usable = [beams for beams in BEAMS if frame.sensor_beams % beams == 0]
        raise ValueError(
            f"sample {frame.sample.sample_id}: none of the beams {given} "
            f"divides the {frame.sensor_beams} of its LiDAR; set {_SETTINGS}.beams '{usable}'"
        )
    return fitting


def _beams_note(sample: CameraLidarSample, config: ExampleConfig) -> str | None:
    """Describe the densities that are not drawn, as the sensor cannot have them; None: all are.

    Raises:
        ValueError: It can have none.
    """
    try:
        frame = split_rings(sample)
    except ValueError:  # its example says so
        return None
    fitting = _fitting_beams(frame, config)
    if len(fitting) == len(config.beams):
        return None
    return (
        f"the LiDAR has {frame.sensor_beams} beams (sample {sample.sample_id}): of the "
        f"preparation's beams {', '.join(map(str, dict.fromkeys(config.beams)))} only "
        f"{', '.join(map(str, dict.fromkeys(fitting)))} are drawn, which divide them"
    )


@contextmanager
def _ring_remedy() -> Iterator[None]:
    """Name the settings that need no rings in an error about them."""
    try:
        yield
    except ValueError as error:
        raise ValueError(
            f"{error}; or, if there is true depth, set {_SETTINGS}.truth depth and "
            f"{_SETTINGS}.beams '[64]', which need no rings"
        ) from error


def _max_crop_size(sample: CameraLidarSample) -> tuple[int, int]:
    """Height and width of the largest crop that suits all our networks."""
    height, width = (
        min(size, limit) // _SIZE_STEP * _SIZE_STEP
        for size, limit in zip(sample.image_size, CROP_SIZE, strict=True)
    )
    if not height or not width:
        raise ValueError(
            f"sample {sample.sample_id} is {sample.image_size[0]}x{sample.image_size[1]} (height x "
            f"width), expected {_SIZE_STEP}x{_SIZE_STEP} or more; leave it out"
        )
    return height, width


def _bottom_centre(sample: CameraLidarSample, size: tuple[int, int]) -> CameraLidarSample:
    height, width = size
    top, left = sample.image_size[0] - height, (sample.image_size[1] - width) // 2
    return crop(sample, top=top, left=left, height=height, width=width)


def _perturbed(
    sample: CameraLidarSample, config: AugmentationConfig, rng: np.random.Generator
) -> CameraLidarSample:
    """Add sensor faults to the sample; the truth stays unchanged."""
    if config.yaw_error_deg:
        sample = draw_turned_lidar(config.yaw_error_deg, rng)(sample, rng)
    if config.outliers:
        sample = FalseEchoes(share=float(rng.uniform(0, config.outliers)))(sample, rng)
    if config.color_jitter is not None and sample.image is not None:
        sample = jitter_color(sample, rng, config.color_jitter)
    if config.camera is not None:
        sample = change_camera(sample, rng, config.camera)
    if rng.random() < config.camera_dropout:
        sample = NoCamera()(sample, rng)
    if config.lidar_occlusion and rng.random() < config.lidar_occlusion:
        sample = LidarOcclusion()(sample, rng)
    if config.lidar_sector and rng.random() < config.lidar_sector:
        sample = LidarSector(width_deg=float(rng.uniform(*_SECTOR_DEG)))(sample, rng)
    if config.lidar_dropout and rng.random() < config.lidar_dropout:
        sample = LidarBlank()(sample, rng)
    return sample


def _padded(
    planes: Float32[Tensor, "channels height width"], size: tuple[int, int], name: str
) -> Float32[Tensor, "channels padded_height padded_width"]:
    """Pad to a size at the top and right, as predictors do: no measurements, no truth."""
    missing = [max(least - given, 0) for least, given in zip(size, planes.shape[1:], strict=True)]
    if not any(missing):
        return planes
    margins = ((0, 0), (missing[0], 0), (0, missing[1]))
    mode: Literal["edge", "constant"] = "edge" if name in _EDGE_PADDED else "constant"
    return torch.from_numpy(np.pad(planes.numpy(), margins, mode=mode))


def _window(
    size: tuple[int, int], config: ExampleConfig, rng: np.random.Generator, *, training: bool
) -> tuple[int, int, int, int]:
    """Top, left, height and width of the crop."""
    if config.crop_size is None:
        return 0, 0, *size
    height, width = config.crop_size
    if height > size[0] or width > size[1]:
        raise ValueError(
            f"crop_size is {height}x{width} (height x width), larger than the sample's "
            f"{size[0]}x{size[1]} (whole blocks of the network); set a smaller "
            f"{_SETTINGS}.crop_size"
        )
    if training and config.augmentation.random_crop:
        return (
            int(rng.integers(size[0] - height + 1)),
            int(rng.integers(size[1] - width + 1)),
            height,
            width,
        )
    return size[0] - height, (size[1] - width) // 2, height, width
