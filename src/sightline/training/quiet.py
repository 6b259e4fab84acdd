"""Suppression of routine messages of Lightning and TensorBoard; their real warnings stay."""

import logging
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from sightline.files.problem import kind_of_message

LIGHTNING_NOISE = (
    "The '.*_dataloader' does not have many workers",
    "The number of training batches .* is smaller than the logging interval",
    "Checkpoint directory .* exists and is not empty",
    "The dirpath has changed from",
    r"Found \d+ module\(s\) in eval mode at the start",  # those that are frozen
    "Precision .* is not supported by the model summary",
    "You're using the WeightAveraging callback, but loading a checkpoint outside",
    "`isinstance.treespec, LeafSpec.` is deprecated",
    "It is recommended to use `self.log.*sync_dist=True.` when logging",
    r"\s*By default only one JsonargparseDeprecationWarning",
    r"\s*``instantiate_classes`` was deprecated",
)
"""Beginnings of Lightning's warnings that users of a recipe cannot act on or can ignore."""


@contextmanager
def warning_once(seen: set[tuple[str, str]], subject: str) -> Iterator[None]:
    """Emit each kind of warning within blocks of one subject once, at the block's end.

    Args:
        seen: Subjects and kinds of the warnings so far; extended.
        subject: Subject of the block's warnings, such as a folder.
    """
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            yield
    finally:
        for each in caught:
            entry = subject, kind_of_message(str(each.message))
            if entry not in seen:
                seen.add(entry)
                warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)


@contextmanager
def quiet_lightning() -> Iterator[None]:
    """Silence routine messages within the block."""
    loggers = [logging.getLogger(f"lightning.{part}") for part in ("pytorch", "fabric")]
    levels = [logger.level for logger in loggers]
    previous_hook = threading.excepthook
    threading.excepthook = partial(_ignore_disk_errors, previous_hook)
    for logger in loggers:
        logger.setLevel(logging.WARNING)
    try:
        with warnings.catch_warnings():
            for beginning in LIGHTNING_NOISE:
                warnings.filterwarnings("ignore", beginning)
            yield
    finally:
        threading.excepthook = previous_hook
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _ignore_disk_errors(
    hook: Callable[[threading.ExceptHookArgs], object], failure: threading.ExceptHookArgs
) -> None:
    """Hide write errors of TensorBoard's thread, which are raised in the main thread too."""
    if not issubclass(failure.exc_type, OSError):
        hook(failure)
