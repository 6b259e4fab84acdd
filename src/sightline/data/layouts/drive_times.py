"""Timestamps of a raw drive's frames, and doubts about them."""

import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.layouts.kitti_trees import DriveFiles
from sightline.data.layouts.recording_files import doubtful_steps
from sightline.files.plain_text import REMEDY, read_text, shortened
from sightline.files.problem import FileError, Problem

_TIME_DIGITS: Final = 9  # decimals of seconds: nanoseconds
_TIME: Final = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(\.\d+)?", re.ASCII)
_MAX_OFFSET_S: Final = 0.05  # between an image and its sweep, as in imports; half a sweep at 10 Hz
_CLOCK_SPREAD_S: Final = 0.02  # of offsets that are the difference of two clocks

_Moment = tuple[datetime, float]
"""Whole seconds and the fraction of nine digits, too many for a datetime."""


def read_timestamps(path: Path | str) -> Float64[np.ndarray, " num_frames"]:
    """Read lines such as "2011-09-26 13:02:25.964389445" as seconds since the first line.

    The seconds are rounded to nanoseconds, the precision of the file. Empty lines are left out.

    Raises:
        FileError: A line is no date with a time.
    """
    moments = [each for each in _read_moments(path) if each is not None]
    return _seconds_since(moments[0], moments) if moments else np.zeros(0)


def drive_times(files: DriveFiles) -> tuple[float, ...] | None:
    """Seconds since a raw drive's first frame, by the frames' numbers; None: there is no such file.

    Raises:
        FileError: The file cannot be read, or has too few times.
    """
    moments = _drive_moments(files)
    return None if moments is None else tuple(_seconds_since(moments[0], moments).tolist())


def check_drive_times(files: DriveFiles) -> list[Problem]:
    """Find problems of a raw drive's times: unreadable, not rising, or images apart from sweeps."""
    try:
        times = drive_times(files)
    except FileError as error:
        return [error.problem]
    return [] if times is None else drive_times_doubts(files, times)


def drive_times_doubts(files: DriveFiles, times: Sequence[float]) -> list[Problem]:
    """Find times that do not rise, gaps between frames, and images taken apart from their sweeps.

    Args:
        files: Files of the drive.
        times: Result of `drive_times`.
    """
    doubts = (_steps_doubt(files, times), _camera_doubt(files))
    return [doubt for doubt in doubts if doubt is not None]


def _steps_doubt(files: DriveFiles, times: Sequence[float]) -> Problem | None:
    if files.timestamps is None:
        return None
    not_rising = [place for place in range(1, len(times)) if times[place] <= times[place - 1]]
    if not not_rising:
        names = [frame.sample_id for frame in files.frames]
        steps = doubtful_steps(list(zip(names, map(Decimal, times), strict=True)))
        if steps is None:
            return None
        return Problem(path=files.timestamps, problem=steps[0], remedy=steps[1])
    return Problem(
        path=files.timestamps,
        problem=f"has times that do not rise from frame to frame: {len(not_rising)} of "
        f"{len(times)}, such as that of {files.frames[not_rising[0]].sample_id}",
        remedy="correct them, or number the frames in the order in which they were taken",
    )


def _camera_doubt(files: DriveFiles) -> Problem | None:
    """Problem of images that were taken long before or after their sweeps; else None."""
    if files.timestamps is None or files.image_timestamps is None:
        return None
    try:
        images = _moments_of_frames(files.image_timestamps, files)
    except FileError as error:
        return error.problem
    sweeps = _moments_of_frames(files.timestamps, files)
    pairs = [
        (frame.sample_id, image, sweep)
        for frame, image, sweep in zip(files.frames, images, sweeps, strict=True)
        if frame.image and frame.points and image is not None and sweep is not None
    ]
    if not pairs:
        return None
    names, paired_images, paired_sweeps = zip(*pairs, strict=True)
    origin = paired_sweeps[0]
    offsets = _seconds_since(origin, paired_images) - _seconds_since(origin, paired_sweeps)
    far = np.flatnonzero(abs(offsets) > _MAX_OFFSET_S)
    if not len(far):
        return None
    worst = far[abs(offsets[far]).argmax()]
    order = "after" if offsets[worst] > 0 else "before"
    name = shortened(names[worst])
    found = (
        f"{len(far)} of {len(pairs)} images were taken more than {_MAX_OFFSET_S} s apart from "
        f"their sweeps by {files.timestamps}, that of {name} {abs(offsets[worst]):.3g} s {order}"
    )
    remedy = "number each image as the sweep nearest in time"
    if len(far) == len(pairs) and np.ptp(offsets[far]) < _CLOCK_SPREAD_S:
        remedy = f"correct the times if two clocks differ; else {remedy}"
    return Problem(path=files.image_timestamps, problem=found, remedy=remedy)


def _drive_moments(files: DriveFiles) -> list[_Moment] | None:
    """Times of the frames: their sweeps', or their images' where a sweep was lost."""
    if files.timestamps is None:
        return None
    moments = _moments_of_frames(files.timestamps, files)
    if None in moments and files.image_timestamps is not None:
        images = _moments_of_frames(files.image_timestamps, files)
        moments = [own or image for own, image in zip(moments, images, strict=True)]
    timed = [each for each in moments if each is not None]
    if len(timed) < len(moments):
        lost = files.frames[moments.index(None)].sample_id
        raise FileError(
            files.timestamps,
            f"has no time of {len(moments) - len(timed)} of {len(moments)} frames: the line of "
            f"{shortened(lost)} is empty",
            "write the times of their images there, or remove these frames",
        )
    return timed


def _moments_of_frames(path: Path, files: DriveFiles) -> list[_Moment | None]:
    """Times of the frames in a file; None: the line is empty, as KITTI's of a lost sweep."""
    moments = _read_moments(path)
    sample_ids = [frame.sample_id for frame in files.frames]
    num_times = sum(each is not None for each in moments)
    last = max((place for place, each in enumerate(moments, start=1) if each), default=0)
    for lines in (moments[:last], moments):  # empty ones at the end may be of lost sweeps, or none
        if len(lines) == len(sample_ids):
            return lines
    # KITTI has a line for every number, also for lost frames.
    numbers = [int(name) if name.isascii() and name.isdecimal() else -1 for name in sample_ids]
    if not 0 <= min(numbers) <= max(numbers) < len(moments):
        raise FileError(
            path,
            f"holds {num_times} times, expected one for each of the {len(sample_ids)} frames, "
            "or for each number up to the last",
            "extract the drive again",
        )
    return [moments[number] for number in numbers]


def _read_moments(path: Path | str) -> list[_Moment | None]:
    """Read a time a line; None: an empty line."""
    moments: list[_Moment | None] = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        if not line.strip():
            moments.append(None)
            continue
        try:
            moments.append(_parse_time(line.strip()))
        except ValueError as error:
            raise FileError(
                path,
                f"line {number}: '{shortened(line.strip(), 40)}' is no time, expected one such as "
                "2011-09-26 13:02:25.964389445",
                REMEDY,
            ) from error
    return moments


def _parse_time(text: str) -> _Moment:
    match = _TIME.fullmatch(text)
    if match is None:
        raise ValueError
    return datetime.fromisoformat(match[1]), float(match[2] or 0)


def _seconds_since(
    origin: _Moment, moments: Sequence[_Moment]
) -> Float64[np.ndarray, " num_frames"]:
    start, fraction = origin
    since = [(moment - start).total_seconds() + part - fraction for moment, part in moments]
    return np.round(np.array(since), _TIME_DIGITS)
