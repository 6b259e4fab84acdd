"""Doubts about the result files of a method: stored by case, and told once for all cases."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from sightline.corruptions.suites import CLEAN
from sightline.robustness.scoring import Scores

if TYPE_CHECKING:
    from sightline.data.datasets.sample_dataset import SampleDataset
    from sightline.evaluation.object_tally import ObjectTally, ResultDoubt

_METHOD: Final = "method"  # kind of the doubts that are told for sound sensors alone
_NO_RESULT: Final = "WARNING: the result files of sound sensors hold no object at all."
_MAX_CASES: Final = 5  # in a sentence


@runtime_checkable
class DoubtingScoring(Protocol):
    """Interface of a `Scoring` that also looks for results that cannot score."""

    def score_and_doubt(
        self, folder: Path, dataset: "SampleDataset"
    ) -> "tuple[Scores, tuple[ResultDoubt, ...]]":
        """Score the files in a folder, as `Scoring.score`, and list doubts about them."""
        ...


def object_doubts(
    tally: "ObjectTally", classes: Sequence[str], *, in_space: bool
) -> "tuple[ResultDoubt, ...]":
    """List doubts about the object results of a case; empty: sound ones, or none at all.

    Results of KITTI's other classes, as Van, raise none.

    Args:
        tally: Counts of the case's results and labels.
        classes: Classes of the metrics.
        in_space: Whether metrics compare 3D boxes.
    """
    from sightline.evaluation.object_tally import OTHER_CLASSES, ResultDoubt

    lost = tally.lost_results(classes, in_space=in_space)
    none = ResultDoubt(kind=_METHOD, text=_NO_RESULT)
    others = tally.other_doubts() if tally.results else (none,)
    return (
        *(each for each in lost if each.kind != OTHER_CLASSES),
        *(each if each.is_convention else replace(each, kind=_METHOD) for each in others),
    )


def file_doubts(folder: Path, names: Sequence[str], suffix: str) -> "tuple[ResultDoubt, ...]":
    """List a doubt about result files of no frame; empty if there are none.

    Args:
        folder: The result files of a case.
        names: All frames of the data.
        suffix: Suffix of result files.
    """
    from sightline.evaluation.object_tally import ResultDoubt, unread_results

    texts = unread_results(folder, names, suffix, "frame")
    return tuple(ResultDoubt(kind="file", text=text) for text in texts)


def tell_doubts(doubts: "Mapping[str, Sequence[ResultDoubt]]") -> tuple[str, ...]:
    """Word the doubts of all cases, each kind once with its cases; a total loss comes first.

    Conventions that sound sensors' files have, too, are told of these alone.

    Args:
        doubts: Doubts of each case.
    """
    of_method = [each for each in doubts.get(CLEAN, ()) if _is_of_method(each)]
    known = {_METHOD, *(each.kind for each in of_method)}
    groups: dict[tuple[bool, str], dict[str, "ResultDoubt"]] = {}
    for case, listed in doubts.items():
        for each in listed:
            if each.kind not in known:
                groups.setdefault((not each.is_total, each.kind), {})[case] = each
    told = (
        _word(next(iter(affected.values())), _where(list(affected), len(doubts)))
        for _, affected in sorted(groups.items(), key=lambda group: group[0])
    )
    return (*told, *(each.text for each in of_method))


def _is_of_method(doubt: "ResultDoubt") -> bool:
    return doubt.kind == _METHOD or doubt.is_convention


def _word(doubt: "ResultDoubt", where: str) -> str:
    if doubt.is_total:
        return (
            f"WARNING: nothing can be found in {where}: {doubt.text} Such scores say nothing about "
            "the method: correct the files, and run this again."
        )
    if doubt.is_convention:
        return (
            f"WARNING: in {where}, and not in case {CLEAN}: {doubt.text.removeprefix('WARNING: ')} "
            "No faulty sensor causes this: correct the files, and run this again."
        )
    return f"In {where}: {doubt.text}"


def doubts_to_json(doubts: "Sequence[ResultDoubt]") -> list[dict[str, Any]]:
    """Convert doubts to the content of a file."""
    return [asdict(each) for each in doubts]


def doubts_from_json(content: Sequence[Mapping[str, Any]]) -> "tuple[ResultDoubt, ...]":
    """Read doubts from the content of a file.

    Raises:
        TypeError: A text is none.
    """
    from sightline.evaluation.object_tally import ResultDoubt
    from sightline.robustness.record import checked_text

    return tuple(
        ResultDoubt(
            kind=checked_text(each["kind"]),
            text=checked_text(each["text"]),
            is_convention=each.get("is_convention") is True,
            is_total=each["is_total"] is True,
        )
        for each in content
    )


def _where(cases: Sequence[str], num_cases: int) -> str:
    if len(cases) == 1:
        return f"case {cases[0]}"
    if len(cases) == num_cases:
        return f"all {num_cases} cases, as {cases[0]}"
    more = f" and {len(cases) - _MAX_CASES} more" if len(cases) > _MAX_CASES else ""
    return f"cases {', '.join(cases[:_MAX_CASES])}{more}, with the numbers of the first"
