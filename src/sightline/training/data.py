"""Batches for training, validation and test from any mixture of data sets.

Random numbers depend only on the seed, the epoch and the sample, not on the number of worker
processes or on interruptions.
"""

import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

import lightning
import numpy as np
from lightning.pytorch.utilities import rank_zero_only
from torch.utils.data import DataLoader, Dataset

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part
from sightline.files.problem import error_text
from sightline.files.settings import NetworkConfig
from sightline.geometry.arguments import check_collection
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.batch import Batch, FieldwiseBatch, concatenate
from sightline.structures.sample import CameraLidarSample
from sightline.training.arguments import check_data_number
from sightline.training.loader import BatchLoader, FailedBatch, ResumableLoader
from sightline.training.module import TrainingModule
from sightline.training.own_code import naming_samples
from sightline.training.quiet import warning_once
from sightline.training.sampling import (
    EpochPosition,
    SampleKey,
    ScoringBatches,
    TrainingBatches,
    limit_batches,
    scoring_limit,
)
from sightline.training.sources import (
    LearnedBox,
    SourceConfig,
    data_tree,
    labelled_classes,
    open_source,
    unscored_note,
)
from sightline.training.trained_frames import (
    FramesByTree,
    frames_in,
    frames_of_checkpoint,
    frames_state,
    training_change,
    validation_change,
    validation_state,
)

_UPDATE_STREAM = 1  # distinguishes a batch's seed from the seed of its first sample
_TRAINING_STREAM = 2  # marks the seed of data shared by the whole training


class SamplePreparation(ABC):
    """Preparation of samples for a task's network; runs in the worker processes."""

    parts: Collection[Part] = frozenset({"image", "points"})
    """Parts of the samples to load."""
    learned_box: LearnedBox | None = None
    """Kind of the labelled boxes that the network learns; None: it learns no boxes."""
    learned_occlusion: int | None = None
    """Largest occlusion of the labelled objects that the network learns; None: any."""

    def learned_classes(self) -> tuple[str, ...]:
        """Name the labelled classes that the network learns; by default none."""
        return ()

    @abstractmethod
    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> FieldwiseBatch:
        """Prepare one sample as a batch of one.

        Args:
            sample: Sample as read.
            rng: Generator of all random numbers: different in each epoch of a training, always the
                same outside of training.
            training: Whether to augment.
        """

    def for_network(self, config: NetworkConfig) -> "SamplePreparation":
        """Create the preparation for a network, with the settings that only the network has.

        Called before each training, validation and test; a second call must change nothing.

        Args:
            config: Settings of the network.

        Returns:
            By default itself: nothing depends on the network.

        Raises:
            ValueError: The preparation's own settings contradict the network's.
        """
        del config
        return self

    def for_training(
        self, datasets: Sequence[SampleDataset], rng: np.random.Generator
    ) -> "SamplePreparation":
        """Create the preparation of a training, with data shared by all samples.

        Called in each process before each start of a training, also a resumed one: the shared data
        must depend only on the data sets and the generator.

        Args:
            datasets: All training data sets.
            rng: Generator of the training; the same at each start.

        Returns:
            By default itself: nothing is shared.
        """
        del datasets, rng
        return self

    def for_update(self, rng: np.random.Generator) -> "SamplePreparation":
        """Create the preparation of one training batch, with random draws shared by its samples.

        Args:
            rng: Generator of the batch.

        Returns:
            By default itself: each sample has its own draws.
        """
        del rng
        return self

    def collate(self, prepared: Sequence[Any]) -> Batch:
        """Join several batches into one, by default with `concatenate`."""
        batch: FieldwiseBatch = concatenate(prepared)
        return batch


def check_agrees(name: str, given: object, expected: object) -> None:
    """Refuse a setting of the preparation that is not None and differs from the network's.

    Raises:
        ValueError: The setting differs.
    """
    if given not in (None, expected):
        raise ValueError(
            f"the preparation's settings.{name} is {given}, expected the network's {expected}; "
            "leave out the preparation's setting"
        )


