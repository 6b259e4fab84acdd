"""Files of a recording: their list, and the reader and checks of times.txt."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Final

from sightline.data.formats.image_header import IMAGE_SUFFIXES
from sightline.data.formats.point_files import CLOUD_SUFFIXES
from sightline.data.layouts.frame_lists import TIMES_NAME, is_note
from sightline.data.layouts.kitti_trees import (
    PART_SUFFIXES,
    ObjectFrame,
    Part,
    describe_absent,
    find_file,
    list_files,
)
from sightline.files.plain_text import parse_numbers, read_text, shortened
from sightline.files.problem import FileError, Problem, read_or_note
from sightline.files.shard_path import is_single_shard
from sightline.jobs.output_dirs import MANIFEST_NAME

IMAGES, POINTS, LABELS, DEPTH = "images", "points", "labels", "depth"
CALIBRATIONS: Final = "calibration"
"""Name of the folder with one file per frame, and stem of the single file for all frames."""

CALIBRATION_SUFFIXES = (".yaml", ".yml", ".json")
_CALIBRATION_STARTS: Final = ("calib", "camera_calib", "cam_calib")
_TIMES_STARTS: Final = ("times", "time.")  # times, timestamps
_MAX_TIME_S: Final = 1e11  # seconds since 1970: the year 5138
_MAX_STAMP: Final = 1e20
_UNITS_SINCE_1970: Final = (
    (1e14, "milliseconds"),
    (1e17, "microseconds"),
    (math.inf, "nanoseconds"),
)
_MIN_STEP_S: Final = Decimal("0.004")  # between two frames; the fastest LiDARs give 100 a second
_MAX_STEP_S: Final = 20  # between two frames; 20 ms or more are usual
_UNITS_OF_STEPS: Final = (
    (1e4, "milliseconds"),
    (1e7, "microseconds"),
    (math.inf, "nanoseconds"),
)
_MIN_STEPS: Final = 2
_GAP_STEPS: Final = 10  # typical steps that count as a gap
_MIN_GAP_S: Final = 2
_IN_SEQUENCE: Final = re.compile(r"(.*\D)(\d+)", re.ASCII)
_FIRST_NUMBERS: Final = (0, 1)  # of the first frame of a sequence
_NUMBER: Final = re.compile(r"(\d+)", re.ASCII)
_REMEDY: Final = "write lines like `000001 0.1`"
_NUMBER_REMEDY: Final = f"{_REMEDY}: name, then seconds as a number; no heading, no dates"


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingFiles:
    """Files of a recording."""

    folder: Path
    frames: tuple[ObjectFrame, ...]
    """Frames with an image or a cloud, sorted by name; each with its calibration."""
    times: Path | None


def is_recording(folder: Path) -> bool:
    """Whether a folder has images or clouds and a recording's calibration."""
    return _has_sensor(folder) and bool(
        _common_calibration(folder) or list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    )


def no_frames(folder: Path) -> Problem:
    """Problem of a recording without any image or cloud."""
    there = [f"{name}/" for name in (IMAGES, POINTS) if (folder / name).is_dir()]
    problem = "holds neither images/ nor points/"
    if there:
        problem = f"has no frames: there are no files in {' and '.join(there)}"
    remedy = "add images or clouds in the layout of docs/recordings.md"
    return Problem(path=folder, problem=problem, remedy=remedy)


def lacks_calibration(folder: Path) -> bool:
    """Whether a folder is a recording except for a missing calibration."""
    return _has_sensor(folder) and not is_recording(folder)


def unpaired(folder: Path, frames: Sequence[ObjectFrame]) -> Problem | None:
    """Problem of a recording in which no image has a cloud of the same name; else None.

    Recordings of a single sensor are no problem.
    """
    images = [frame.sample_id for frame in frames if frame.image]
    clouds = [frame.sample_id for frame in frames if frame.points]
    if not images or not clouds or set(images) & set(clouds):
        return None
    return Problem(
        path=folder,
        problem=f"has no image and cloud of one name: images are called {images[0]} .., clouds "
        f"{clouds[0]} ..",
        remedy="give the files of a frame one name",
    )


