"""Mounting of a LiDAR: its pose over the road, from a few clouds of a data set."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float32

from sightline.data.checks.entry_checks import select_spread
from sightline.data.formats.kitti_calibration import CalibrationMatrices, read_object_pose
from sightline.data.formats.point_files import read_cloud
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
)
from sightline.data.formats.velodyne import read_sweep, sweep_rows
from sightline.data.layouts.kitti_trees import DriveFrame, ObjectFrame
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.files.problem import FileError, read_or_note
from sightline.geometry.echoes import describe_losses
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.mount import turn_ahead
from sightline.geometry.road_height import (
    MAX_LIDAR_HEIGHT_M,
    UNKNOWN_TILT,
    USUAL_HEIGHT_M,
    LidarPose,
    MountDoubt,
    describe_odd_height,
    is_road_hidden,
    lidar_pose,
    mount_doubts,
    road_height_m,
    upright_turn,
)
from sightline.geometry.tilt import Tilt
from sightline.geometry.user_warning import warn_user

Item = TypeVar("Item")

_MIN_TILT_DEG: Final = 4.0
"""Smallest tilt to level: above the apparent tilt of any cloud of KITTI (3.3 degrees)."""
_MIN_HEIGHT_DIFFERENCE_M: Final = 0.5
"""Smallest difference to KITTI's height to use: errors on KITTI reach 0.43 m for single clouds
and 0.16 m for medians of three."""
_NUM_ROAD_CLOUDS = 5  # clouds for the pose over the road, spread over a recording
_LEVEL: Final = Tilt(roll_deg=0.0, pitch_deg=0.0)
_KITTI_POSE: Final = LidarPose(height_m=None, tilt=None)
_RECORD: Final = "lidar_mount.json"
"""File beside the folders of a split with the pose of the tree that it was made from."""
_ROUNDING: Final = 1e-6
"""Largest difference [m, degrees] that other processors' rounding makes."""
_RECORD_REMEDY: Final = "run sightline corrupt again, which writes it anew, or remove it"


