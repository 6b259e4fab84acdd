"""Checks of a recording: files readable, values plausible, files consistent with each other."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from sightline.data.checks.frame_checks import (
    Findings,
    check_depth_fit,
    examine_depth,
    examine_image,
)
from sightline.data.checks.guessed_size import recording_size_doubt
from sightline.data.checks.label_checks import check_objects
from sightline.data.checks.label_fit import check_label_fit
from sightline.data.checks.lidar_mount import (
    describe_lack_of_points,
    describe_mount,
    describe_unknown_tilt,
    frames_with_clouds,
    has_points,
    mount_doubts_of_recording,
    pose_of_recording,
)
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import check_matrices
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.pixels import is_in_view
from sightline.data.formats.point_files import checked_cloud, cloud_rows, read_cloud
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    require_usable,
)
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.data.layouts.recording_files import DEPTH
from sightline.files.problem import FileError, Problem, read_or_note
from sightline.geometry.cloud_checks import hollow_doubt
from sightline.geometry.echoes import describe_losses, echoes
from sightline.geometry.intensity_checks import intensity_doubt
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.mount import (
    has_too_few_in_image,
    mount_doubt,
    resolution_doubt,
)
from sightline.geometry.mount_axes import axes_doubt
from sightline.geometry.road_height import LidarPose, describe_odd_height

CALIBRATION_REMEDY = (
    "correct the calibration file, or both clouds and calibration if both have another "
    "convention; see docs/recordings.md"
)
_VIEW_REMEDY = (
    f"{CALIBRATION_REMEDY}; where other frames of this camera fit, this point cloud is a part of a "
    "turn or of another time: leave its frame out"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingView:
    """Agreement of a frame's cloud and image."""

    sample_id: str
    share: float
    """Share of the points inside the image, 0 to 1."""
    size: tuple[int, int]
    """Height, width [px] of the image."""
    doubt: Problem | None
    """Implausibility with the likely cause."""
    is_turned: bool
    """True if the road shows that the z axis of the cloud does not point up."""

    def __str__(self) -> str:
        """Format the share in one clause."""
        share = f"{100 * self.share:.1f} % of the points of frame {self.sample_id}"
        return f"{share} fall into the image"


def first_complete_frame(frames: Sequence[ObjectFrame]) -> ObjectFrame | None:
    """Find the first frame with a cloud and a calibration, preferably with an image."""
    with_points = [each for each in frames if each.points and each.calibration]
    return next((each for each in with_points if each.image), next(iter(with_points), None))


def view_of_drive(frames: Sequence[ObjectFrame]) -> RecordingView | None:
    """Agreement of the first frame with points, or of a later one if most of some fit better.

    A drive's first sweep may be empty, or a part of a turn.
    """
    some = (*frames_with_clouds(frames), *frames_with_clouds(frames[::-1]))
    tried = dict.fromkeys([first_complete_frame(frames), *some])
    views = (view for each in tried if (view := view_of_recording(each)) is not None)
    first = next(views, None)
    if first is None or first.doubt is None:
        return first
    others = list(views)
    sound = [each for each in others if each.doubt is None]
    return sound[0] if 2 * len(sound) > len(others) + 1 else first


