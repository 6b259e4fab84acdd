"""Calibration of a recording from CameraInfo and TF messages of a bag."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.checks.lidar_mount import pose_of_recording
from sightline.data.formats.recording_calibration import (
    Lens,
    RecordingCalibration,
    checked_matrices,
    read_recording_calibration,
    require_usable,
)
from sightline.data.importing.bag import Bag, plain_frame
from sightline.data.importing.bag_camera_info import (
    CALIBRATION_REMEDY,
    CameraCalibration,
    camera_of_bag,
)
from sightline.data.importing.bag_messages import image_size_from_message
from sightline.data.importing.bag_topics import ChosenTopics
from sightline.data.importing.bag_transforms import (
    BagTransforms,
    describe_transforms,
    transforms_of_bag,
    world_fault,
)
from sightline.data.importing.frames import Rigid, find_transform
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.data.layouts.recording_files import list_recording
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, read_or_note
from sightline.geometry.road_height import MAX_TILT_DEG
from sightline.geometry.tilt import Tilt

_RECTIFIED_ALREADY: Final = (
    "P fits the images and K does not: they are probably rectified already, as by kitti2bag"
)
_LEVEL_FRAMES: Final = ("base_footprint", "base_link")
_MIN_BASELINE_M: Final = 1e-3
_BASELINE_TOLERANCE: Final = 0.05
"""Largest distance of a first camera's frame from its place by P, as a share of the baseline."""
_MIN_TILT_DEG: Final = 1.0  # smaller tilts are within the errors of calibrations


def calibration_of_bag(
    bag: Bag, topics: ChosenTopics, *, undistort: bool
) -> tuple[RecordingCalibration, tuple[str, ...]]:
    """Read the calibration of a bag's camera and LiDAR, for all frames.

    The content of most usable messages is used, or else of the first one: drivers send zeros or
    defaults until their calibration is loaded, and two sensors should not move relative to each
    other.

    Args:
        bag: The bag.
        topics: Topics of its camera and LiDAR.
        undistort: Whether to undistort images of a distorting lens.

    Returns:
        The calibration, with a tilt by TF of any angle, and notes on choices.

    Raises:
        ValueError: There is no CameraInfo, or no TF chain from the LiDAR's frame to the camera's;
            or they are no valid calibration; or the lens distorts and `undistort` is False.
    """
    if topics.info is None:
        raise ValueError(
            f"{bag.path} has no CameraInfo of {shortened(topics.camera.name)}; {CALIBRATION_REMEDY}"
        )
    camera_frame = _first_frame(bag, topics.camera.name)
    image_size = _image_size(bag, topics)
    camera, info_notes = camera_of_bag(bag, topics, image_size)
    label, region = shortened(topics.info.name), camera.region
    if camera.lens is not None and not undistort:
        raise _distorting_lens_error(label, camera.lens, looks_rectified=camera.looks_rectified)
    if camera.lens is not None and camera.looks_rectified:
        info_notes += (
            f"warning: topic {label}: {_RECTIFIED_ALREADY}, and undistorted once more now; "
            f"{CALIBRATION_REMEDY}",
        )
    frames = tuple(dict.fromkeys(frame for frame in (camera_frame, camera.frame) if frame))
    if len(frames) > 1:
        info_notes += (
            f"warning: images are in frame {shortened(camera_frame)}, but {label} is in "
            f"{shortened(camera.frame)}: it may belong to another camera",
        )
    camera_from_lidar, tilt, tf_notes = _lidar_mount(bag, topics, frames, camera)
    try:
        calibration = RecordingCalibration(
            matrices=checked_matrices(
                region.matrix, camera.rectified_from_camera @ camera_from_lidar
            ),
            image_size=region.size,
            lens=camera.lens,
            lidar_tilt=tilt,
        )
        require_usable(calibration, region.size or image_size)
    except ValueError as error:
        raise ValueError(f"topic {label}: {error}; {CALIBRATION_REMEDY}") from error
    return calibration, (*info_notes, *region.notes, *tf_notes)


