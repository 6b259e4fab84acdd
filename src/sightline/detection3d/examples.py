"""Preparation of samples for training and scoring, with their augmentation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from sightline.augmentation.sample_changes import mirror, thin_rings
from sightline.augmentation.scene_changes import scale_scene, turn_scene
from sightline.augmentation.sweep_changes import (
    GroundShapeConfig,
    add_range_noise,
    bend_ground,
    draw_ground_shape,
    stretch_objects,
)
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.formats.kitti_conversion import kitti_from_labels
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.detection3d.checks import check_numbers
from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.object_sampling import (
    ObjectBank,
    ObjectSamplingConfig,
    fill_bank,
    paste_objects,
)
from sightline.detection3d.proposal_cache import FirstStageRecord, read_record
from sightline.detection3d.sweeps import (
    SweepConfig,
    SweepTruth,
    SweepTruthConfig,
    cut_to_view,
    draw_points,
    make_truth,
    points_in_range,
    to_kitti_frame,
)
from sightline.files.settings import NetworkConfig
from sightline.geometry.calibration import Calibration
from sightline.structures.batch import FieldwiseBatch
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample, check_points
from sightline.training.data import SamplePreparation, check_agrees

_BEAMS = (64, 32, 16, 8)
_LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoringTruth:
    """Ground truth for scoring a frame."""

    objects: KittiObjects
    """Objects in the camera frame."""
    calibration: Calibration
    """Calibration for a LiDAR frame at KITTI's height, the frame of the detections."""
    image_size: tuple[int, int]
    """Height, width [px]."""


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
    frames: tuple[ScoringTruth, ...] | None = None
    """Ground truth for scoring."""


@dataclass(frozen=True, kw_only=True)
class SceneChangeConfig:
    """Strengths of the scene augmentations; defaults from Shi et al. 2019 (PointRCNN)."""

    mirror: bool = True
    """Whether every second scene is mirrored."""
    turn_deg: float = 10.0
    """Largest rotation about the sensor, to either side."""
    scales: tuple[float, float] = (0.95, 1.05)
    """Smallest and largest factor on all lengths."""
    ground: GroundShapeConfig | None = None
    """Bending of the ground: roads are not flat, and cars pitch. None: no bending."""
    stretch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Standard deviations of the logarithms of factors on each object's length, width, height."""
    range_noise_m: float = 0.0
    """Standard deviation of the noise on each point's range."""
    beams: tuple[int, ...] = (64,)
    """Choices, equally likely, of how many of KITTI's 64 beams a sweep keeps."""
    objects: ObjectSamplingConfig | None = None
    """Objects of other sweeps to paste into sweeps that keep all beams. None: none."""
    bank_frames: int = 1000
    """Largest number of training frames, drawn by the seed, whose objects are kept for pasting."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        low, high = self.scales
        if not 0 < low <= high < math.inf:
            raise ValueError(f"changes.scales must be positive and in order, got {self.scales}")
        numbers = ("turn_deg", "range_noise_m", "stretch")
        check_numbers(self, "finite and not negative", *numbers, within="changes.")
        if not self.beams or any(count not in _BEAMS for count in self.beams):
            raise ValueError(f"changes.beams must hold some of {_BEAMS}, got {self.beams}")
        check_numbers(self, "at least 1", "bank_frames", within="changes.")


def thin_beams(
    sample: CameraLidarSample, config: SceneChangeConfig, rng: np.random.Generator
) -> tuple[CameraLidarSample, bool]:
    """Draw how many beams a sweep keeps, in the LiDAR's own frame: elsewhere rings are tilted.

    Returns:
        The sample, and whether it keeps all beams.

    Raises:
        ValueError: The rings are unknown, or `check_points` refuses the points.
    """
    check_points(sample)
    keep_every = _BEAMS[0] // int(rng.choice(np.array(config.beams)))
    if keep_every == 1:
        return sample, True
    try:
        return thin_rings(sample, keep_every, int(rng.integers(keep_every))), False
    except ValueError as error:
        raise ValueError(
            f"{error}; or train without fewer beams, which need no rings "
            "(--data.init_args.preparation.init_args.settings.changes.beams '[64]')"
        ) from error


def change_scene(
    sample: CameraLidarSample,
    config: SceneChangeConfig,
    rng: np.random.Generator,
    bank: ObjectBank | None = None,
) -> CameraLidarSample:
    """Augment a sample as if another street or mount had given it; see `thin_beams` for sensors.

    Objects of the bank, if any, are pasted first, while the calibration still matches the camera's
    view. The sample has a sweep and labels.
    """
    if config.objects is not None and bank is not None:
        sample = paste_objects(sample, bank, rng, config.objects)
    if any(config.stretch) and sample.objects is not None:
        logs = rng.normal(size=(len(sample.objects), 3)) * np.array(config.stretch)
        sample = stretch_objects(sample, torch.from_numpy(np.exp(logs)))
    if config.mirror and rng.random() < 0.5:
        sample = mirror(sample)
    sample = turn_scene(sample, rng.uniform(-config.turn_deg, config.turn_deg))
    sample = scale_scene(sample, rng.uniform(*config.scales))
    if config.ground is not None:
        sample = bend_ground(sample, draw_ground_shape(config.ground, rng))
    return add_range_noise(sample, config.range_noise_m, rng) if config.range_noise_m else sample


@dataclass(frozen=True, kw_only=True)
class Detection3DExampleConfig:
    """Settings of examples for training and scoring, and of the training augmentations."""

    input: SweepConfig | None = None
    """Part of a sweep that the network gets. None: as in the network's settings."""
    class_names: tuple[str, ...] | None = None
    """Classes to detect. None: the network's."""
    changes: SceneChangeConfig | None = field(default_factory=SceneChangeConfig)
    """Augmentations in training. None: none."""
    targets: SweepTruthConfig = field(default_factory=SweepTruthConfig)
    """Ground-truth objects that training uses as targets."""