def unused_files(folder: Path, frames: Sequence[ObjectFrame]) -> list[tuple[Part, Problem]]:
    """Problems of labels, depth maps and calibrations that belong to no frame, with their part.

    A calibration.yaml is unused if every frame has a calibration of its own; files of the recording
    with other names than expected come first.
    """
    names = {frame.sample_id for frame in frames}
    places: tuple[tuple[Part, str, tuple[str, ...]], ...] = (
        ("objects", LABELS, PART_SUFFIXES["objects"]),
        ("depth", DEPTH, PART_SUFFIXES["depth"]),
        ("calibration", CALIBRATIONS, CALIBRATION_SUFFIXES),
    )
    problems: list[tuple[Part, Problem]] = [
        ("calibration", problem) for problem in misnamed_files(folder)
    ]
    common = _common_calibration(folder)
    if common is not None and all(frame.calibration != common for frame in frames):
        unread = Problem(
            path=common,
            problem=f"is not read: every frame has its own file in {CALIBRATIONS}",
            remedy=f"remove it, or the folder {CALIBRATIONS}",
        )
        problems.append(("calibration", unread))
    for part, place, suffixes in places:
        files = list_files(folder / place, suffixes)
        unused = [name for name in files if name not in names and not is_note(name)]
        if part == "calibration" and CALIBRATIONS in unused:
            problem = Problem(
                path=files[CALIBRATIONS],
                problem=f"is not read among calibrations of single frames in {CALIBRATIONS}",
                remedy=f"move it one folder up, into {folder}",
            )
            problems.append((part, problem))
            unused.remove(CALIBRATIONS)
        if unused and names:
            problem = Problem(
                path=folder / place,
                problem=f"has {len(unused)} of {len(files)} files that belong to no frame "
                f"({describe_absent(unused)}); frames are called {shortened(min(names))} ..",
                remedy="give them the names of their images and clouds, or move them away",
            )
            problems.append((part, problem))
    return problems


def order_doubt(folder: Path, frames: Sequence[ObjectFrame]) -> Problem | None:
    """Problem of names whose numbers have unequal lengths, so that 10 comes before 2.

    None if images and clouds have different names, which is the problem itself: `unpaired`.
    """
    if unpaired(folder, frames):
        return None
    names = [frame.sample_id for frame in frames]
    parts = [_NUMBER.split(name) for name in names]  # texts and numbers in turns
    if len({tuple(each[::2]) for each in parts}) > 1:
        return None
    is_late = [one > later for one, later in pairwise(map(_numbers_of, parts))]
    if not any(is_late):
        return None
    place = is_late.index(True)
    return Problem(
        path=folder,
        problem="has frames that are read in the order of their names as text: "
        f"{shortened(names[place + 1])} follows {shortened(names[place])}",
        remedy="write their numbers with leading zeros, if they are of one drive",
    )


def _numbers_of(parts: Sequence[str]) -> tuple[Fraction, ...]:
    """Numbers among the parts of a name; one behind a point is a fraction."""
    places = range(1, len(parts), 2)
    return tuple(
        Fraction(f"0.{parts[place]}" if parts[place - 1] == "." else parts[place])
        for place in places
    )


def misnamed_files(folder: Path) -> list[Problem]:
    """Problems of files that seem to be the calibration or the times, but have another name.

    Files in another format are reported only if the expected file is missing.
    """
    has_calibration = bool(
        _common_calibration(folder) or list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    )
    times = find_file(folder, TIMES_NAME)
    problems = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        name, suffix = path.name.lower(), path.suffix.lower()
        if not path.is_file():
            continue
        if name == TIMES_NAME:
            if times is not None and not path.samefile(times):
                problem, remedy = f"is not read: {times.name} has the same name", "keep one of them"
                problems.append(Problem(path=path, problem=problem, remedy=remedy))
            continue
        if name.startswith(_CALIBRATION_STARTS) and path.stem != CALIBRATIONS:
            is_format, has_other = suffix in CALIBRATION_SUFFIXES, has_calibration
            expected, suffixes = "calibration.yaml", (*CALIBRATION_SUFFIXES, ".txt", ".xml")
        elif name.startswith(_TIMES_STARTS):
            is_format, has_other, expected = suffix == ".txt", times is not None, TIMES_NAME
            suffixes = (".txt", ".csv", ".tsv", ".json", ".yaml")
        else:
            continue
        if suffix in suffixes and (is_format or not has_other):
            remedy = f"rename it to {expected}" if is_format else f"convert it to {expected}"
            problem = f"is not read: it has another name than {expected}"
            remedy = f"{remedy} (docs/recordings.md), or move it away"
            problems.append(Problem(path=path, problem=problem, remedy=remedy))
    return problems


