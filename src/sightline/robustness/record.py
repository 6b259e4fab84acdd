"""Record of a method's scores in the cases of a suite, as in the file of its run."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, get_args

from sightline.corruptions.suites import CLEAN, Case
from sightline.files.plain_text import read_text, shortened
from sightline.files.problem import FileError, plain_line
from sightline.robustness.measures import ByKind
from sightline.robustness.scoring import BenchMetric, Scores
from sightline.structures.sample import Sensor

RECORD_NAME: Final = "robustness.json"
"""Name of the record's file in a run's folder."""
CSV_NAME: Final = "robustness.csv"
MARKDOWN_NAME: Final = "robustness.md"
PAGE_NAME: Final = "report.html"
RUN_FILES: Final = (RECORD_NAME, CSV_NAME, MARKDOWN_NAME, PAGE_NAME)
"""Names of the files that a run writes."""

_MAX_NUMBER = 10**12  # plausible in a record
_MAX_TEXT = 10_000  # characters
_REMEDY = f"give the {RECORD_NAME} of a run of `sightline robustness`"


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseInfo:
    """Description of a case."""

    title: str
    kind: str
    """Kind of corruption: cases of one kind differ in severity."""
    severity: int | None
    """Severity from 1 to 5; None if the suite has no levels."""
    sensors: tuple[Sensor, ...]
    """Sensors that are corrupted."""
    parameters: Mapping[str, object]
    """Parameters; see `Corruption.described`."""


def describe_case(case: Case) -> CaseInfo:
    """Describe a suite's case for reports."""
    suffix = "" if case.severity is None else f"-{case.severity}"
    return CaseInfo(
        title=case.title,
        kind=case.name.removesuffix(suffix),
        severity=case.severity,
        sensors=case.corruption.sensors,
        parameters=case.corruption.described(),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """Settings that two runs must share for a comparison."""

    task: str
    scoring: str
    """Protocol of the scoring."""
    data: str
    """Name of the data; see `dataset_title`. It may differ where `files_digest` is equal."""
    velodyne: str
    """The sweeps' folder."""
    frames: int
    frames_sha256: str
    """Digest of the frames' names, in order."""
    metrics: tuple[BenchMetric, ...]
    suite: str
    seed: int
    files_digest: str | None = None
    """See `digest_files`: a difference causes a warning, not an error. None: an older record, or a
    corrupted data set without its clean case."""

    def to_json(self) -> dict[str, object]:
        """Convert the setting to its part of a run's file, in which metrics are `figures`."""
        plain = asdict(self)
        return {"figures" if name == "metrics" else name: plain[name] for name in plain}

    def clean_settings(self) -> dict[str, object]:
        """Collect the entries of `to_json` that clean scores depend on."""
        content = self.to_json()
        return {name: content[name] for name in content if name not in ("suite", "seed")}


def digest_names(names: Sequence[str]) -> str:
    """Compute the SHA-256 of the names of a run's frames, in order."""
    return hashlib.sha256("\n".join(names).encode()).hexdigest()


@dataclass(frozen=True, kw_only=True, slots=True)
class Record:
    """Scores of a method."""

    method: str
    """Name of the method or of its weights."""
    made_by: Mapping[str, str]
    """Further identification, e.g. the weights' hash and the engine."""
    setting: Setting
    cases: Mapping[str, CaseInfo]
    """Cases by name, sound sensors first."""
    scores: Mapping[str, Scores]
    """Scores by case."""
    notes: tuple[str, ...] = ()
    """Notes on the scores, e.g. on metrics with too few objects."""

    @property
    def kinds(self) -> dict[str, tuple[str, ...]]:
        """Cases of each kind of corruption, in the suite's order."""
        kinds: dict[str, tuple[str, ...]] = {}
        for name, case in self.cases.items():
            if name != CLEAN:
                kinds[case.kind] = (*kinds.get(case.kind, ()), name)
        return kinds

    def score(self, case: str, metric: BenchMetric) -> float | None:
        """Look up a score; None if there is nothing to score."""
        return self.scores[case][metric.name]

    def by_kind(
        self, metric: BenchMetric, kinds: Mapping[str, Sequence[str]] | None = None
    ) -> ByKind | None:
        """Collect a metric's scores by kind; None if there is nothing to score.

        Args:
            metric: One of the setting's.
            kinds: Names of cases by kind. None: the record's own.
        """
        table = {
            kind: [self.scores[name][metric.name] for name in names]
            for kind, names in (kinds or self.kinds).items()
        }
        known = {
            kind: [score for score in levels if score is not None] for kind, levels in table.items()
        }
        return known if known == table else None

    def to_json(self) -> dict[str, object]:
        """Convert the record to its file's content."""
        notes = {"notes": list(self.notes)} if self.notes else {}
        return {
            "method": self.method,
            "made_by": dict(self.made_by),
            **self.setting.to_json(),
            "cases": {name: asdict(case) for name, case in self.cases.items()},
            "scores": {name: dict(scores) for name, scores in self.scores.items()},
            **notes,
        }


def record_file(path: Path) -> Path:
    """File of the record, given the file itself or the run's folder.

    Raises:
        FileError: The folder has no record.
    """
    if not path.is_dir():
        return path
    file = path / RECORD_NAME
    if not file.exists():
        remedy = "finish the run, or give the folder of another run of `sightline robustness`"
        raise FileError(path, f"holds no {RECORD_NAME}", remedy)
    return file


def files_beside(path: Path) -> list[Path]:
    """List the existing files of a run, given its record or its folder."""
    folder = record_file(path).parent
    return [file for name in RUN_FILES if (file := folder / name).exists()]


def read_record(path: Path) -> Record:
    """Read the record from a run's file or folder.

    Raises:
        FileError: The file is not a record, or the folder has none.
    """
    path = record_file(path)
    text = read_text(path, remedy=_REMEDY)
    try:
        record = _parse(json.loads(text))
    except (
        KeyError,
        TypeError,
        AttributeError,
        ValueError,
        OverflowError,
        RecursionError,
    ) as error:
        reason = shortened(" ".join(str(error).split())) or type(error).__name__
        raise FileError(path, f"is no record of a robustness run ({reason})", _REMEDY) from error
    for name in record.cases:
        scores = record.scores.get(name, {})
        lacking = [each.name for each in record.setting.metrics if each.name not in scores]
        if lacking:
            raise FileError(path, f"has no {lacking[0]} of case {shortened(name)}", _REMEDY)
    return record


def _parse(content: dict[str, Any]) -> Record:
    setting = Setting(
        task=checked_text(content["task"]),
        scoring=checked_text(content["scoring"]),
        data=checked_text(content["data"]),
        velodyne=checked_text(content["velodyne"]),
        frames=checked_count(content["frames"]),
        frames_sha256=checked_text(content["frames_sha256"]),
        metrics=tuple(map(_parse_metric, content["figures"])),
        suite=checked_text(content["suite"]),
        seed=checked_count(content["seed"]),
        files_digest=(
            checked_text(content["files_digest"]) if content.get("files_digest") else None
        ),
    )
    cases = {checked_text(name): _parse_case(case) for name, case in content["cases"].items()}
    if not setting.metrics or CLEAN not in cases:
        raise ValueError(f"no figures or no case {CLEAN}")
    return Record(
        method=checked_text(content["method"]),
        made_by={
            checked_text(name): checked_text(value) for name, value in content["made_by"].items()
        },
        setting=setting,
        cases=cases,
        scores={
            checked_text(case): {
                checked_text(name): number_or_none(score) for name, score in row.items()
            }
            for case, row in content["scores"].items()
        },
        notes=tuple(map(checked_text, content.get("notes", ()))),
    )


def _parse_metric(content: dict[str, Any]) -> BenchMetric:
    return BenchMetric(
        name=checked_text(content["name"]),
        title=checked_text(content["title"]),
        unit=checked_text(content["unit"]),
        highest=number_or_none(content["highest"]),
    )


def _parse_case(content: dict[str, Any]) -> CaseInfo:
    severity = content["severity"]
    return CaseInfo(
        title=checked_text(content["title"]),
        kind=checked_text(content["kind"]),
        severity=None if severity is None else checked_count(severity),
        sensors=tuple(each for each in get_args(Sensor) if each in content["sensors"]),
        parameters=dict(content["parameters"]),
    )


def checked_text(value: object) -> str:
    """Convert text from a file to one line of printable characters.

    Raises:
        TypeError: It is not a string, or too long for a run's file.
    """
    if not isinstance(value, str) or len(value) > _MAX_TEXT:
        raise TypeError(f"expected text of up to {_MAX_TEXT:,} characters, got {value!r}")
    return plain_line(value)


def checked_count(value: object) -> int:
    """Return a whole number from a file unchanged.

    Raises:
        TypeError: It is not a whole number, negative or implausibly large.
    """
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= _MAX_NUMBER:
        raise TypeError(f"expected a whole number, got {value!r}")
    return value


def number_or_none(value: object) -> float | None:
    """Return a score from a file.

    Raises:
        TypeError: It is not a number, not finite or implausibly large.
    """
    if value is None:
        return None
    if (
        not isinstance(value, int | float)
        or isinstance(value, bool)
        or not abs(value) <= _MAX_NUMBER
    ):
        raise TypeError(f"expected a number, got {value!r}")
    return float(value)