def view_of_recording(frame: ObjectFrame | None) -> RecordingView | None:
    """Agreement of a frame's parts; None: it lacks a part, has no point, or is unreadable."""
    if frame is None or frame.points is None or frame.calibration is None:
        return None
    try:
        calibration = read_recording_calibration(frame.calibration)
        size = calibration.image_size if frame.image is None else read_image_size(frame.image)
        points = read_cloud(frame.points, calibration.max_intensity)
    except FileError:
        return None  # the reader of the frame reports it
    if size is None or not len(points):
        return None
    matrices = calibration.matrices
    shown = is_in_view(points, matrices.image_from_camera @ matrices.camera_from_lidar, size)
    num_shown = int(np.count_nonzero(shown))
    share = num_shown / len(points)
    axes = axes_doubt(points, matrices.camera_from_lidar)
    problem, remedy = _doubt(calibration, size), CALIBRATION_REMEDY
    if problem is None and has_too_few_in_image(num_shown, len(points)):
        problem = (
            f"projects only {num_shown} of the {len(points)} points of frame {frame.sample_id} "
            f"into the image of {size[0]}x{size[1]} (height x width)"
        )
        remedy = _VIEW_REMEDY
    return RecordingView(
        sample_id=frame.sample_id,
        share=share,
        size=size,
        is_turned=axes is not None,
        doubt=(
            Problem(path=frame.points, problem=axes[0], remedy=axes[1])
            if axes is not None
            else None
            if problem is None
            else Problem(path=frame.calibration, problem=problem, remedy=remedy)
        ),
    )


class RecordingDescription(NamedTuple):
    """Agreement of a recording's parts and its LiDAR's mount."""

    clauses: tuple[str, ...]
    doubts: tuple[Problem, ...] = ()
    """Settings of the calibration that the clouds contradict."""


def describe_recording(frames: Sequence[ObjectFrame]) -> RecordingDescription:
    """Describe the agreement of a recording's parts and its LiDAR's height, in a clause each."""
    first = first_complete_frame(frames)
    view = view_of_drive(frames)
    calibration = (
        None if first is None else read_or_note(read_recording_calibration, first.calibration, [])
    )
    guessed = recording_size_doubt(frames)
    sizes = () if guessed is None else (guessed,)
    described = [] if view is None else [str(view)]
    if is_without_camera(frames):
        described.append("no images: the image_size of the calibration is used")
    described += _describe_losses(frames)
    if calibration is None or first is None or first.calibration is None:
        return RecordingDescription(tuple(described), sizes)
    if not has_points(frames):
        described.append(f"warning: {describe_lack_of_points(frames)}")
    has_other_axes = view is not None and view.is_turned
    unknown = LidarPose(height_m=None, tilt=None)
    pose = unknown if has_other_axes else pose_of_recording(frames, calibration)
    source = "by the road in its clouds" if calibration.lidar_tilt is None else "by its calibration"
    described += describe_mount(calibration.matrices, pose.tilt, source)
    if not has_other_axes:
        unknown_tilt = describe_unknown_tilt(frames, calibration, pose)
        described += (f"warning: {each}" for each in unknown_tilt)
    doubts = mount_doubts_of_recording(frames, calibration)
    if calibration.lidar_height_m is not None and pose.height_m is not None and not doubts:
        described.append(
            f"lidar_height_m is {calibration.lidar_height_m:g}; by the road in its clouds the "
            f"LiDAR is {pose.height_m:.2f} m above it"
        )
    lowness = "" if pose.height_m is None else describe_odd_height(pose.height_m)
    is_told = pose.height_m is not None or (has_points(frames) and not has_other_axes)
    if calibration.lidar_height_m is None and is_told:
        described.append(
            f"warning: its clouds show too little of the road to find the LiDAR's height above "
            f"it: KITTI's {KITTI_LIDAR_HEIGHT_M} m is assumed; give lidar_height_m"
            if pose.height_m is None
            else f"{'warning: ' if lowness else ''}by the road in its clouds the LiDAR is "
            f"{pose.height_m:.2f} m above it{lowness}"
        )
    problems = (
        Problem(path=first.calibration, problem=each.problem, remedy=each.remedy) for each in doubts
    )
    return RecordingDescription(tuple(described), (*sizes, *problems))


def is_without_camera(frames: Sequence[ObjectFrame]) -> bool:
    """Test for a recording of a LiDAR alone: no image, and an image size in each calibration."""
    if not frames or any(each.image or not (each.points and each.calibration) for each in frames):
        return False
    paths = dict.fromkeys(each.calibration for each in frames)
    read = [read_or_note(read_recording_calibration, path, []) for path in paths]
    return all(each is not None and each.image_size is not None for each in read)


