"""Doubts about a raw drive's calibration: implausible, for other images, or another one unread."""

from pathlib import Path
from typing import Final

from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    CalibrationMatrices,
    check_matrices,
    have_same_values,
    read_stated_size,
)
from sightline.data.layouts.kitti_trees import RAW_CALIBRATION, day_folders
from sightline.files.problem import FileError, Problem, read_or_note

_MAX_OTHER_SIZE_PX: Final = 4  # KITTI's own drives differ by nothing


def drive_matrices_doubts(
    matrices: CalibrationMatrices, folder: Path, image: Path | None
) -> list[Problem]:
    """Find implausible values in a raw drive's calibration, or that it is for other images.

    Args:
        matrices: Matrices as read.
        folder: Folder of the calibration files.
        image: The drive's first image; None: it has none.
    """
    path = folder / RAW_CALIBRATION[0]
    size = read_or_note(read_image_size, image, [])
    doubts = check_matrices(matrices, size, path)
    if image is None or size is None or doubts != check_matrices(matrices, None, path):
        return doubts  # no size, or one that is doubted
    return doubts + _stated_size_doubt(path, image, size)


def unread_calibration(drive: Path, calibration: Path) -> list[Problem]:
    """Find files of a raw drive's other calibrations: its own, or those of the day.

    Args:
        drive: Folder of the drive.
        calibration: Folder that all of the calibration is read from: the drive's or the day's.

    Returns:
        Problems of the drive's own files where all are read from the day's folder, and of read
        files whose values differ from those of another folder of the day.
    """
    problems = []
    if calibration != drive:
        problems = [
            Problem(
                path=drive / name,
                problem="is not read: the drive's folder has no calib_cam_to_cam.txt, so all of "
                f"the calibration is taken from {calibration}",
                remedy="move it there, or lay the other files beside it",
            )
            for name in RAW_CALIBRATION
            if (drive / name).is_file()
        ]
    pairs = [
        (calibration / name, day / name) for day in day_folders(drive) for name in RAW_CALIBRATION
    ]
    differing = [
        Problem(
            path=own,
            problem=f"is used, but {other}, one folder up, has other values and is not read",
            remedy="remove the wrong one of the two",
        )
        for own, other in pairs
        if own != other and own.is_file() and other.is_file() and not have_same_values(own, other)
    ]
    return problems + differing


def _stated_size_doubt(path: Path, image: Path, size: tuple[int, int]) -> list[Problem]:
    """Compare an image with the size of rectified images that the calibration states."""
    try:
        rectified = read_stated_size(path, "S_rect_02")
        unrectified = read_stated_size(path, "S_02")
    except FileError as error:
        return [error.problem]
    if rectified is None or _is_close(size, rectified):
        return []
    problem = (
        f"is {_named(size)} (width x height), but S_rect_02 of {path} states {_named(rectified)} "
        "for rectified images"
    )
    remedy = (
        "if images were resized or cropped, let P_rect_02 and S_rect_02 both be of their new size; "
        "else take the images of this calibration"
    )
    if unrectified is not None and _is_close(size, unrectified):
        problem += "; as it has the size S_02, it is probably not rectified"
        remedy = "take the images of the _sync drive, or rectify these"
    return [Problem(path=image, problem=problem, remedy=remedy)]


def _is_close(size: tuple[int, int], other: tuple[int, int]) -> bool:
    return max(abs(size[0] - other[0]), abs(size[1] - other[1])) <= _MAX_OTHER_SIZE_PX


def _named(size: tuple[int, int]) -> str:
    return f"{size[1]}x{size[0]}"
