"""Scores what was kept in each case, several cases at once; what has been scored stays."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.data.atomic import atomic_write_text
from sightline.data.jobs import run_job
from sightline.data.open import SampleDataset
from sightline.data.plain_text import read_text
from sightline.data.problem import FileError
from sightline.robustness.record import number_or_none
from sightline.robustness.scoring import Scores, Scoring

_SCORES: Final = "scores"


def score_cases(
    scoring: Scoring,
    dataset: SampleDataset,
    answers: Path,
    cases: Sequence[str],
    out: Path,
    workers: int,
    *,
    anew: bool = False,
) -> dict[str, Scores]:
    """The figures of every case.

    Args:
        scoring: The task's.
        dataset: Whose frames were answered.
        answers: What was kept, a folder for each case.
        cases: Their names.
        out: Folder of the run, where scores are kept, too.
        workers: Processes that work; 1 is this process alone.
        anew: Whether to score again what has been scored: answers may have changed.

    Raises:
        ValueError: A file is missing or at fault; names the case.
    """
    files = {case: out / _SCORES / f"{case}.json" for case in cases}
    works = [
        _CaseWork(scoring, dataset, case, answers / case, path)
        for case, path in files.items()
        if anew or _kept_scores(path, scoring) is None
    ]
    run_job(works, workers, description="scoring")
    scores = {}
    for case, path in files.items():
        kept = _kept_scores(path, scoring)
        if kept is None:
            raise FileError(path, "holds no scores", "remove it, and run this again")
        scores[case] = kept
    return scores


def _kept_scores(path: Path, scoring: Scoring) -> Scores | None:
    """The scores of a case that were kept; None where there are none, or not all, or no numbers."""
    try:
        told = json.loads(read_text(path))
        for figure in scoring.figures:
            number_or_none(told[figure.name])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    names = {figure.name for figure in scoring.figures}
    return {name: score for name, score in told.items() if name in names}


@dataclass(frozen=True, slots=True)
class _CaseWork:
    """Scores a case and keeps the figures."""

    scoring: Scoring
    dataset: SampleDataset
    case: str
    answers: Path
    path: Path

    def __str__(self) -> str:
        return f"case {self.case}"

    def run(self) -> None:
        scores = self.scoring.score(self.answers, self.dataset)
        atomic_write_text(self.path, json.dumps(dict(scores), indent=2) + "\n")