def _distorting_lens_error(label: str, lens: Lens, *, looks_rectified: bool) -> ValueError:
    coefficients = ", ".join(f"{value:.4g}" for value in lens.coefficients)
    problem = f"topic {label}: the lens distorts ({lens.model}: {coefficients})"
    if looks_rectified:
        return ValueError(
            f"{problem}, but {_RECTIFIED_ALREADY}; {CALIBRATION_REMEDY}, or if they are not, "
            "undistort them by --undistort"
        )
    return ValueError(
        f"{problem}; undistort the images by --undistort, or choose rectified ones by "
        "--camera-topic"
    )


def _image_size(bag: Bag, topics: ChosenTopics) -> tuple[int, int] | None:
    """Height and width of the images, from the first readable one; None: there is none."""
    for message in bag.messages([topics.camera.name]):
        with suppress(ValueError):  # reported when images are written
            return image_size_from_message(message.content)
    return None


def _lidar_mount(
    bag: Bag,
    topics: ChosenTopics,
    camera_frames: Sequence[str],
    calibration: CameraCalibration,
) -> tuple[Rigid, Tilt | None, tuple[str, ...]]:
    """Find camera_from_lidar by TF, the LiDAR's tilt in the vehicle's frame, and notes.

    The first camera frame with a chain of transforms is used.
    """
    lidar = _first_frame(bag, topics.lidar.name)
    transforms = transforms_of_bag(bag, (topics.camera.name, topics.lidar.name))
    for camera in camera_frames:
        found = find_transform(transforms.between(camera, lidar), camera, lidar)
        if found is not None:
            fault = world_fault(transforms, found, lidar, camera)
            if fault is not None:
                raise ValueError(
                    f"topic {shortened(topics.lidar.name)}: clouds {fault}; if they are in the "
                    f"LiDAR's own frame and only frame_id is wrong, {CALIBRATION_REMEDY}"
                )
            notes = describe_transforms(transforms, found, lidar, camera)
            notes += _baseline_notes(transforms.usual, camera, calibration)
            return found, _tilt_on_vehicle(transforms, lidar), notes
    if transforms.faults:
        raise ValueError(f"{bag.path}: {transforms.faults[0]}")
    camera = camera_frames[0] if camera_frames else ""
    sensors = (("LiDAR", topics.lidar, lidar), ("camera", topics.camera, camera))
    for sensor, topic, frame in sensors:
        if not frame:
            raise ValueError(
                f"{bag.path} lacks the pose of the {sensor}: no message of "
                f"{shortened(topic.name)} names its frame (header.frame_id); {CALIBRATION_REMEDY}"
            )
    frames = sorted({frame for pair in transforms.usual for frame in pair})
    known = f"has frames {describe_absent(frames)}" if frames else "is empty"
    raise ValueError(
        f"{bag.path} lacks the pose of the LiDAR: TF has no chain from frame "
        f"'{shortened(lidar)}' (topic {shortened(topics.lidar.name)}) to "
        f"'{shortened(camera)}' (topic {shortened(topics.camera.name)}), it {known}; "
        f"{CALIBRATION_REMEDY}"
    )


def _baseline_notes(
    transforms: Mapping[tuple[str, str], Rigid], camera: str, calibration: CameraCalibration
) -> tuple[str, ...]:
    """Warn of a stereo camera whose offset from the first one is both in P and in TF.

    P of CameraInfo projects from the first camera's frame, so it has the offset, but many drivers
    publish it with the second camera's own frame. TF may have a frame at the first camera's place.
    """
    matrix = calibration.region.matrix
    offset_m = np.array((matrix[0, 3] / matrix[0, 0], 0.0, 0.0))
    baseline_m = abs(float(offset_m[0]))
    if baseline_m <= _MIN_BASELINE_M:
        return ()
    frames = dict.fromkeys(frame for pair in transforms for frame in pair)
    poses = [find_transform(transforms, camera, frame) for frame in frames]
    places_m = [
        (calibration.rectified_from_camera @ pose)[:3, 3] for pose in poses if pose is not None
    ]
    limit_m = max(_BASELINE_TOLERANCE * baseline_m, _MIN_BASELINE_M)
    is_named = "right" in re.split("[^a-z]+", camera.lower())
    if not is_named and all(np.linalg.norm(at - offset_m) > limit_m for at in places_m):
        return ()
    shift_px = baseline_m * matrix[0, 0] / 10
    return (
        f"warning: P of CameraInfo has the baseline of a stereo pair, {baseline_m:.3g} m, and TF "
        f"has {shortened(camera)}, probably the second camera's own frame: then the baseline is "
        f"counted twice, {shift_px:.3g} px at 10 m; look whether points fit the images (sightline "
        "show), and if not, set the fourth column of camera_matrix to 0",
    )