class PreparedSamples(Dataset[FieldwiseBatch]):
    """Concatenated and prepared sources; an index is a pair of epoch and position."""

    @named_arguments
    def __init__(
        self,
        datasets: Sequence[tuple[SampleDataset, int]],
        preparation: SamplePreparation,
        *,
        seed: int,
        training: bool,
    ) -> None:
        """Store open data sets, each with its number of repeats."""
        self._datasets = tuple(dataset for dataset, _ in datasets)
        self.num_frames = tuple(len(dataset) for dataset, _ in datasets)
        self._ends = np.cumsum(
            np.array(self.num_frames) * np.array([repeat for _, repeat in datasets])
        )
        self._preparation = preparation
        self._seed = seed
        self._training = training

    def __len__(self) -> int:
        """Number of samples, including repeats."""
        return int(self._ends[-1])

    def __getitem__(self, key: SampleKey) -> FieldwiseBatch:
        """Read and prepare a sample."""
        return self._prepare(key, self._preparation)

    def _prepare(self, key: SampleKey, preparation: SamplePreparation) -> FieldwiseBatch:
        epoch, index = key
        dataset, place = self._place(index)
        with naming_samples(lambda: (dataset.sample_ids[place],)):
            rng = np.random.default_rng((self._seed, epoch, index))
            return preparation.prepare(dataset[place], rng, training=self._training)

    def _place(self, index: int) -> tuple[SampleDataset, int]:
        """Find the data set of a sample, and its index there."""
        source = int(np.searchsorted(self._ends, index, side="right"))
        start = int(self._ends[source - 1]) if source else 0
        return self._datasets[source], (index - start) % self.num_frames[source]

    def _names(self, keys: Sequence[SampleKey]) -> list[str]:
        """List the names of samples."""
        places = [self._place(index) for _, index in keys]
        return [dataset.sample_ids[place] for dataset, place in places]

    def __getitems__(self, keys: Sequence[SampleKey]) -> "Batch | FailedBatch | None":
        """Read and prepare a batch; None if it has no samples. PyTorch's loader calls this."""
        if not keys:
            return None
        preparation = self._preparation
        try:
            if self._training:
                epoch, first = keys[0]
                rng = np.random.default_rng((self._seed, epoch, first, _UPDATE_STREAM))
                with naming_samples(lambda: self._names(keys)):
                    preparation = preparation.for_update(rng)
            prepared = [self._prepare(key, preparation) for key in keys]
            with naming_samples(lambda: self._names(keys)):
                return preparation.collate(prepared)
        except (ValueError, OSError) as error:  # a worker would print a traceback
            return FailedBatch(error_text(error))