def list_recording(folder: Path) -> RecordingFiles:
    """List a recording: images/NAME.jpg, points/NAME.pcd, calibration.yaml and optional files.

    Pictures have the suffix .png, .jpg or .jpeg, clouds .bin, .npy or .pcd, in any case. A
    calibration is calibration.yaml (or .yml, .json) for all frames, or calibration/NAME.yaml for
    each. Labels (KITTI's), depth (16-bit PNGs) and times.txt (in any case) are optional.
    """
    images = list_files(folder / IMAGES, IMAGE_SUFFIXES)
    clouds = list_files(folder / POINTS, CLOUD_SUFFIXES)
    labels, depths = list_files(folder / LABELS, (".txt",)), list_files(folder / DEPTH, (".png",))
    common = _common_calibration(folder)
    own = list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    return RecordingFiles(
        folder=folder,
        frames=tuple(
            ObjectFrame(
                sample_id=name,
                image=images.get(name),
                points=clouds.get(name),
                calibration=own.get(name, common),
                objects=labels.get(name),
                depth=depths.get(name),
            )
            for name in sorted({*images, *clouds})
        ),
        times=find_file(folder, TIMES_NAME),
    )


def _has_sensor(folder: Path) -> bool:
    return any((folder / name).is_dir() for name in (IMAGES, POINTS))


def _common_calibration(folder: Path) -> Path | None:
    return list_files(folder, CALIBRATION_SUFFIXES).get(CALIBRATIONS)


def read_times(path: Path) -> dict[str, Decimal]:
    """Read the lines "NAME SECONDS" of a times.txt exactly; floats of epoch seconds are inexact.

    Raises:
        FileError: A line is no name and time, contains an invisible character (including other line
            ends), or repeats the name of a frame.
    """
    times: dict[str, Decimal] = {}
    lines: dict[str, int] = {}
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip(" \t"):
            continue
        if not line.replace("\t", " ").isprintable():
            problem = f"line {number} holds invisible characters: {shortened(line, 40)}"
            raise FileError(path, problem, f"{_REMEDY}, each ended by a line feed")
        words = line.rsplit(maxsplit=1)
        if len(words) < 2:
            problem = f"line {number} has no frame name and time in seconds"
            raise FileError(path, problem, _REMEDY)
        name, seconds = words[0].strip(), words[1]
        (value,) = parse_numbers(
            [seconds], path, f"line {number}:", limit=_MAX_STAMP, remedy=_NUMBER_REMEDY
        )
        if abs(value) > _MAX_TIME_S:
            problem = f"line {number}: {seconds} is no time in seconds, probably in {_unit(value)}"
            raise FileError(path, problem, f"divide the times, and {_REMEDY}")
        if name in times:
            problem = f"line {number} repeats frame {shortened(name)} of line {lines[name]}"
            raise FileError(path, problem, "keep one line per frame")
        times[name], lines[name] = Decimal(seconds), number
    return times


def check_times(path: Path, frames: Sequence[str]) -> list[Problem]:
    """Find all problems of a times.txt: its own fault, else differences to the frames."""
    problems: list[Problem] = []
    times = read_or_note(read_times, path, problems)
    return problems if times is None else times_doubts(path, times, frames)


