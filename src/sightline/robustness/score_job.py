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
        if anew or not path.exists()
    ]
    run_job(works, workers, description="scoring")
    return {case: json.loads(read_text(path)) for case, path in files.items()}


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