class Detection3DExamples(SamplePreparation):
    """Examples for training and scoring detection, each a batch of one."""

    parts = frozenset({"points", "objects"})
    learned_box = "3D"

    def __init__(
        self, settings: Detection3DExampleConfig | None = None, cache: Path | None = None
    ) -> None:
        """Take the settings.

        Args:
            settings: Contents of the examples. None: the defaults.
            cache: Folder written by `sightline proposals` for the data, with the first stage that
                the training freezes. Scenes are not changed then. None: the first stage runs.

        Raises:
            ValueError: There is a cache, and the settings change scenes.
        """
        self.settings = settings or Detection3DExampleConfig()
        self.cache = cache
        self._bank: ObjectBank | None = None
        if cache is not None and self.settings.changes is not None:
            raise ValueError(
                "a first stage's cache holds scenes as they were taken: set settings.changes to "
                "null, or leave the cache out"
            )

    @property
    def class_names(self) -> tuple[str, ...]:
        """Classes to detect: by default those of the default network."""
        return self.settings.class_names or _names(Detection3DConfig())

    def learned_classes(self) -> tuple[str, ...]:
        """Name the classes to detect."""
        return self.class_names

    def for_network(self, config: NetworkConfig) -> "Detection3DExamples":
        """Take the input and the classes of the network."""
        assert isinstance(config, Detection3DConfig), "it is the network of this task"
        settings, names = self.settings, _names(config)
        check_agrees("input", settings.input, config.input)
        check_agrees("class_names", settings.class_names, names)
        return Detection3DExamples(
            replace(settings, input=config.input, class_names=names), self.cache
        )

    def for_training(
        self, datasets: Sequence[SampleDataset], rng: np.random.Generator
    ) -> "Detection3DExamples":
        """Collect objects to paste into other sweeps, if the settings require pasting."""
        changes = self.settings.changes
        if changes is None or changes.objects is None:
            return self
        filled = Detection3DExamples(self.settings, self.cache)
        filled._bank = fill_bank(datasets, changes.bank_frames, rng, changes.objects)
        return filled

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> Detection3DBatch:
        """Prepare a batch of one: a sweep, augmented in training, with its ground truth.

        As at inference, the LiDAR frame is converted to KITTI's height and axes.

        Raises:
            ValueError: The sample has no labels, no sweep or points that are not finite, or the
                cache is of other data.
        """
        if sample.objects is None:
            raise ValueError(
                f"sample {sample.sample_id} has no labels to train on or to score against; give "
                "data with label_2"
            )
        settings = self.settings
        seen = settings.input or SweepConfig()
        record = None
        if self.cache is not None:
            points, record, sample = read_record(self.cache, sample, training=training)
        changes = settings.changes if training and record is None else None
        has_all_beams = True
        if changes is not None and sample.points is not None:
            sample, has_all_beams = thin_beams(sample, changes, rng)
        level = level_sample(sample)
        raised = to_kitti_frame(level)
        assert level.objects is not None, "checked above"
        assert raised.objects is not None, "checked above"
        frame = None
        if not training:
            frame = ScoringTruth(
                objects=kitti_from_labels(level.objects, level.calibration),
                calibration=raised.calibration,
                image_size=sample.image_size,
            )
        objects = raised.objects
        if record is None:
            visible = cut_to_view(replace(raised, image=None, depth=None), seen)
            if changes is not None:
                bank = self._bank if has_all_beams else None
                visible = change_scene(visible, changes, rng, bank)
            assert visible.points is not None, "checked when it was cut"
            assert visible.objects is not None, "checked above"
            within = points_in_range(visible.points, seen)
            points, objects = draw_points(within, seen, rng), visible.objects
        return Detection3DBatch(
            sample_ids=(sample.sample_id,),
            points=(points,),
            truths=(make_truth(objects, points, self.class_names, seen, settings.targets),),
            seeds=(int(rng.integers(_LARGEST_SEED)),),
            records=None if record is None else (record,),
            frames=None if frame is None else (frame,),
        )


def _names(config: Detection3DConfig) -> tuple[str, ...]:
    return tuple(each.name for each in config.classes)


DetectionExamples = Detection3DExamples
"""Name in recipes and run folders of earlier versions."""