def with_plausible_tilt(calibration: RecordingCalibration) -> RecordingCalibration:
    """Remove the tilt by TF of a LiDAR whose clouds were turned upright, unless it is plausible.

    Tilts below a degree count as level. Frames with a vehicle's name in which the LiDAR is still
    upside down or on its side are not the vehicle's.
    """
    tilt = calibration.lidar_tilt
    is_plausible = tilt is not None and _MIN_TILT_DEG <= tilt.angle_deg <= MAX_TILT_DEG
    return calibration if is_plausible else replace(calibration, lidar_tilt=None)


def require_fitting_tilt(calibration: RecordingCalibration, file: Path) -> None:
    """Refuse a given calibration whose LiDAR is upside down or on its side after the clouds' turn.

    Such a file is that of an import which turned clouds, and this bag's clouds are not turned.

    Raises:
        FileError: It is.
    """
    tilt = calibration.lidar_tilt
    if tilt is not None and max(abs(tilt.roll_deg), abs(tilt.pitch_deg)) > MAX_TILT_DEG:
        raise FileError(
            file,
            "does not fit the clouds of this bag: by it the LiDAR is upside down or on its side, "
            "which the road in the clouds does not show",
            "give the calibration of this LiDAR with this setting of its driver; if it is that, "
            "import a part of the drive whose sweeps show the road",
        )


def doubt_about_level(tilt: Tilt | None, out: Path) -> tuple[str, ...]:
    """Warn if the road looks tilted to a LiDAR that is level on the vehicle by TF.

    Args:
        tilt: Tilt by TF; None: TF has no level frame.
        out: Folder of the imported recording.
    """
    if tilt is None or tilt.angle_deg >= _MIN_TILT_DEG:
        return ()
    frames = list_recording(out).frames
    kept = read_or_note(read_recording_calibration, frames[0].calibration if frames else None, [])
    found = None if kept is None or kept.lidar_tilt else pose_of_recording(frames).tilt
    if found is None:
        return ()
    return (
        "warning: by TF the LiDAR is level on the vehicle, by the road in its clouds it is tilted, "
        f"{found}: if TF is wrong, points are drawn beside their objects; look by sightline show, "
        f"and correct TF; {CALIBRATION_REMEDY}",
    )


def _tilt_on_vehicle(transforms: BagTransforms, lidar: str) -> Tilt | None:
    """Find the LiDAR's tilt in a level frame of ROS (REP 105), of any angle; None: no such frame.

    LiDARs may be mounted upside down or on their side.
    """
    for vehicle in _LEVEL_FRAMES:
        vehicle_from_lidar = find_transform(transforms.between(vehicle, lidar), vehicle, lidar)
        if vehicle_from_lidar is not None:
            return Tilt.from_up(vehicle_from_lidar[2, :3])
    return None


def _first_frame(bag: Bag, topic: str) -> str:
    """Frame of the first message that names one; empty: none does.

    Raises:
        ValueError: No message can be decoded.
    """
    message = None
    for message in bag.messages([topic]):
        if frame := plain_frame(message.content.header.frame_id):
            return frame
    if message is None:
        raise bag.unreadable_topic_error(topic)
    return ""
