"""What a task declares so that the bench can score its answers to corrupted frames."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

    from sightline.corruptions.corruption import Corrupted
    from sightline.data.object_tree import Part
    from sightline.data.open import SampleDataset
    from sightline.structures.sample import CameraLidarSample

Scores = Mapping[str, float | None]
"""By the figures' names; None where there is nothing to score, e.g. no object of a class."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One of the numbers that say how good answers are."""

    name: str
    """In files, e.g. rmse_mm."""
    title: str
    """For people, without its unit."""
    unit: str
    """E.g. % or mm."""
    highest: float | None = None
    """What perfect answers have, where more is better; None: an error, of which 0 is the best."""

    def error(self, score: float) -> float:
        """How far a score is from perfect, in the figure's unit."""
        return score if self.highest is None else self.highest - score

    def lead(self, score: float, other: float) -> float:
        """By how much a score is better than another one, in the figure's unit."""
        return self.error(other) - self.error(score)


class PosedFrame(NamedTuple):
    """A frame as it is put to methods."""

    sample: "CameraLidarSample"
    """Of sound sensors: what is corrupted and then given."""
    truth: Any
    """The task's own, where scores are taken frame by frame; otherwise None."""


class Answered(NamedTuple):
    """An answer to a corrupted frame, with all that it can be held against."""

    posed: PosedFrame
    corrupted: "Corrupted"
    answer: Any
    """The predictor's."""


class Panel(NamedTuple):
    """A picture of a report."""

    caption: str
    picture: "UInt8[np.ndarray, 'height width 3']"


@runtime_checkable  # for beartype, which checks arguments under pytest
class Keeper(Protocol):
    """Puts frames to methods, and keeps of each answer what is needed later, as one file.

    Picklable where workers are started afresh (macOS, Windows).
    """

    @property
    def suffix(self) -> str:
        """Of the files, with its dot."""
        ...

    def pose(self, sample: "CameraLidarSample") -> PosedFrame:
        """The frame as methods may see it.

        Raises:
            ValueError: It cannot be scored.
        """
        ...

    def keep(self, path: Path, answered: Answered) -> None:
        """Writes the file of an answer, whole or not at all."""
        ...


@runtime_checkable
class Scoring(Keeper, Protocol):
    """How good a task's answers are, from the files that were kept of them."""

    @property
    def name(self) -> str:
        """The protocol: results of two of them do not compare."""
        ...

    @property
    def figures(self) -> tuple[Figure, ...]:
        """What is scored, the one that everybody looks at first."""
        ...

    @property
    def parts(self) -> "Collection[Part]":
        """What it needs of a sample, beside what methods are given."""
        ...

    @property
    def takes_results(self) -> bool:
        """Whether the files are a format of answers that any method may write."""
        ...

    def check(self, dataset: "SampleDataset") -> None:
        """Refuses data that hold nothing to score against.

        Raises:
            ValueError: They do not.
        """
        ...

    def notes(self, dataset: "SampleDataset") -> tuple[str, ...]:
        """Sentences to read the scores of such data with, of objects that are too few for one."""
        ...

    def read(self, path: Path, sample: "CameraLidarSample") -> object:
        """The answer that a kept file holds, for pictures; asked only where `takes_results`.

        Raises:
            ValueError: The file is at fault, or such files hold no answers.
        """
        ...

    def score(self, folder: Path, dataset: "SampleDataset") -> Scores:
        """The figures of the files in a folder, one for each of the data set's samples.

        Raises:
            ValueError: A file is missing or at fault.
        """
        ...

    def draw(self, answered: Answered, width_px: int) -> tuple[Panel, ...]:
        """Pictures of so many columns of what was given and answered."""
        ...
