"""Scoring interface of a task, by which the bench scores predictions for corrupted frames."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import UInt8

    from sightline.corruptions.corruption import Corrupted
    from sightline.data.datasets.sample_dataset import SampleDataset
    from sightline.data.layouts.kitti_trees import Part
    from sightline.structures.sample import CameraLidarSample

Scores = Mapping[str, float | None]
"""Scores by the metrics' names; None if there is nothing to score, e.g. no object of a class."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BenchMetric:
    """Metric of the predictions."""

    name: str
    """Name in files, e.g. rmse_mm."""
    title: str
    """Title for display, without the unit."""
    unit: str
    """Unit, e.g. % or mm."""
    highest: float | None = None
    """Score of perfect predictions, if more is better; None: an error, with 0 as the best."""

    def error(self, score: float) -> float:
        """Compute the difference of a score from the perfect one, in the metric's unit."""
        return score if self.highest is None else self.highest - score

    def lead(self, score: float, other: float) -> float:
        """Compute by how much a score is better than another, in the metric's unit."""
        return self.error(other) - self.error(score)


class BenchFrame(NamedTuple):
    """Frame prepared for methods."""

    sample: "CameraLidarSample"
    """Sample of sound sensors, to be corrupted and then given to methods."""
    truth: Any
    """The task's own truth, if scores are computed frame by frame; otherwise None."""


class BenchPrediction(NamedTuple):
    """Prediction for a corrupted frame, with all data for comparison."""

    frame: BenchFrame
    corrupted: "Corrupted"
    output: Any
    """The predictor's output."""


class Panel(NamedTuple):
    """Picture of a report."""

    caption: str
    picture: "UInt8[np.ndarray, 'height width 3']"


@runtime_checkable  # for beartype, which checks arguments under pytest
class ResultWriter(Protocol):
    """Interface that prepares frames for methods and stores a file for each prediction.

    It must be picklable if workers start as new processes (macOS, Windows).
    """

    @property
    def suffix(self) -> str:
        """Suffix of the files, with its dot."""
        ...

    def prepare(self, sample: "CameraLidarSample") -> BenchFrame:
        """Prepare the frame for methods.

        Raises:
            ValueError: It cannot be scored.
        """
        ...

    def store(self, path: Path, prediction: BenchPrediction) -> None:
        """Write the file of a prediction atomically."""
        ...

    def finished(self, folder: Path) -> frozenset[str]:
        """List the frames of which a folder has all that `store` writes."""
        ...


@runtime_checkable
class Scoring(ResultWriter, Protocol):
    """Interface that scores a task's predictions from the stored files."""

    @property
    def name(self) -> str:
        """Name of the protocol: results of different protocols cannot be compared."""
        ...

    @property
    def metrics(self) -> tuple[BenchMetric, ...]:
        """Metrics, the most important first."""
        ...

    @property
    def parts(self) -> "Collection[Part]":
        """Parts of a sample needed in addition to the methods' input."""
        ...

    @property
    def takes_results(self) -> bool:
        """Whether the files are a format of predictions that any method may write."""
        ...

    def check(self, dataset: "SampleDataset") -> None:
        """Check that the data can be scored.

        Raises:
            ValueError: The data hold no truth to score against.
        """
        ...

    def notes(self, dataset: "SampleDataset") -> tuple[str, ...]:
        """List notes on the scores of such data, e.g. on metrics with too few objects."""
        ...

    def read(self, path: Path, sample: "CameraLidarSample") -> object:
        """Read a prediction from a stored file, for pictures; called only if `takes_results`.

        Raises:
            ValueError: The file is invalid, or such files hold no predictions.
        """
        ...

    def score(self, folder: Path, dataset: "SampleDataset") -> Scores:
        """Score the files in a folder, one for each of the data set's samples.

        Raises:
            ValueError: A file is missing or invalid.
        """
        ...

    def draw(self, prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
        """Draw pictures of the input and the prediction, of this width."""
        ...