def pose_of_tree(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> LidarPose:
    """Estimate the pose of a LiDAR over the road from the first cloud, the last and one between.

    A LiDAR tilted by less than 4 degrees is assumed to be level, and one whose height differs by
    less than 0.5 m from KITTI's, or whose clouds hardly show the road, to be mounted like KITTI's.
    Where the calibration files give the mount of each frame (`stated_pose`), or the tree records
    that of its sound clouds (`record_pose`), nothing is estimated.

    Args:
        frames: All frames of a tree, so that any selection has the same pose.

    Raises:
        FileError: The record is damaged.
    """
    known = _known_pose(frames)
    if known is not None:
        return known
    sweeps = _some_sweeps(frames)
    pose = lidar_pose(sweeps)
    if pose.tilt is not None and pose.tilt.angle_deg < _MIN_TILT_DEG:
        pose = replace(pose, tilt=None)
    if pose.tilt is None and not (_has_other_height(pose) and _is_road_visible(sweeps, pose)):
        return _KITTI_POSE
    return _KITTI_POSE if _has_other_axes(sweeps) else pose


def describe_hidden_road(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> tuple[str, ...]:
    """Describe clouds without a road, by which `pose_of_tree` assumes KITTI's mount; empty: none.

    Raises:
        FileError: The record of the pose is damaged.
    """
    sweeps = [] if _known_pose(frames) is not None else _some_sweeps(frames)
    if any(road_height_m(sweep) is not None for sweep in sweeps):
        return ()  # as usual, and sooner known than the pose
    if not is_road_hidden(sweeps, lidar_pose(sweeps)) or _has_other_axes(sweeps):
        return ()
    return (
        "its clouds show too little of the road to find the LiDAR's height above it: KITTI's "
        f"{KITTI_LIDAR_HEIGHT_M} m is assumed",
    )


def _known_pose(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> LidarPose | None:
    """Pose that is recorded, or KITTI's where calibration files give it; None: it is estimated."""
    first = next((frame for frame in frames if isinstance(frame, ObjectFrame)), None)
    if first is not None and stated_pose(first) is not None:
        return _KITTI_POSE
    record = None if first is None else _record_of(first)
    return None if record is None else _read_record(record)


def _some_sweeps(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame],
) -> list[Float32[np.ndarray, "_num_points 4"]]:
    paths = select_spread([frame.points for frame in frames if frame.points is not None])
    read = (read_or_note(read_sweep, path, []) for path in paths)
    return [sweep for sweep in read if sweep is not None]  # others: reported by their readers


def _has_other_axes(sweeps: Sequence[Float32[np.ndarray, "_num_points 4"]]) -> bool:
    """Find clouds whose z axis does not point up, which their own check reports."""
    return any(upright_turn(sweep) is not None for sweep in sweeps)


def describe_lost_points(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> tuple[str, ...]:
    """Describe the points without an echo in some sweeps of a tree, in a clause; empty: none."""
    paths = select_spread([frame.points for frame in frames if frame.points is not None])
    read = [read_or_note(sweep_rows, path, []) for path in paths]
    # Sweeps that are not finite are refused.
    return describe_losses([rows for rows in read if rows is not None and np.isfinite(rows).all()])


def stated_pose(frame: ObjectFrame) -> LidarPose | None:
    """Read the LiDAR's mount from a frame's calibration file; None: not given, or unreadable."""
    return read_or_note(read_object_pose, frame.calibration, [])


def record_pose(split: Path, pose: LidarPose) -> None:
    """Record the pose of a sound tree in a split of a tree whose clouds are corrupted.

    Args:
        split: Folder of the split, such as `training`.
        pose: Pose by `pose_of_tree`; both fields are None if it is KITTI's. A record of this pose
            but for rounding stays as it is.
    """
    path = split / _RECORD
    if path.is_file():
        with suppress(FileError):  # a damaged one is written anew
            if _is_same(_read_record(path), pose):  # shards go by times of change
                return
    tilt = pose.tilt and {"roll": pose.tilt.roll_deg, "pitch": pose.tilt.pitch_deg}
    text = json.dumps({"lidar_height_m": pose.height_m, "lidar_tilt_deg": tilt}, indent=2) + "\n"
    atomic_write_text(path, text)


def _is_same(first: LidarPose, second: LidarPose) -> bool:
    """Test whether poses differ by the rounding of other processors only."""
    both = _numbers(first), _numbers(second)
    return np.allclose(*both, rtol=0, atol=_ROUNDING, equal_nan=True)


def _numbers(pose: LidarPose) -> tuple[float, float, float]:
    """Height [m], roll and pitch [degrees]; NaN: there is none."""
    height_m = math.nan if pose.height_m is None else pose.height_m
    if pose.tilt is None:
        return height_m, math.nan, math.nan
    return height_m, pose.tilt.roll_deg, pose.tilt.pitch_deg


def _record_of(frame: ObjectFrame) -> Path | None:
    """Find the recorded pose of a frame's tree."""
    files = (frame.points, frame.calibration, frame.image, frame.objects, frame.depth)
    path = next(each for each in files if each is not None).parent.parent / _RECORD
    return path if path.is_file() else None


def _read_record(path: Path) -> LidarPose:
    """Read the pose that `record_pose` wrote.

    Raises:
        FileError: The file is damaged.
    """
    text = read_text(path, remedy=_RECORD_REMEDY)
    try:
        content = json.loads(text)
        height_m, angles = content["lidar_height_m"], content["lidar_tilt_deg"]
        tilt = None
        if angles is not None:
            tilt = Tilt(roll_deg=_number(angles["roll"]), pitch_deg=_number(angles["pitch"]))
        return LidarPose(height_m=None if height_m is None else _number(height_m), tilt=tilt)
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
        problem = "is damaged, expected the LiDAR's height and tilt over the road"
        raise FileError(path, problem, _RECORD_REMEDY) from error


def _number(value: object) -> float:
    """Convert a finite number of JSON, such as a whole one that was written by hand.

    Raises:
        ValueError: It is none.
        OverflowError: It has hundreds of digits.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no finite number")
    return float(value)


def stated_mount_doubts(frames: Sequence[ObjectFrame]) -> tuple[MountDoubt, ...]:
    """Describe a mount in calibration files that the road in the clouds contradicts; empty: none.

    Of the first cloud, the last and one between, most must contradict it: single clouds of hills
    look tilted. Clouds that were corrupted (`record_pose`) contradict nothing.

    Args:
        frames: Frames of an object tree.
    """
    if frames and _record_of(frames[0]) is not None:
        return ()
    return _usual_doubts([(frame.points, stated_pose(frame)) for frame in _with_clouds(frames)])


def drive_pose_doubts(
    frames: Sequence[DriveFrame], pose: LidarPose | None
) -> tuple[MountDoubt, ...]:
    """Describe a mount in a drive's calibration that the road contradicts; None: none is given."""
    return _usual_doubts([(frame.points, pose) for frame in _with_clouds(frames)])


def _with_clouds(frames: Sequence[Item]) -> Sequence[Item]:
    """Select the first frame with a cloud, the last and one between."""
    return select_spread([each for each in frames if getattr(each, "points", None) is not None])


def _usual_doubts(
    clouds: Sequence[tuple[Path | None, LidarPose | None]],
) -> tuple[MountDoubt, ...]:
    """Describe a given mount that the road in most of some clouds contradicts; empty: none."""
    found: list[MountDoubt] = []
    given = 0
    for path, pose in clouds:
        sweep = None if pose is None else read_or_note(read_sweep, path, [])
        if pose is not None and sweep is not None:
            given += 1
            found += mount_doubts([sweep], pose.height_m, pose.tilt or _LEVEL)[:1]
    return (found[0],) if 2 * len(found) > given else ()


def warn_of_mount(
    pose: LidarPose, frames: Sequence[ObjectFrame] | Sequence[DriveFrame], folder: Path
) -> None:
    """Warn of a found tilt, and of a height other than KITTI's or unknown, with consequences."""
    remedy = "make the data a recording with"
    if pose.tilt is not None:
        warn_user(
            f"{folder}: the road in its clouds shows that the LiDAR is tilted, {pose.tilt}: "
            "detectors get levelled clouds, and predictions stay in the LiDAR's frame; to set the "
            f"tilt, {remedy} lidar_tilt_deg (docs/recordings.md)",
        )
    for description in (*describe_height(pose), *describe_hidden_road(frames)):
        warn_user(
            f"{folder}: {description}; to set the height, {remedy} lidar_height_m "
            "(docs/recordings.md)",
        )


def describe_height(pose: LidarPose) -> tuple[str, ...]:
    """Describe a LiDAR's height in a clause; empty: like KITTI's."""
    if pose.height_m is None or not _has_other_height(pose):
        return ()
    return (
        f"the road in its clouds shows that the LiDAR is {pose.height_m:.2f} m above it, not "
        f"{KITTI_LIDAR_HEIGHT_M} m like KITTI's: detectors get clouds shifted in z by the "
        f"difference{describe_odd_height(pose.height_m)}",
    )


def _is_road_visible(
    sweeps: Sequence[Float32[np.ndarray, "_num_points 4"]], pose: LidarPose
) -> bool:
    is_high = pose.height_m is not None and pose.height_m > USUAL_HEIGHT_M
    highest_m = MAX_LIDAR_HEIGHT_M if is_high else USUAL_HEIGHT_M
    return 2 * sum(road_height_m(sweep, highest_m) is not None for sweep in sweeps) > len(sweeps)


def _has_other_height(pose: LidarPose) -> bool:
    height_m = pose.height_m
    return height_m is not None and abs(height_m - KITTI_LIDAR_HEIGHT_M) > _MIN_HEIGHT_DIFFERENCE_M


def describe_mount(
    matrices: CalibrationMatrices, tilt: Tilt | None, source: str = "by the road in its clouds"
) -> tuple[str, ...]:
    """Describe a LiDAR's rotation and tilt, in a clause each; empty: none.

    Args:
        matrices: Calibration of the LiDAR.
        tilt: Tilt of the LiDAR; None, or less than 0.05 degrees: level.
        source: Source of the tilt.
    """
    if tilt is not None and tilt.is_level:
        tilt = None
    level = np.eye(4) if tilt is None else tilt.level_from_lidar
    turn = describe_rotation(turn_ahead(matrices.camera_from_lidar @ level.T)[1])
    if tilt is None:
        return turn
    return *turn, f"{source} the LiDAR is tilted, {tilt}: detectors get levelled clouds"


def describe_pose(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame], matrices: CalibrationMatrices | None
) -> tuple[str, ...]:
    """Describe the mount of a tree's LiDAR, in a clause each; empty: KITTI's, or unreadable."""
    if matrices is None:
        return ()
    pose = pose_of_tree(frames)
    hidden = (f"warning: {each}" for each in describe_hidden_road(frames))
    return *describe_mount(matrices, pose.tilt), *describe_height(pose), *hidden


def describe_rotation(angle_deg: float, subject: str = "detectors get clouds") -> tuple[str, ...]:
    """Describe the rotation of clouds in a clause; empty: 0 degrees."""
    if not angle_deg:
        return ()
    return (
        f"the camera looks {angle_deg:.0f} degrees (counter-clockwise) from the LiDAR's x axis: "
        f"{subject} rotated, so that x points in the camera's direction",
    )


def pose_of_recording(
    frames: Sequence[ObjectFrame], calibration: RecordingCalibration | None = None
) -> LidarPose:
    """Estimate the LiDAR's pose over the road from some clouds of a recording.

    Args:
        frames: All frames of the recording, so that any selection has the same pose.
        calibration: Calibration; its tilt is used if given.
    """
    return lidar_pose(_some_clouds(frames), None if calibration is None else calibration.lidar_tilt)


def mount_doubts_of_recording(
    frames: Sequence[ObjectFrame], calibration: RecordingCalibration
) -> tuple[MountDoubt, ...]:
    """Describe differences between a calibration's mounting and the road in some clouds.

    Args:
        frames: All frames of the recording.
        calibration: Calibration of the recording.
    """
    if calibration.lidar_tilt is None and calibration.lidar_height_m is None:
        return ()
    return mount_doubts(_some_clouds(frames), calibration.lidar_height_m, calibration.lidar_tilt)


def describe_unknown_tilt(
    frames: Sequence[ObjectFrame], calibration: RecordingCalibration, pose: LidarPose
) -> tuple[str, ...]:
    """Describe that no road shows the tilt beside a given height, in a clause; empty: it is known.

    Args:
        frames: All frames of the recording.
        calibration: Calibration of the recording.
        pose: Pose by `pose_of_recording`.
    """
    is_asked = calibration.lidar_height_m is not None and calibration.lidar_tilt is None
    return (UNKNOWN_TILT,) if is_asked and is_road_hidden(_some_clouds(frames), pose) else ()


def describe_lack_of_points(frames: Sequence[ObjectFrame]) -> str:
    """Describe why no checked cloud of a recording has points, in a clause."""
    checked = frames_with_clouds(frames)
    num_refused = sum(_read_cloud(frame) is None for frame in checked)
    if not num_refused:
        return "all of its checked clouds are empty"
    others = "" if num_refused == len(checked) else ", and the others are empty"
    return f"{num_refused} of {len(checked)} checked clouds cannot be read{others}"


def has_points(frames: Sequence[ObjectFrame]) -> bool:
    """Whether some clouds of a recording are readable and contain points.

    If not, this is the problem to report, instead of a small share of visible points.
    """
    return any(len(cloud) for cloud in _some_clouds(frames))


def _some_clouds(
    frames: Sequence[ObjectFrame],
) -> list[Float32[np.ndarray, "_num_points 4"]]:
    clouds = [_cloud_or_empty(frame) for frame in frames_with_clouds(frames)]
    if not any(map(len, clouds)):  # a LiDAR may start late
        clouds = [_cloud_or_empty(frame) for frame in frames_with_clouds(frames[::-1])]
    return clouds


def frames_with_clouds(frames: Sequence[ObjectFrame]) -> Sequence[ObjectFrame]:
    """Select frames with a cloud and a calibration, spread over all."""
    return select_road_clouds([frame for frame in frames if frame.points and frame.calibration])


def select_road_clouds(items: Sequence[Item]) -> Sequence[Item]:
    """Select a few of a recording's frames, or of their places, for its LiDAR's pose."""
    step = max(len(items) // _NUM_ROAD_CLOUDS, 1)
    return items[::step][:_NUM_ROAD_CLOUDS]


def _cloud_or_empty(frame: ObjectFrame) -> Float32[np.ndarray, "num_points 4"]:
    cloud = _read_cloud(frame)
    return np.zeros((0, 4), np.float32) if cloud is None else cloud


def _read_cloud(frame: ObjectFrame) -> Float32[np.ndarray, "num_points 4"] | None:
    """Read a cloud; None: it is refused, which the reader of the frame reports."""
    assert frame.points is not None, "frames without a cloud are left out"
    assert frame.calibration is not None, "frames without a calibration are left out"
    try:
        calibration = read_recording_calibration(frame.calibration)
        return read_cloud(frame.points, calibration.max_intensity)
    except FileError:
        return None
