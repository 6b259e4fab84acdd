"""Checks that runs can be compared, before any work is done."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

from sightline.corruptions.suites import CLEAN
from sightline.files.plain_text import shortened, shortened_pair
from sightline.robustness.record import CaseInfo, Record, Setting

_MAX_VALUE = 24  # characters of a setting in an error message
_MAX_PARAMETERS = 200  # characters of a case's parameters in an error message

_SAME: Final = 0.01
"""Largest difference from the clean score, as a share of it, of a sensor's method where that sensor
is sound; above 0, as methods of others may draw random numbers."""
_IN_WORDS: Final = {"figures": "other metrics", "frames_sha256": "another list of frames"}
"""Descriptions of differing settings whose values tell users nothing."""
_FILES: Final = "files_digest"
_DATA: Final = "data"


def check_baseline(
    baseline: Record, setting: Setting, cases: Mapping[str, CaseInfo], *, title: str = ""
) -> None:
    """Refuse a baseline of another task, suite or data set, or without some of the cases.

    Args:
        baseline: The record.
        setting: Required setting.
        cases: Required cases.
        title: Name of the baseline in error messages.

    Raises:
        ValueError: The baseline does not match.
    """
    title = title or f"the baseline {shortened(baseline.method)}"
    _check(title, baseline.setting.to_json(), setting.to_json())
    for name, case in cases.items():
        if name not in baseline.cases:
            raise ValueError(
                f"{title} has no scores of case {name}; run it again with that case, or name the "
                "cases that it has (--cases)"
            )
        if baseline.cases[name] != case:
            raise ValueError(
                f"{title} was scored with another case {name}, of "
                f"{_differing(baseline.cases[name], case)} instead of "
                f"{_differing(case, baseline.cases[name])}; run it again with this version"
            )


def check_healthy(sensor: str, healthy: Record, setting: Setting) -> None:
    """Refuse a single-sensor method with clean scores of another setting, or of more sensors.

    Where the record has cases that break the other sensor alone, their scores must be the clean
    ones.

    Raises:
        ValueError: The clean scores do not match, or there are none; or another sensor's fault
            changes a score.
    """
    title = f"the healthy {sensor}'s {shortened(healthy.method)}"
    _check(title, healthy.setting.clean_settings(), setting.clean_settings())
    if CLEAN not in healthy.scores:
        raise ValueError(f"{title} has no scores of case {CLEAN}; run it again with that case")
    for name, case in healthy.cases.items():
        for metric in () if sensor in case.sensors else healthy.setting.metrics:
            clean, score = healthy.score(CLEAN, metric), healthy.score(name, metric)
            if score is not None and clean is not None and abs(score - clean) > _SAME * abs(clean):
                raise ValueError(
                    f"{title} has {score:.4g} instead of {clean:.4g} ({metric.title}) in case "
                    f"{name}, which leaves the {sensor} sound, so it uses another sensor, too; "
                    f"give a run of a method by the {sensor} alone"
                )


def notes_on_files(records: Mapping[str, Record]) -> tuple[str, ...]:
    """List notes on frames of equal names: other files, or the same ones under another data name.

    Other files are not refused, as files may be rewritten.

    Args:
        records: Records by their name in the notes. Records without a file digest are left out.
    """
    settings = {
        name: record.setting
        for name, record in records.items()
        if record.setting.files_digest is not None
    }
    if not settings:
        return ()
    (first, of_first), *rest = settings.items()
    others = [name for name, each in rest if each.files_digest != of_first.files_digest]
    notes = [
        f"WARNING: {name} is of data {each.data}, {first} of {of_first.data}: they are taken for "
        "the same, as names and sizes of their files agree; if one is noisy, scores do not compare."
        for name, each in rest
        if each.data != of_first.data
    ]
    if others:
        notes.append(
            f"WARNING: data {of_first.data} hold other files, by names or sizes, for "
            f"{', '.join(others)} than for {first}: unless the same frames were written anew, "
            "scores do not compare."
        )
    return tuple(notes)


def _check(title: str, actual: Mapping[str, object], required: Mapping[str, object]) -> None:
    has_same_files = actual[_FILES] is not None and actual[_FILES] == required[_FILES]
    ignored = (_FILES, _DATA) if has_same_files else (_FILES,)
    for name, value in required.items():
        if name not in ignored and actual[name] != value:
            there, wanted = shortened_pair(str(actual[name]), str(value), _MAX_VALUE)
            found = _IN_WORDS.get(name, f"{name} {there} instead of {wanted}")
            raise ValueError(
                f"{title} is of {found}, so scores cannot be compared; give one of the "
                "same task, data, frames, suite and seed"
            )


def _differing(case: CaseInfo, other: CaseInfo) -> str:
    """Describe the fields of a case that another version of it has otherwise."""
    others = asdict(other)
    fields = {name: value for name, value in asdict(case).items() if value != others[name]}
    return shortened(str(fields.pop("parameters", fields)), _MAX_PARAMETERS)
