"""Size of a camera's images where no picture gives it: a guess by the principal point."""

from collections.abc import Sequence
from pathlib import Path

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.layouts.kitti_trees import DriveFrame, ObjectFrame
from sightline.files.problem import Problem, read_or_note
from sightline.geometry.calibration import centred_image_size
from sightline.geometry.user_warning import warn_user


def recording_size_doubt(frames: Sequence[ObjectFrame]) -> Problem | None:
    """Problem of a recording whose image size is guessed; None: images or calibrations give it."""
    if any(frame.image or frame.depth for frame in frames):
        return None
    for path in dict.fromkeys(frame.calibration for frame in frames):
        calibration = read_or_note(read_recording_calibration, path, [])
        if path is not None and calibration is not None and calibration.image_size is None:
            size = _guess(calibration.matrices)
            problem = f"has no image_size, and there are no images: {size} is guessed by the "
            problem += "principal point, and boxes and depth end at that border"
            return Problem(path=path, problem=problem, remedy="give the image_size of the camera")
    return None


def describe_guessed_size(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame], matrices: CalibrationMatrices | None
) -> tuple[str, ...]:
    """Describe the guessed image size of a tree in a clause; empty: pictures give the size.

    Args:
        frames: All frames of the tree.
        matrices: Calibration of the first frame; None: it is unreadable, and reported elsewhere.
    """
    files = (file for each in frames for file in (each.image, getattr(each, "depth", None)))
    if matrices is None or any(files):
        return ()
    return (
        f"no images: their size is guessed by the principal point, {_guess(matrices)} in the "
        "first frame, and boxes and depth end at that border",
    )


def warn_of_guessed_size(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame],
    matrices: CalibrationMatrices | None,
    folder: Path,
) -> None:
    """Warn of the guessed image size of a tree; see `describe_guessed_size`."""
    for description in describe_guessed_size(frames, matrices):
        warn_user(
            f"{folder}: {description}; add the images, or make the data a recording with "
            "image_size (docs/recordings.md)",
        )


def _guess(matrices: CalibrationMatrices) -> str:
    height, width = centred_image_size(matrices.image_from_camera)
    return f"{height}x{width} (height x width)"