def _describe_losses(frames: Sequence[ObjectFrame]) -> tuple[str, ...]:
    """Describe the points without an echo in some clouds, in a clause; empty: none."""
    read = [read_or_note(cloud_rows, frame.points, []) for frame in frames_with_clouds(frames)]
    return describe_losses([cloud for cloud in read if cloud is not None])


def check_recording_calibration(path: Path, image: Path | None) -> list[Problem]:
    """Check a calibration file, also against its first image, if there is one."""
    problems: list[Problem] = []
    calibration = read_or_note(read_recording_calibration, path, problems)
    if calibration is None:
        return problems
    size = read_or_note(read_image_size, image, []) or calibration.image_size
    return calibration_problems(calibration, size, path)


def calibration_problems(
    calibration: RecordingCalibration, size: tuple[int, int] | None, path: Path
) -> list[Problem]:
    """Find the faults of a calibration.

    Args:
        calibration: Calibration as read.
        size: Height, width [px] of its images, if known.
        path: File of the calibration.
    """
    try:
        require_usable(calibration, size)
    except ValueError as error:
        return [Problem(path=path, problem=str(error), remedy=CALIBRATION_REMEDY)]
    doubt = _doubt(calibration, size)
    if doubt is not None:
        return [Problem(path=path, problem=doubt, remedy=CALIBRATION_REMEDY)]
    return check_matrices(
        calibration.matrices, size, path, tilt=calibration.lidar_tilt, remedy=CALIBRATION_REMEDY
    )


def _doubt(calibration: RecordingCalibration, size: tuple[int, int] | None) -> str | None:
    """Find implausible values of a calibration, also with the size of its images."""
    level = np.eye(4) if calibration.lidar_tilt is None else calibration.lidar_tilt.level_from_lidar
    doubt = mount_doubt(calibration.matrices.camera_from_lidar @ level.T)
    if doubt is not None:
        return f"camera_from_lidar {doubt}"
    scale = None if size is None else resolution_doubt(calibration.matrices.image_from_camera, size)
    return None if scale is None else f"camera_matrix {scale}"


def examine_recording_frame(frame: ObjectFrame, *, reference: Path | None) -> Findings:
    """Examine one frame; absent parts and its calibration are not reported.

    Args:
        frame: Frame of the recording.
        reference: First image of the same calibration; see `reference_images`.
    """
    found = Findings()
    calibration = read_or_note(read_recording_calibration, frame.calibration, [])
    image = examine_image(frame.image, found)
    depth_m = examine_depth(frame.depth, found)
    # without a calibration, the limit of intensities is unknown
    max_intensity = math.inf if calibration is None else calibration.max_intensity
    points, is_hollow = _examine_cloud(frame.points, max_intensity, found)
    objects = read_or_note(read_labels, frame.objects, found.unreadable)
    size = None if image is None else (image.shape[0], image.shape[1])
    others_fit = found.is_consistent
    if objects is not None and frame.objects is not None:
        found.implausible += check_objects(objects, size, frame.objects)
    if calibration is None:
        return found
    # Depth has the image's size, and replaces a missing image.
    pictures = ((frame.image, size), (frame.depth, None if depth_m is None else depth_m.shape))
    for path, shape in pictures:
        mismatch = size_mismatch(path, shape, calibration, reference) if path and shape else None
        if mismatch is not None:
            found.implausible.insert(0, mismatch)  # may be the cause of boxes beyond the image
            return found
    if not others_fit or is_hollow:
        return found
    mismatches: list[Problem] = []
    view = view_of_recording(frame)
    if view is not None and view.doubt is not None:
        # A calibration's own faults are reported once for all frames.
        if view.doubt.path == frame.points or _doubt(calibration, view.size) is None:
            mismatches.append(view.doubt)
    elif depth_m is not None and frame.depth is not None and points is not None:
        image_from_lidar = (
            calibration.matrices.image_from_camera @ calibration.matrices.camera_from_lidar
        )
        mismatches += check_depth_fit(depth_m, points, image_from_lidar, frame.depth)
    if not mismatches and objects is not None and frame.objects is not None:
        mismatches += check_label_fit(objects, calibration.matrices, size, points, frame.objects)
    found.implausible += mismatches
    return found


