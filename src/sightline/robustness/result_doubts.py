"""Doubts about result files that cannot score: collected by case, and told once for all cases."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from sightline.corruptions.suites import CLEAN
from sightline.robustness.scoring import Scores

if TYPE_CHECKING:
    from sightline.data.open import SampleDataset
    from sightline.evaluation.object_tally import ObjectTally

_MAX_NAMES: Final = 5  # maximum number of cases in a sentence, and of stored names of a doubt
_MAX_LENGTH: Final = 24  # of a name


@dataclass(frozen=True, kw_only=True, slots=True)
class ResultDoubt:
    """Doubt about the result files of a case."""

    text: str
    """Predicate of the affected results, the same in all cases; a sentence if `total` is 0."""
    count: int = 0
    """Number of affected results or files."""
    total: int = 0
    """Number of all; 0: the doubt is about the method as such, and is told for sound sensors."""
    noun: str = "results"
    names: Mapping[str, int] = field(default_factory=dict)
    """Numbers of affected results by class, or the affected files."""


@runtime_checkable
class DoubtingScoring(Protocol):
    """Interface of a `Scoring` that also looks for results that cannot score."""

    def score_and_doubt(
        self, folder: Path, dataset: "SampleDataset"
    ) -> tuple[Scores, tuple[ResultDoubt, ...]]:
        """Score the files in a folder, as `Scoring.score`, and list doubts about them."""
        ...


def object_doubts(
    tally: "ObjectTally", classes: Sequence[str], *, in_space: bool
) -> tuple[ResultDoubt, ...]:
    """List doubts about the object results of a case; empty: sound ones, or none at all.

    Results of KITTI's other classes, as Van, raise none.

    Args:
        tally: Counts of the case's results and labels.
        classes: Classes of the metrics.
        in_space: Whether metrics compare 3D boxes.
    """
    from sightline.evaluation.kitti_object_rules import CLASSES, class_code
    from sightline.evaluation.object_tally import KITTI_CLASSES, by_code

    found, labelled = by_code(tally.results), by_code(tally.labels)
    total = tally.results.total()
    scored = ", ".join(CLASSES)
    doubts = []
    unscored = {name: n for name, n in tally.results.items() if class_code(name) < 0}
    if sum(unscored.values()) < total:
        unscored = {name: n for name, n in unscored.items() if name.lower() not in KITTI_CLASSES}
    if unscored:
        doubts.append(
            ResultDoubt(
                text=f"were left out, as their classes are not scored ({scored} are)",
                count=sum(unscored.values()),
                total=total,
                names=_plain(unscored),
            )
        )
    if in_space and tally.without_box3d:
        doubts.append(
            ResultDoubt(
                text="of scored classes have no 3D part: they match nothing in bird's eye and 3D",
                count=tally.without_box3d,
                total=found.total(),
            )
        )
    for code, name in enumerate(CLASSES):
        if name in classes and labelled and code in found and code not in labelled:
            doubts.append(
                ResultDoubt(
                    text=f"are of {name}, of which there is no label: they cannot score above 0",
                    count=found[code],
                    total=total,
                )
            )
    remarks = [*tally.remarks_on_labels(), *tally.remarks_on_angles(), *tally.convention_remarks]
    if not total:
        remarks.append("WARNING: the result files of sound sensors hold no object at all.")
    return (*doubts, *(ResultDoubt(text=text) for text in remarks))


def file_doubts(folder: Path, names: Sequence[str], suffix: str) -> tuple[ResultDoubt, ...]:
    """List a doubt about result files of no frame; empty if there are none.

    Args:
        folder: The result files of a case.
        names: All frames of the data.
        suffix: Suffix of result files.
    """
    expected = {f"{name}{suffix}" for name in names}
    files = {path.name for path in folder.iterdir() if path.suffix.lower() == suffix}
    extra = sorted(files - expected)
    if not extra:
        return ()
    return (
        ResultDoubt(
            text="were left out, as the data have no frame of their names",
            count=len(extra),
            total=len(files),
            noun="result files",
            names=_plain(dict.fromkeys(extra[: _MAX_NAMES + 1], 1)),
        ),
    )


def tell_doubts(doubts: Mapping[str, Sequence[ResultDoubt]]) -> tuple[str, ...]:
    """Word the doubts of all cases, each once with its cases; a total loss comes first.

    Args:
        doubts: Doubts of each case.
    """
    groups: dict[tuple[bool, str], dict[str, ResultDoubt]] = {}
    remarks = [each.text for each in doubts.get(CLEAN, ()) if not each.total]
    for case, listed in doubts.items():
        for each in listed:
            if each.total:
                key = each.count == each.total, each.text
                groups.setdefault(key, {})[case] = each
    lost, others = [], []
    for (is_all, text), affected in groups.items():
        count = sum(each.count for each in affected.values())
        total = sum(each.total for each in affected.values())
        noun = next(iter(affected.values())).noun
        said = f"{count:,} of {total:,} {noun} {text}{_listed(affected)}."
        where = _where(list(affected), len(doubts))
        if is_all:
            lost.append(
                f"WARNING: nothing can be found in {where}: {said} Such scores say nothing about "
                "the method: correct the files, and run this again."
            )
        else:
            others.append(f"In {where}, {said}")
    return (*lost, *others, *remarks)


def doubts_to_json(doubts: Sequence[ResultDoubt]) -> list[dict[str, Any]]:
    """Convert doubts to the content of a file."""
    return [
        {
            "text": each.text,
            "count": each.count,
            "total": each.total,
            "noun": each.noun,
            "names": dict(each.names),
        }
        for each in doubts
    ]


def doubts_from_json(content: Sequence[Mapping[str, Any]]) -> tuple[ResultDoubt, ...]:
    """Read doubts from the content of a file.

    Raises:
        TypeError: A text or number is none, or too large.
    """
    from sightline.robustness.record import checked_count, checked_text

    return tuple(
        ResultDoubt(
            text=checked_text(each["text"]),
            count=checked_count(each["count"]),
            total=checked_count(each["total"]),
            noun=checked_text(each["noun"]),
            names={checked_text(name): checked_count(n) for name, n in each["names"].items()},
        )
        for each in content
    )


def _plain(counts: Mapping[str, int]) -> dict[str, int]:
    """Make names from files safe to display, and keep the most frequent."""
    from sightline.files.plain_text import shortened

    plain: Counter[str] = Counter()
    for name, count in sorted(counts.items(), key=lambda item: -item[1])[: _MAX_NAMES + 1]:
        plain[shortened(ascii(name)[1:-1], _MAX_LENGTH)] += count
    return dict(plain)


def _listed(affected: Mapping[str, ResultDoubt]) -> str:
    """List the names of a doubt in all its cases in brackets; empty if there are none."""
    from sightline.evaluation.object_tally import listed

    names: Counter[str] = Counter()
    for each in affected.values():
        names.update(each.names)
    if next(iter(affected.values())).noun == "results":
        return f": {listed(names)}" if names else ""
    shown = ", ".join(sorted(names)[:_MAX_NAMES])
    return f": {shown}{', ...' if len(names) > _MAX_NAMES else ''}"


def _where(cases: Sequence[str], num_cases: int) -> str:
    if len(cases) == num_cases:
        return f"all {num_cases} cases" if num_cases > 1 else f"case {cases[0]}"
    shown = ", ".join(cases[:_MAX_NAMES])
    further = len(cases) - _MAX_NAMES
    more = f" and {further} more" if further > 0 else ""
    return f"case{'s' if len(cases) > 1 else ''} {shown}{more}"
