"""Lines and times of `perceive` in its folder: read with checks for manual edits, and joined.

Damaged or foreign entries count as missing.
"""

import json
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, get_args

from sightline.data.layouts.kitti_trees import Part, describe_absent
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_file import read_bytes
from sightline.geometry.user_warning import warn_user
from sightline.structures.objects import Origin
from sightline.structures.sample import SENSOR_FIELDS
from sightline.tasks import further_keys, task_names

Lines = dict[str, tuple[str, dict[str, Any]]]
"""Lines by frame: text and parsed contents."""

LINES_FOLDER: Final = "lines"
"""Folder in the output folder with a file for the line of each frame."""

LINES_NAME: Final = "perception.jsonl"
"""File in the output folder with a line for each frame, sorted by name."""

TIMINGS_NAME: Final = "timings.jsonl"
"""File with the time of each prediction: the only output that differs between runs."""

TIMINGS_FOLDER: Final = "timings"
"""Folder in the output folder with a file for the times of each frame."""

_MAX_BYTES = 2**26
_MAX_NUMBER = 3.5e38  # beyond single precision, the type of networks' outputs
_SENSORS: Final[Mapping[str, str]] = {field: sensor for sensor, field in SENSOR_FIELDS.items()}

_Check = Callable[[Any], bool]


def read_lines(folder: Path) -> Lines:
    """Read the complete lines, by frame in order."""
    return _read(folder, _line_check())


def read_line(path: Path) -> dict[str, Any] | None:
    """Read the line of one frame; None: the file holds no complete one."""
    found = _read_entry(path, _line_check())
    return None if found is None else found[1]


def read_timings(folder: Path) -> Lines:
    """Read the complete times, by frame in order."""
    return _read(folder, lambda content: _fits(content, _TIMING))


def join_lines(out: Path) -> Lines:
    """Join all frames' lines in one file, their times in another, and warn of missing entries."""
    # Listed before they are read: other shards may go on writing meanwhile.
    files = sorted(path.stem for path in (out / LINES_FOLDER).glob("*.json"))
    lines = _join_lines(out)
    _warn_of_missing(out, files, lines, _join_timings(out))
    return lines


def _join_lines(out: Path) -> Lines:
    """Join all lines, including lines written by other shards meanwhile."""
    while True:
        lines = read_lines(out / LINES_FOLDER)
        atomic_write_text(out / LINES_NAME, "".join(f"{text}\n" for text, _ in lines.values()))
        # Another shard may have ended between the reading and the writing: its file was complete,
        # and this one has just replaced it.
        if read_lines(out / LINES_FOLDER) == lines:
            return lines


def _join_timings(out: Path) -> Lines:
    """Join all times; see `_join_lines`."""
    timings: Lines | None = None
    while timings != (timings := read_timings(out / TIMINGS_FOLDER)):
        atomic_write_text(out / TIMINGS_NAME, "".join(f"{text}\n" for text, _ in timings.values()))
    return timings


def _warn_of_missing(out: Path, files: Sequence[str], lines: Lines, timings: Lines) -> None:
    """Warn of frames that have files in the folder but no entry in the joined files."""
    for entry, names, joined in (
        ("line", [name for name in files if name not in lines], LINES_NAME),
        ("time", [name for name in lines if name not in timings], TIMINGS_NAME),
    ):
        if names:
            warn_user(
                f"{out / joined} lacks the {entry} of {len(names)} of {len(files)} frames, "
                f"{describe_absent(names)}: the file of each is missing, damaged or has other "
                "content; run this again for these frames with --overwrite",
            )


def _read(folder: Path, is_complete: _Check) -> Lines:
    entries = {path.stem: _read_entry(path, is_complete) for path in sorted(folder.glob("*.json"))}
    return {name: entry for name, entry in entries.items() if entry is not None}