class CameraLidarData(lightning.LightningDataModule):
    """Batches of camera-LiDAR data for any task.

    On several devices the batches of a step form one larger batch: two devices with batches of 4
    train on the same samples per step as one with batches of 8. Scoring uses every sample once.
    """

    def __init__(
        self,
        preparation: SamplePreparation,
        *,
        root: Path = Path(),
        training: tuple[SourceConfig, ...] = (),
        validation: tuple[SourceConfig, ...] = (),
        test: tuple[SourceConfig, ...] = (),
        batch_size: int = 8,
        validation_batch_size: int = 1,
        workers: int = 2,
        seed: int = 0,
        samples_per_epoch: int | None = None,
    ) -> None:
        """Store the settings; folders are opened when they are needed.

        Args:
            preparation: The task's preparation of samples.
            root: Base folder of the sources' relative paths.
            training: Training sources. On the command line, as in a second configuration, they
                replace all sources of the recipe: missing fields of an entry have their defaults,
                not the recipe's values.
            validation: Validation sources.
            test: Test sources.
            batch_size: Samples per training batch on one device.
            validation_batch_size: Samples per batch in validation and test; more than 1 only if the
                images have one size.
            workers: Processes per device that read and prepare samples; 0: the main process does.
            seed: Seed of the order and of all random draws for samples.
            samples_per_epoch: Number of training samples per epoch, different ones in each epoch.
                None: all.

        Raises:
            ValueError: A number is out of range.
        """
        super().__init__()
        for name, value in (
            ("batch_size", batch_size),
            ("validation_batch_size", validation_batch_size),
            ("samples_per_epoch", samples_per_epoch),
            ("workers", workers),
            ("seed", seed),
        ):
            check_data_number(name, value)
        self.preparation = preparation
        self.root = root
        self.sources = {"training": training, "validation": validation, "test": test}
        self.batch_size = batch_size
        self.validation_batch_size = validation_batch_size
        self.workers = workers
        self.seed = seed
        self.samples_per_epoch = samples_per_epoch
        self._training: tuple[PreparedSamples, TrainingBatches] | None = None
        self._training_frames: FramesByTree = {}
        self._checkpoint_frames: FramesByTree = {}  # those of a scored checkpoint
        self._validated: dict[str, Any] = {}  # state of the validation frames in checkpoints
        self.unscored: str | None = None
        """Note on validation or test frames that the Trainer's limit leaves out."""
        self._printed: set[str] = set()
        self._warned: set[tuple[str, str]] = set()

    def setup(self, stage: str) -> None:
        """Hand the network's settings to the preparation; train without validation samples.

        Raises:
            ValueError: There are no training samples (raised before a first validation), or the
                preparation's own settings contradict the network's.
        """
        module = getattr(self.trainer, "lightning_module", None)
        if isinstance(module, TrainingModule):
            self.preparation = self.preparation.for_network(module.network_config())
        if stage == "fit" and self.trainer is not None:
            if not self.sources["validation"]:
                self.trainer.limit_val_batches = 0
            self._training = self._training_samples()

    def train_dataloader(self) -> ResumableLoader:
        """Shuffled batches, reordered in each epoch; an incomplete last batch is left out."""
        samples, batches = self._training or self._training_samples()
        self._training = None  # another loader has its own position
        position = EpochPosition(self.trainer, len(batches))
        return ResumableLoader(samples, batches, position, workers=self.workers, seed=self.seed)

    def val_dataloader(self) -> DataLoader[Any]:
        """All validation samples in order."""
        return self._scoring_loader("validation")

    def test_dataloader(self) -> DataLoader[Any]:
        """All test samples in order."""
        return self._scoring_loader("test")

    def state_dict(self) -> dict[str, Any]:
        """Numbers and digests of the training and validation frames, for checkpoints."""
        return frames_state(self._training_frames) | self._validated

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Compare the frames with a checkpoint's; resuming with others prints a warning.

        Validation frames are compared once they are opened. Where the checkpoint is only scored,
        keep its training frames: they must not be among the scored ones.
        """
        if not self._training_frames:
            self._checkpoint_frames = self._frames_of_checkpoint(state_dict)
            return
        self._print_once(training_change(state_dict, self.state_dict()))
        self._validated = {name: state_dict[name] for name in state_dict if "validation" in name}

    def _frames_of_checkpoint(self, state: dict[str, Any]) -> FramesByTree:
        """List the training frames of a checkpoint by folder, of sources that can be opened.

        Empty if they cannot be those of the checkpoint, which is printed: other settings, or other
        data below another root.
        """
        frames, is_possible = frames_of_checkpoint(
            state,
            self.sources["training"],
            self.root,
            self.preparation.parts,
            lambda tree: bool(self._held_out_uses(tree)),
        )
        if is_possible:
            return frames
        num_listed = frames_state(frames)["num_training_frames"]
        self._print_once(
            f"the checkpoint's {state['num_training_frames']:,} training frames are not the "
            f"{num_listed:,} of these settings, so those among the scored ones are not counted; "
            "give the config.yaml and the data of its run"
        )
        return {}

    def _training_samples(self) -> tuple[PreparedSamples, TrainingBatches]:
        samples = self._open("training", training=True)
        return samples, self._training_batches(len(samples), *self._rank_and_world())

    def _training_batches(self, num_samples: int, rank: int, world: int) -> TrainingBatches:
        return TrainingBatches(
            num_samples,
            self.batch_size,
            seed=self.seed,
            samples_per_epoch=self.samples_per_epoch,
            rank=rank,
            world=world,
        )

    def _scoring_loader(self, name: str) -> DataLoader[Any]:
        samples = self._open(name, training=False)
        rank, world = self._rank_and_world()
        batches = ScoringBatches(len(samples), self.validation_batch_size, rank=rank, world=world)
        num_batches = limit_batches(scoring_limit(self.trainer, name), len(batches))
        num_scored = num_batches * self.validation_batch_size * world
        self.unscored = unscored_note(name, self.sources[name], samples.num_frames, num_scored)
        self._print_once(self.unscored)
        return BatchLoader(samples, batches, workers=self.workers, seed=self.seed)

    def check_training_sources(self, *, world: int) -> None:
        """Check the training sources without reading samples, for errors before a long scoring.

        Args:
            world: Number of devices.

        Raises:
            ValueError: A source cannot be opened, or there are too few samples for a batch on each
                device.
        """
        opened = self._open_sources("training")
        num_samples = sum(len(dataset) * source.repeat for dataset, source in opened)
        self._training_batches(num_samples, 0, world)

    def _open_sources(self, name: str) -> list[tuple[SampleDataset, SourceConfig]]:
        """Open the sources of training, validation or test samples.

        Raises:
            ValueError: There are none, or one cannot be opened.
        """
        sources = self.sources[name]
        if not sources:
            raise ValueError(f"there are no sources of {name} samples; set --data.init_args.{name}")
        check_collection(f"{type(self.preparation).__name__}.parts", self.preparation.parts)
        datasets = []
        for source in sources:
            tree = data_tree(source, self.root)
            try:
                with warning_once(self._warned, str(tree)):  # a folder is opened for each use
                    dataset = self._open_source(source, notify=self._print_once)
            except ValueError as error:
                flags = f"--data.init_args.root and --data.init_args.{name}"
                raise ValueError(f"{error} (the {name} samples: {flags})") from error
            datasets.append((dataset, source))
        return datasets

    def _open_source(self, source: SourceConfig, notify: Callable[[str], None]) -> SampleDataset:
        return open_source(
            source,
            self.root,
            self.preparation.parts,
            held_out_for=self._held_out_uses(data_tree(source, self.root)),
            notify=notify,
        )

    def _open(self, name: str, *, training: bool) -> PreparedSamples:
        opened = self._open_sources(name)
        for dataset, source in opened:
            tree = data_tree(source, self.root)
            if training:
                self._training_frames.setdefault(tree, set()).update(dataset.sample_ids)
            else:
                self._print_num_trained(name, dataset.sample_ids, tree)
        if name == "validation" and self._training_frames:
            now = validation_state([dataset for dataset, _ in opened])
            self._print_once(validation_change(self._validated, now))
            self._validated = now
        datasets = [(dataset, source.repeat if training else 1) for dataset, source in opened]
        preparation = self.preparation
        self._print_labelled_classes(name, [dataset for dataset, _ in datasets])
        if training:
            rng = np.random.default_rng((self.seed, 0, 0, _TRAINING_STREAM))
            preparation = preparation.for_training([dataset for dataset, _ in datasets], rng)
        return PreparedSamples(datasets, preparation, seed=self.seed, training=training)

    def _held_out_uses(self, tree: Path) -> list[str]:
        """Use (validation, test) with the list `val` of a folder."""
        return [
            use
            for use in ("validation", "test")
            if any(
                source.sample_list == "val" and data_tree(source, self.root) == tree
                for source in self.sources[use]
            )
        ]

    def _print_labelled_classes(self, name: str, datasets: Sequence[SampleDataset]) -> None:
        """Print the classes that no frame shows, and in training what is learned as background."""
        learned = self.preparation.learned_classes()
        check_collection(f"{type(self.preparation).__name__}.learned_classes()", learned)
        box = self.preparation.learned_box
        if not learned:
            return
        limit, is_training = self.preparation.learned_occlusion, name == "training"
        labelled = labelled_classes(
            datasets, learned, box, max_occlusion=limit, count_all=is_training
        )
        for line in (
            labelled.training_warnings(learned, box)
            if is_training
            else labelled.scoring_warnings(name, learned, box)
        ):
            self._print_once(line)

    def _print_num_trained(self, name: str, sample_ids: Sequence[str], tree: Path) -> None:
        """Print the number of scored frames that are training frames, if any."""
        training_frames = frames_in(self._training_frames or self._checkpoint_frames, tree)
        shared = [each for each in sample_ids if each in training_frames]
        if not shared:
            return
        by_name = unless = ""
        if not self._training_frames:  # no checkpoint records the folders
            by_name = "; the checkpoint's frames are compared by name"
            unless = " unless the run was trained on another folder"
        self._print_once(
            f"{len(shared)} of {len(sample_ids)} {name} frames of {tree} are also training frames "
            f"({shared[0]} first{by_name}), so scores are too good{unless}; remove them from one "
            "of the lists"
        )

    def _print_once(self, line: str | None) -> None:
        """Print a line, if there is one, once for any number of sources."""
        if line is not None and line not in self._printed:
            self._printed.add(line)
            rank_zero_only(print)(line, file=sys.stderr)

    def _rank_and_world(self) -> tuple[int, int]:
        if self.trainer is None:
            return 0, 1
        return self.trainer.global_rank, self.trainer.world_size
