"""Check of a few frames by the rules of `check` when a data set is opened."""

import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from sightline.data.between_frames import check_repeats
from sightline.data.depth_tree import DepthFrame
from sightline.data.drive_tree import DriveFrame
from sightline.data.frame_checks import Findings
from sightline.data.object_tree import CORRUPTED, ObjectFrame, Part
from sightline.data.unread_files import PartFolder, find_twins, find_unread
from sightline.files.problem import FileError, Problem
from sightline.jobs.output_dirs import KITTI_SPLITS

_DRAWN: Final = 3  # number of frames: the first, and others spread over the rest
_STACK: Final = 4  # stack level of the caller that opens the data set

Item = TypeVar("Item")
Frame = TypeVar("Frame", ObjectFrame, DepthFrame, DriveFrame)


def judge_folders(folders: Sequence[PartFolder], parts: Collection[Part]) -> None:
    """Warn of ignored files, by number and kind, and of files hidden by another one.

    Args:
        folders: Folders of the data set.
        parts: Parts of the samples to use.

    Raises:
        FileError: A folder of a used part contains files, but all of them are ignored.
    """
    for unread in find_unread(folders):
        if unread.part not in parts:
            continue
        if unread.is_all:
            problem = unread.problem
            raise FileError(problem.path, problem.problem, problem.remedy)
        warnings.warn(str(unread.problem), stacklevel=_STACK)
    for place in folders:
        twins = find_twins(place) if place.part in parts else []
        if twins:
            more = f" ({len(twins)} like it)" if len(twins) > 1 else ""
            warnings.warn(f"{twins[0]}{more}", stacklevel=_STACK)


def judge_frames(
    root: Path,
    frames: Sequence[Frame],
    examine: Callable[[Frame], Findings],
    parts: Collection[Part],
    *,
    shared: Sequence[Problem] = (),
) -> None:
    """Check the first frame and a few others, always the same ones.

    Unreadable files are not reported here: their reader names them later.

    Args:
        root: The data set's folder.
        frames: Frames to use, in order.
        examine: Function of `check` that examines a frame.
        parts: Parts of the samples to use; calibrations are always used.
        shared: Doubts about data shared by all frames.

    Raises:
        FileError: A sweep is not in metres, or has reflectances outside 0 to 1.
    """
    drawn = [_with_parts(frame, parts) for frame in draw(frames)]
    findings: list[Findings] = [examine(frame) for frame in drawn]
    for problem in (problem for found in findings for problem in found.refused):
        raise FileError(problem.path, problem.problem, problem.remedy)
    doubts = [*shared, *(each for found in findings for each in (*found.doubted, *found.hollow))]
    doubts += [] if _is_corrupted(root) else check_repeats(drawn)
    _warn_of_doubts(doubts, len(drawn))
    _warn_of_nothing(root, drawn, findings)


def _points_file(frame: ObjectFrame | DepthFrame | DriveFrame) -> Path | None:
    return frame.sparse if isinstance(frame, DepthFrame) else frame.points


def _is_corrupted(root: Path) -> bool:
    return any((root / split / CORRUPTED).is_dir() for split in ("", *KITTI_SPLITS))


def _warn_of_doubts(doubts: Sequence[Problem], num_looked_at: int) -> None:
    for problem, count in _grouped(doubts):
        more = f" ({count} like it in {num_looked_at} frames looked at)" if count > 1 else ""
        warnings.warn(f"{problem}{more}; see all by: sightline check", stacklevel=_STACK + 1)


def draw(items: Sequence[Item]) -> list[Item]:
    """Select the first, the last and one item between, always the same ones."""
    last = len(items) - 1
    places = sorted({round(last * share / (_DRAWN - 1)) for share in range(_DRAWN)})
    return [items[place] for place in places] if items else []


def _with_parts(frame: Frame, parts: Collection[Part]) -> Frame:
    """Remove the files of unused parts from a frame."""
    if isinstance(frame, DepthFrame):
        return replace(frame, image=frame.image if "image" in parts else None)
    image = frame.image if "image" in parts else None
    points = frame.points if "points" in parts else None
    if isinstance(frame, DriveFrame):
        return replace(frame, image=image, points=points)
    return replace(
        frame,
        image=image,
        points=points,
        objects=frame.objects if "objects" in parts else None,
        depth=frame.depth if "depth" in parts else None,
    )


def _grouped(problems: Sequence[Problem]) -> list[tuple[Problem, int]]:
    """Group problems by kind: the first one of each kind and their number."""
    by_kind: dict[tuple[Path, str], list[Problem]] = {}
    for problem in problems:
        by_kind.setdefault((problem.path.parent, problem.remedy), []).append(problem)
    return [(alike[0], len(alike)) for alike in by_kind.values()]


def _warn_of_nothing(root: Path, drawn: Sequence[Frame], findings: Sequence[Findings]) -> None:
    """Warn if every checked frame lacks the data of a sensor.

    Corrupted data sets are exempt: they lack it on purpose.
    """
    if _is_corrupted(root):
        return
    images = [
        found.has_dark_image
        for frame, found in zip(drawn, findings, strict=True)
        if frame.image is not None and not found.unreadable
    ]
    sweeps = [
        found.has_empty_sweep
        for frame, found in zip(drawn, findings, strict=True)
        if _points_file(frame) is not None and not found.unreadable
    ]
    for what, empty in (("images are of one colour", images), ("sweeps have no point", sweeps)):
        if empty and all(empty):
            problem = Problem(
                path=root,
                problem=f"all {len(empty)} {what} of the frames looked at",
                remedy="look whether the sensor delivered anything; see all by: sightline check",
            )
            warnings.warn(str(problem), stacklevel=_STACK)