def _read_entry(path: Path, is_complete: _Check) -> tuple[str, dict[str, Any]] | None:
    data = read_bytes(path, max_bytes=_MAX_BYTES, remedy="remove it, and run this again")
    text = data.decode(errors="replace").strip()
    try:
        content = json.loads(text)
        # `perceive` wrote it only if serialising it gives the same text.
        is_unedited = json.dumps(content, allow_nan=False) == text
    except (ValueError, RecursionError):
        return None
    if is_unedited and is_complete(content) and content["frame"] == path.stem:
        return text, content
    return None


def _line_check() -> _Check:
    further = further_keys(task_names())  # their values may be any JSON
    return lambda content: _fits_line(content, further) and _is_consistent(content)


def _fits_line(content: object, further: Collection[str]) -> bool:
    if not isinstance(content, dict):
        return False
    form = _LINE | ({"undone_turn": _TURN} if "undone_turn" in content else {})
    return _fits({key: value for key, value in content.items() if key not in further}, form)


def _is_consistent(line: Mapping[str, Any]) -> bool:
    """Whether the parts that tasks lack agree with the missing parts of the frame."""
    return not any(
        line["sensors"].get(_SENSORS.get(part), False)
        for task in line["tasks"].values()
        for part in task.get("lacks", ())
    )


def _fits(value: object, form: object) -> bool:
    """Whether a value matches a form: a check, or a dictionary, list or tuple of forms."""
    if callable(form):
        return bool(form(value))
    if isinstance(form, dict):
        return (
            isinstance(value, dict)
            and value.keys() == form.keys()
            and all(_fits(value[name], each) for name, each in form.items())
        )
    if not isinstance(value, list):
        return False
    assert isinstance(form, list | tuple), "a form is a check, dictionary, list or tuple"
    forms = form * len(value) if isinstance(form, list) else form
    return len(forms) == len(value) and all(map(_fits, value, forms))


def _number(value: object) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and -_MAX_NUMBER <= value <= _MAX_NUMBER
    )


def _count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _MAX_NUMBER


def _text(value: object) -> bool:
    return isinstance(value, str)


def _flag(value: object) -> bool:
    return isinstance(value, bool)


def _maybe(form: object) -> _Check:
    return lambda value: value is None or _fits(value, form)


def _task(value: object) -> bool:
    return _fits(value, {"by": _text}) or _fits(value, {"by": _text, "lacks": _parts})


def _parts(value: object) -> bool:
    return isinstance(value, list) and bool(value) and all(each in get_args(Part) for each in value)


def _each(form: object) -> _Check:
    return lambda value: (
        isinstance(value, dict) and all(_fits(each, form) for each in value.values())
    )


_LINE: Final = {
    "frame": _text,
    "timestamp_s": _maybe(_number),
    "image_size_px": (_count, _count),
    "sensors": dict.fromkeys(SENSOR_FIELDS, _flag),
    "num_points": _maybe(_count),
    "tasks": _each(_task),
    "objects": _maybe(
        [
            {
                "class": _text,
                "score": _number,
                "box_px": _maybe((_number,) * 4),
                "box_3d": _maybe(
                    {
                        "center_m": (_number,) * 3,
                        "size_m": (_number,) * 3,
                        "yaw_rad": _number,
                        "score": _number,
                        "origin": lambda value: value in get_args(Origin),
                    }
                ),
                "support": {"image": _number, "lidar": _number, "points": _count},
            }
        ]
    ),
    "detections2d": _maybe([{"class": _text, "score": _number, "box_px": (_number,) * 4}]),
    "detections3d": _maybe(
        [
            {
                "class": _text,
                "score": _number,
                "center_m": (_number,) * 3,
                "size_m": (_number,) * 3,
                "yaw_rad": _number,
            }
        ]
    ),
    "depth": _maybe(
        {
            "valid_share": _number,
            "guessed_share": _number,
            "nearest_m": _maybe(_number),
            "median_m": _maybe(_number),
            "farthest_m": _maybe(_number),
            "median_expected_error_m": _maybe(_number),
        }
    ),
}
_TURN: Final = dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg"), _number)
_TIMING: Final = {"frame": _text, "milliseconds": _each(_number)}