def times_doubts(path: Path, times: Mapping[str, Decimal], frames: Sequence[str]) -> list[Problem]:
    """Find differences between times and frames, gaps, and times that do not increase.

    Times between sequences, such as scene-0001-040 and scene-0002-000, may be any. A single shard
    has the times of all shards.

    Args:
        path: The file.
        times: Times of the file.
        frames: Names of all frames of the recording, in order.
    """
    known = set(frames)
    unknown = [name for name in times if name not in known]
    timed = [name for name in frames if name in times]
    untimed = [name for name in frames if name not in times]
    faults: list[tuple[str, str]] = []
    if not timed:
        found = f"frames are called {shortened(frames[0])} .." if frames else "there are no frames"
        names = f"it has {describe_absent(unknown)}" if unknown else "it is empty"
        faults.append((f"has no time of any frame: {names}, {found}", "give each frame a line"))
        unknown, untimed = [], []
    if unknown and not is_single_shard(path):
        problem = f"{len(unknown)} of {len(times)} lines name no frame ({describe_absent(unknown)})"
        remedy = "correct their names, or remove them"
        if (path.parent / MANIFEST_NAME).is_file():
            remedy = "run `sightline import` again, which was probably stopped, or remove them"
        faults.append((problem, remedy))
    if untimed:
        problem = (
            f"lacks a time of {len(untimed)} of {len(frames)} frames ({describe_absent(untimed)})"
        )
        faults.append((problem, "give each frame a line"))
    steps = doubtful_steps([(name, times[name]) for name in timed])
    if steps is not None:
        faults.append(steps)
    pairs = [pair for pair in pairwise(timed) if not begins_sequence(*pair)]
    not_rising = [after for before, after in pairs if times[after] <= times[before]]
    if not_rising:
        num_equal = sum(times[after] == times[before] for before, after in pairs)
        faults.append(
            (
                f"has times that do not rise from frame to frame: {len(not_rising)} of "
                f"{len(timed)}, {num_equal} of them equal, such as that of "
                f"{shortened(not_rising[0])}",
                "correct them, or number the frames in the order in which they were taken, with "
                "leading zeros",
            )
        )
    return [Problem(path=path, problem=problem, remedy=remedy) for problem, remedy in faults]


def begins_sequence(before: str, after: str) -> bool:
    """Whether a frame is the first of another sequence, by its name and that of the one before.

    The text before the last number differs, and this number is 0 or 1.
    """
    one, other = _IN_SEQUENCE.fullmatch(before), _IN_SEQUENCE.fullmatch(after)
    if one is None or other is None:
        return False
    return one[1] != other[1] and int(other[2]) in _FIRST_NUMBERS


def doubtful_steps(timed: Sequence[tuple[str, Decimal]]) -> tuple[str, str] | None:
    """Find times in another unit than seconds, and gaps within a sequence.

    Args:
        timed: Names and times [s] of frames, in order.

    Returns:
        The problem, in words that continue a sentence about the file, and the remedy. None: there
        is no doubt, or times do not rise.
    """
    steps = [
        (after[1] - before[1], before[0], after[0])
        for before, after in pairwise(timed)
        if not begins_sequence(before[0], after[0])
    ]
    if len(steps) < _MIN_STEPS or any(step <= 0 for step, _, _ in steps):
        return None
    middle = sorted(step for step, _, _ in steps)[len(steps) // 2]
    if middle >= _MAX_STEP_S:
        return (
            f"has frames that are {float(middle):.6g} s apart, so its times are probably in "
            f"{_unit_of_step(float(middle))}",
            "give seconds",
        )
    if middle < _MIN_STEP_S:
        return (
            f"has frames that are {float(middle):.3g} s apart, so its times are probably "
            "not in seconds",
            "give seconds",
        )
    gaps = [each for each in steps if each[0] >= max(_GAP_STEPS * middle, Decimal(_MIN_GAP_S))]
    if not gaps:
        return None
    longest, before, after = max(gaps)
    others = f" and {len(gaps) - 1} more" if len(gaps) > 1 else ""
    names = f"{shortened(before)} and {shortened(after)}"
    return (
        f"has a gap of {float(longest):.6g} s between {names}{others}; "
        f"other frames are {float(middle):.3g} s apart",
        "correct the times if they are wrong; else give the parts as recordings of their own, as "
        "alarms and tracks go on over a gap",
    )


def _unit(value: float) -> str:
    """Unit of a time since 1970 that is too large for seconds."""
    return next(name for limit, name in _UNITS_SINCE_1970 if abs(value) < limit)


def _unit_of_step(step: float) -> str:
    """Unit of the time between two frames that is too large for seconds."""
    return next(name for limit, name in _UNITS_OF_STEPS if step < limit)
