"""Scoring of the stored predictions, several cases at once; existing scores are kept."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.files.problem import FileError, remaking
from sightline.files.shard_path import data_path
from sightline.jobs.crew import Driver
from sightline.jobs.run import run_job
from sightline.robustness.labels import digest_all_labels
from sightline.robustness.record import number_or_none
from sightline.robustness.result_doubts import (
    DoubtingScoring,
    doubts_from_json,
    doubts_to_json,
)
from sightline.robustness.scoring import Scores, Scoring

if TYPE_CHECKING:
    from sightline.evaluation.object_tally import ResultDoubt

_SCORES: Final = "scores"
_DOUBTS: Final = "doubts"  # entries beside the scores
_LABELS: Final = "labels"


class _Stored(NamedTuple):
    """Stored scores of a case."""

    scores: Scores
    doubts: "tuple[ResultDoubt, ...]"
    labels: object
    """Digest of the labels scored against; None: none, or an older version's scores."""


class CaseScores(NamedTuple):
    """Scores of all cases, and doubts about their files."""

    scores: dict[str, Scores]
    """Scores by case."""
    doubts: "dict[str, tuple[ResultDoubt, ...]]"
    """Doubts by case."""


def score_cases(
    scoring: Scoring,
    dataset: SampleDataset,
    predictions: Path,
    cases: Sequence[str],
    out: Path,
    workers: int,
    *,
    driver: Driver = "local",
    anew: bool = False,
) -> CaseScores:
    """Score every case, and collect the doubts about its result files.

    Args:
        scoring: The task's scoring.
        dataset: The frames of the predictions.
        predictions: Stored predictions, a folder for each case.
        cases: Names of the cases.
        out: Folder of the run, in which scores are stored, too.
        workers: Number of workers; 1 on this machine uses this process alone.
        driver: Kind of workers.
        anew: Whether to repeat existing scores, because predictions may have changed. Those of
            predictions that were changed later, or of other labels, are repeated in any case.

    Raises:
        ValueError: A file is missing or invalid; the message contains the case.
    """
    files = {case: out / _SCORES / f"{case}.json" for case in cases}
    labels = digest_all_labels(dataset) if "objects" in scoring.parts else None
    works = [
        _CaseWork(scoring, dataset, case, data_path(predictions / case), path, labels, anew)
        for case, path in files.items()
        if anew
        or (stored := _stored_scores(path, scoring)) is None
        or stored.labels != labels
        or _is_newer(data_path(predictions / case), path)
    ]
    run_job(works, workers, description="scoring", driver=driver)
    scores, doubts = {}, {}
    for case, path in files.items():
        stored = _stored_scores(path, scoring)
        if stored is None:
            raise FileError(path, "holds no scores", "remove it, and run this again")
        scores[case], doubts[case] = stored.scores, stored.doubts
    return CaseScores(scores, doubts)


def _is_newer(predictions: Path, scores: Path) -> bool:
    """Check if a prediction was changed after the scores were stored."""
    stored = scores.stat().st_mtime
    return any(each.stat().st_mtime > stored for each in predictions.rglob("*") if each.is_file())


def _stored_scores(path: Path, scoring: Scoring) -> _Stored | None:
    """Read the stored scores of a case; None if missing, incomplete or damaged."""
    try:
        content = json.loads(read_text(path))
        for metric in scoring.metrics:
            number_or_none(content[metric.name])
        doubts = doubts_from_json(content.get(_DOUBTS, []))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    names = {metric.name for metric in scoring.metrics}
    scores = {name: score for name, score in content.items() if name in names}
    return _Stored(scores, doubts, content.get(_LABELS))


@dataclass(frozen=True, slots=True)
class _CaseWork:
    """Job that scores a case and stores the scores."""

    scoring: Scoring
    dataset: SampleDataset
    case: str
    predictions: Path
    path: Path
    labels: str | None
    """Digest of the labels; None: the scoring uses none."""
    are_given: bool
    """Predictions of the user's; else the run's own."""

    def __str__(self) -> str:
        return f"case {self.case}"

    def run(self) -> None:
        with remaking(None if self.are_given else self.predictions):
            scores, content = self._scores()
        atomic_write_text(self.path, json.dumps({**scores, **content}, indent=2) + "\n")

    def _scores(self) -> tuple[Scores, dict[str, object]]:
        content: dict[str, object] = {} if self.labels is None else {_LABELS: self.labels}
        if isinstance(self.scoring, DoubtingScoring):
            scores, doubts = self.scoring.score_and_doubt(self.predictions, self.dataset)
            if doubts:
                content[_DOUBTS] = doubts_to_json(doubts)
        else:
            scores = self.scoring.score(self.predictions, self.dataset)
        return scores, content
