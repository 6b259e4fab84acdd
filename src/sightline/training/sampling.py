"""Distribution of samples over batches, devices and epochs."""

import math
from collections.abc import Iterator

import lightning
import numpy as np
from torch.utils.data import Sampler

SampleKey = tuple[int, int]
"""Epoch and index of a sample."""


def limit_batches(limit: int | float | None, num_batches: int) -> int:  # noqa: PYI041 - they differ
    """Compute the number of batches that a Trainer takes: a whole limit is a number, 0.5 half."""
    if limit is None:
        return num_batches
    return min(limit, num_batches) if isinstance(limit, int) else int(limit * num_batches)


def scoring_limit(trainer: "lightning.Trainer | None", name: str) -> int | float | None:
    """Return a Trainer's limit of validation or test batches; None: none, or a trial run's own."""
    if trainer is None or trainer.fast_dev_run or trainer.overfit_batches:  # type: ignore[attr-defined]
        return None
    return trainer.limit_test_batches if name == "test" else trainer.limit_val_batches


class TrainingBatches(Sampler[list[SampleKey]]):
    """Shuffled batches of one epoch, from a given batch on.

    The order depends on seed and epoch. Of `world * batch_size` consecutive samples, each rank
    takes every `world`-th: together they form the batch of a single device.
    """

    def __init__(
        self,
        num_samples: int,
        batch_size: int,
        *,
        seed: int,
        samples_per_epoch: int | None = None,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        """Check that there is a batch for every rank.

        Raises:
            ValueError: There are too few samples.
        """
        epoch_size = num_samples if samples_per_epoch is None else samples_per_epoch
        if epoch_size > num_samples:
            raise ValueError(
                f"samples_per_epoch is {epoch_size}, but there are only {num_samples} training "
                "samples; lower it or raise the repeat of the sources"
            )
        self._num_batches = epoch_size // (batch_size * world)
        if self._num_batches == 0:
            devices = f" on each of {world} devices" if world > 1 else ""
            raise ValueError(
                f"an epoch of {epoch_size} samples does not fill a batch of {batch_size}{devices}; "
                "set a smaller --data.init_args.batch_size or raise the repeat of the sources"
            )
        self._num_samples = num_samples
        self._batch_size = batch_size
        self._seed = seed
        self._rank = rank
        self._world = world
        self._epoch = 0
        self._first = 0

    def __len__(self) -> int:
        """Number of batches of a whole epoch on one rank."""
        return self._num_batches

    def start_at(self, epoch: int, batch: int) -> None:
        """Set the start of the next iteration."""
        self._epoch, self._first = epoch, batch

    def __iter__(self) -> Iterator[list[SampleKey]]:
        """Yield the rank's remaining batches of the epoch."""
        # No sample has the third number as its index, so its generator differs from this one.
        rng = np.random.default_rng((self._seed, self._epoch, self._num_samples))
        order = rng.permutation(self._num_samples)
        step = self._batch_size * self._world
        for batch in range(self._first, self._num_batches):
            step_samples = order[batch * step : (batch + 1) * step]
            yield [(self._epoch, int(index)) for index in step_samples[self._rank :: self._world]]


class ScoringBatches(Sampler[list[SampleKey]]):
    """All samples in order, distributed over the ranks, each once.

    Every rank has the same number of batches, because the ranks wait for each other: if the samples
    do not divide evenly, a rank's last batch is smaller or empty.
    """

    def __init__(self, num_samples: int, batch_size: int, *, rank: int = 0, world: int = 1) -> None:
        """Distribute the samples."""
        self._rank_samples = range(rank, num_samples, world)
        self._max_rank_samples = math.ceil(num_samples / world)
        self._batch_size = batch_size

    def __len__(self) -> int:
        """Number of batches of one rank."""
        return math.ceil(self._max_rank_samples / self._batch_size)

    def __iter__(self) -> Iterator[list[SampleKey]]:
        """Yield the rank's batches."""
        for start in range(0, self._max_rank_samples, self._batch_size):
            yield [(0, index) for index in self._rank_samples[start : start + self._batch_size]]


class EpochPosition:
    """Position of a Trainer: the next epoch and the next batch in it."""

    def __init__(self, trainer: "lightning.Trainer | None", num_batches: int) -> None:
        """Store the Trainer, if there is one, and the loader's batches per epoch."""
        self._trainer = trainer
        self._num_batches = num_batches

    def __call__(self) -> tuple[int, int]:
        """Epoch and batch, from 0.

        Derived from the checkpoint's count of all trained batches; the meaning of its counts within
        an epoch depends on the time of writing.
        """
        if self._trainer is None:
            return 0, 0
        num_batches = limit_batches(self._trainer.limit_train_batches, self._num_batches)
        num_trained: int = self._trainer.fit_loop.epoch_loop.batch_progress.state_dict()["total"][
            "processed"
        ]
        return divmod(num_trained, max(num_batches, 1))
