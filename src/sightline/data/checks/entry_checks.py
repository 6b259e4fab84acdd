"""Check of a few frames by the rules of `check` when a data set is opened."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final, TypeVar

from sightline.data.checks.between_frames import check_orientations, check_repeats
from sightline.data.checks.frame_checks import Findings, examine_image
from sightline.data.checks.unread_files import PartFolder, find_name_clashes, find_unread
from sightline.data.layouts.kitti_trees import CORRUPTED, DepthFrame, DriveFrame, ObjectFrame, Part
from sightline.files.problem import FileError, Problem
from sightline.geometry.picture_checks import GREY_DOUBT
from sightline.geometry.user_warning import warn_user
from sightline.jobs.output_dirs import KITTI_SPLITS

_NUM_CHECKED_FRAMES: Final = 3  # number of frames: the first, and others spread over the rest

Item = TypeVar("Item")
Frame = TypeVar("Frame", ObjectFrame, DepthFrame, DriveFrame)


def warn_of_unread_files(folders: Sequence[PartFolder], parts: Collection[Part]) -> None:
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
        if unread.all_unread:
            problem = unread.problem
            raise FileError(problem.path, problem.problem, problem.remedy)
        warn_user(str(unread.problem))
    clashes = find_name_clashes(place for place in folders if place.part in parts)
    for _, group in groupby(clashes, key=lambda clash: clash.path.parent):
        first, *others = group
        more = f" ({len(others) + 1} like it)" if others else ""
        warn_user(f"{first}{more}")


def check_sample_frames(
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
    selected = [_with_parts(frame, parts) for frame in select_spread(frames)]
    findings: list[Findings] = [examine(frame) for frame in selected]
    for problem in (problem for found in findings for problem in found.impossible):
        raise FileError(problem.path, problem.problem, problem.remedy)
    doubts = [
        *shared,
        *(each for found in findings for each in found.doubts()),
    ]
    doubts += [] if is_corrupted(root) else check_repeats(selected)
    doubts += [] if is_corrupted(root) else check_orientations(selected)
    _warn_of_doubts(doubts, len(selected))
    _warn_of_missing_data(root, selected, findings)


def _points_file(frame: ObjectFrame | DepthFrame | DriveFrame) -> Path | None:
    return frame.sparse if isinstance(frame, DepthFrame) else frame.points


def is_corrupted(root: Path) -> bool:
    """Whether `sightline corrupt` wrote a data tree, which may lack data on purpose."""
    return any((root / split / CORRUPTED).is_dir() for split in ("", *KITTI_SPLITS))


def _warn_of_doubts(doubts: Sequence[Problem], num_checked: int) -> None:
    for problem, count in _grouped(doubts):
        more = f" ({count} like it in {num_checked} checked frames)" if count > 1 else ""
        warn_user(f"{problem}{more}; see all by: sightline check")


def describe_grey(images: Iterable[Path | None]) -> tuple[str, ...]:
    """Note that images are grey, if the first and a few others all are."""
    greys = []
    for image in select_spread([each for each in images if each is not None]):
        found = Findings()
        examine_image(image, found)
        greys += [] if found.unreadable else [found.has_grey_image]
    return (GREY_DOUBT,) if greys and all(greys) else ()


def select_spread(items: Sequence[Item]) -> list[Item]:
    """Select the first, the last and one item between, always the same ones."""
    last = len(items) - 1
    places = sorted(
        {round(last * share / (_NUM_CHECKED_FRAMES - 1)) for share in range(_NUM_CHECKED_FRAMES)}
    )
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


def _warn_of_missing_data(
    root: Path, selected: Sequence[Frame], findings: Sequence[Findings]
) -> None:
    """Warn if every checked frame lacks the data of a sensor.

    Corrupted data sets are exempt: they lack it on purpose.
    """
    if is_corrupted(root):
        return
    images = [
        found.has_blank_image
        for frame, found in zip(selected, findings, strict=True)
        if frame.image is not None and not found.unreadable
    ]
    sweeps = [
        found.has_empty_sweep
        for frame, found in zip(selected, findings, strict=True)
        if _points_file(frame) is not None and not found.unreadable
    ]
    greys = [found.has_grey_image for found in findings if not found.unreadable]
    if greys and all(greys):
        warn_user(f"{root}: checked {GREY_DOUBT}")
    for fault, empty in (("images have a single colour", images), ("sweeps are empty", sweeps)):
        if empty and all(empty):
            problem = Problem(
                path=root,
                problem=f"all {len(empty)} {fault} in the checked frames",
                remedy="check whether the sensor delivered data; see all by: sightline check",
            )
            warn_user(str(problem))
