"""Preparation of samples for training and scoring the 3D detectors."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sightline.data.object_labels import kitti_from_labels
from sightline.data.open import SampleDataset
from sightline.detection3d.augmentation import SceneChangeConfig, change_scene
from sightline.detection3d.batch import Detection3DBatch, FrameTruth
from sightline.detection3d.detector_config import SweepConfig
from sightline.detection3d.object_sampling import ObjectBank, fill_bank
from sightline.detection3d.proposal_cache import read_record
from sightline.detection3d.sweeps import (
    at_kitti_height,
    cut_to_view,
    draw_points,
    points_in_range,
)
from sightline.detection3d.targets import TargetConfig, make_truth
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample
from sightline.training.data import SamplePreparation

_LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True, kw_only=True)
class ExampleConfig:
    """Settings of examples for training and scoring, and of the training augmentations."""

    input: SweepConfig = field(default_factory=SweepConfig)
    """Part of a sweep that the network gets: as in its own settings."""
    class_names: tuple[str, ...] = ("Car",)
    """Classes to detect, in the order of the network's own settings."""
    changes: SceneChangeConfig | None = field(default_factory=SceneChangeConfig)
    """Augmentations in training. None: none."""
    targets: TargetConfig = field(default_factory=TargetConfig)
    """Ground-truth objects that training uses as targets."""


class DetectionExamples(SamplePreparation):
    """Examples for training and scoring detection, each a batch of one."""

    parts = frozenset({"points", "objects"})

    def __init__(self, settings: ExampleConfig | None = None, cache: Path | None = None) -> None:
        """Take the settings.

        Args:
            settings: Contents of the examples. None: the defaults.
            cache: Folder written by `sightline proposals` for the data, with the first stage that
                the training freezes. Scenes are not changed then. None: the first stage runs.

        Raises:
            ValueError: There is a cache, and the settings change scenes.
        """
        self.settings = settings or ExampleConfig()
        self.cache = cache
        self._bank: ObjectBank | None = None
        if cache is not None and self.settings.changes is not None:
            raise ValueError(
                "a first stage's cache holds scenes as they were taken: set settings.changes to "
                "null, or leave the cache out"
            )

    def for_training(
        self, datasets: Sequence[SampleDataset], rng: np.random.Generator
    ) -> "DetectionExamples":
        """Collect objects to paste into other sweeps, if the settings ask for pasting."""
        changes = self.settings.changes
        if changes is None or changes.objects is None:
            return self
        filled = DetectionExamples(self.settings, self.cache)
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
        level = level_sample(sample)
        raised = at_kitti_height(level)
        assert level.objects is not None, "checked above"
        assert raised.objects is not None, "checked above"
        frame = None
        if not training:
            frame = FrameTruth(
                objects=kitti_from_labels(level.objects, level.calibration),
                calibration=raised.calibration,
                image_size=sample.image_size,
            )
        record = None
        if self.cache is not None:
            points, record = read_record(self.cache, sample, training=training)
            objects = raised.objects
        else:
            shown = cut_to_view(replace(raised, image=None, depth=None), settings.input)
            if training and settings.changes is not None:
                shown = change_scene(shown, settings.changes, rng, self._bank)
            assert shown.points is not None, "checked when it was cut"
            assert shown.objects is not None, "checked above"
            seen = points_in_range(shown.points, settings.input)
            points, objects = draw_points(seen, settings.input, rng), shown.objects
        return Detection3DBatch(
            sample_ids=(sample.sample_id,),
            points=(points,),
            truths=(
                make_truth(objects, points, settings.class_names, settings.input, settings.targets),
            ),
            seeds=(int(rng.integers(_LARGEST_SEED)),),
            records=None if record is None else (record,),
            frames=None if frame is None else (frame,),
        )