def _examine_cloud(
    path: Path | None, max_intensity: float, found: Findings
) -> tuple[Float32[np.ndarray, "_num_points 4"] | None, bool]:
    """Read and examine a cloud; None: it is absent or unreadable. Also returns if it is hollow."""
    rows = read_or_note(cloud_rows, path, found.unreadable)
    if rows is None or path is None:
        return None, False
    check = partial(checked_cloud, rows, max_intensity)
    points = read_or_note(check, path, found.unreadable)
    if points is None:
        return None, False
    found.has_empty_sweep = not len(points)
    hollow = _check_hollow(points, path)
    found.nearly_empty += hollow
    if not hollow:
        found.doubtful_intensities += _check_intensities(echoes(rows), max_intensity, path)
    return points, bool(hollow)


def _check_intensities(
    points: Float32[np.ndarray, "_num_points 4"], max_intensity: float, path: Path
) -> list[Problem]:
    """Check for intensities without use; zeros mean that the LiDAR measures none."""
    doubt = intensity_doubt(points, max_intensity) if points[:, 3].any() else None
    return [] if doubt is None else [Problem(path=path, problem=doubt[0], remedy=doubt[1])]


def _check_hollow(points: Float32[np.ndarray, "_num_points 4"], path: Path) -> list[Problem]:
    """Check for a cloud of hardly any points, or of none although its file has rows."""
    if len(points):
        doubt = hollow_doubt(points)
        return [] if doubt is None else [Problem(path=path, problem=doubt[0], remedy=doubt[1])]
    num_rows = len(cloud_rows(path))
    if not num_rows:
        return []  # a sweep of zero points is valid
    return [
        Problem(
            path=path,
            problem=f"holds no point: all {num_rows} rows are not finite or at 0, 0, 0",
            remedy="check whether the LiDAR delivered points, and how they were converted",
        )
    ]


def size_mismatch(
    image: Path, size: tuple[int, int], calibration: RecordingCalibration, reference: Path | None
) -> Problem | None:
    """Problem of an image or depth map whose size does not fit its calibration; None: it fits.

    Args:
        image: Path of the image or depth map.
        size: Its height and width [px].
        calibration: Its calibration.
        reference: First image of the same calibration.
    """
    expected, source = calibration.image_size, "in the calibration"
    if expected is None and reference is not None:
        # Damage of the reference is reported by its reader.
        expected = read_or_note(read_image_size, reference, [])
        source = f"in {reference.name}, of the same calibration"
    if expected is None or expected == size:
        return None
    remedy = "give each frame its own calibration (calibration/NAME.yaml), or the calibrated images"
    if expected == size[::-1]:
        remedy = "rotate it as when the camera was calibrated; the EXIF orientation is ignored"
    elif image.parent.name == DEPTH:
        remedy = "write depth maps in the size of the images, or give frames of another camera "
        remedy += "their own calibration (calibration/NAME.yaml)"
    return Problem(
        path=image,
        problem=f"is {size[0]}x{size[1]} (height x width), expected {expected[0]}x{expected[1]} as "
        f"{source}",
        remedy=remedy,
    )


def reference_images(frames: Sequence[ObjectFrame]) -> dict[Path, Path | None]:
    """Find the first image of each calibration file, else the first depth map; None: neither."""
    first: dict[Path, Path | None] = {}
    for part in ("image", "depth"):
        for frame in frames:
            if frame.calibration is not None:
                known = first.get(frame.calibration)
                first[frame.calibration] = known or getattr(frame, part)
    return first
