"""Calibration of a recording from CameraInfo and TF messages of a bag."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final, cast, get_args

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from sightline.data.importing.bag import TRANSFORMS, Bag, plain_frame
from sightline.data.importing.bag_messages import image_size_from_message
from sightline.data.importing.bag_topics import ChosenTopics
from sightline.data.importing.camera_region import region_of_image
from sightline.data.importing.frames import (
    Rigid,
    find_chain,
    find_transform,
    rigid_from_quaternion,
)
from sightline.data.kitti_trees import describe_absent
from sightline.data.recording_calibration import (
    Lens,
    RecordingCalibration,
    checked_matrices,
    require_usable,
)
from sightline.data.undistortion import LensModel, check_lens
from sightline.files.plain_text import shortened
from sightline.geometry.road_height import MAX_TILT_DEG
from sightline.geometry.rotations import rotation_fault
from sightline.geometry.tilt import Tilt

_FILE: Final = "give a calibration file by --calibration (docs/recordings.md has an example)"
_TRANSLATION_TOLERANCE_M: Final = 1e-3
_ROTATION_TOLERANCE_DEG: Final = 0.05
_MAX_COMPARED_TRANSFORMS: Final = 20  # transforms left out one by one to compare other chains
_LEVEL_FRAMES: Final = ("base_footprint", "base_link")
_MIN_TILT_DEG: Final = 1.0  # smaller tilts are within the errors of calibrations
_LENS_MODELS: Final[dict[str, LensModel]] = {"fisheye": "equidistant", "": "plumb_bob"}


def calibration_of_bag(
    bag: Bag, topics: ChosenTopics, *, undistort: bool
) -> tuple[RecordingCalibration, tuple[str, ...]]:
    """Read the calibration of a bag's camera and LiDAR, for all frames.

    The first usable CameraInfo and the first usable message of each transform are used: drivers
    send zeros until their calibration is loaded, and two sensors should not move relative to each
    other.

    Args:
        bag: The bag.
        topics: Topics of its camera and LiDAR.
        undistort: Whether to undistort images of a distorting lens.

    Returns:
        The calibration, and notes on choices.

    Raises:
        ValueError: There is no CameraInfo, or no TF chain from the LiDAR's frame to the camera's;
            or they are no valid calibration; or the lens distorts and `undistort` is False.
    """
    if topics.info is None:
        raise ValueError(
            f"{bag.path} has no CameraInfo of {shortened(topics.camera.name)}; {_FILE}"
        )
    camera_frame = _first_frame(bag, topics.camera.name)
    image_size = _image_size(bag, topics)
    info, info_notes = _usable_info(bag, topics)
    image_from_camera, rectified_from_camera = _projection(info, topics)
    region = region_of_image(info, image_from_camera, image_size)
    lens = None if topics.is_rectified else _lens(info, topics, undistort=undistort)
    info_frame = plain_frame(info.header.frame_id)
    frames = tuple(dict.fromkeys(frame for frame in (camera_frame, info_frame) if frame))
    if len(frames) > 1:
        info_notes += (
            f"warning: images are in frame {shortened(camera_frame)}, but {_info_label(topics)} is "
            f"in {shortened(info_frame)}: it may belong to another camera",
        )
    camera_from_lidar, tilt, tf_notes = _lidar_mount(bag, topics, frames)
    try:
        calibration = RecordingCalibration(
            matrices=checked_matrices(region.matrix, rectified_from_camera @ camera_from_lidar),
            image_size=region.size,
            lens=lens,
            lidar_tilt=tilt,
        )
        require_usable(calibration, region.size or image_size)
    except ValueError as error:
        raise ValueError(f"topic {_info_label(topics)}: {error}; {_FILE}") from error
    return calibration, (*info_notes, *region.notes, *tf_notes)


def _image_size(bag: Bag, topics: ChosenTopics) -> tuple[int, int] | None:
    """Height and width of the images, from the first readable one; None: there is none."""
    for message in bag.messages([topics.camera.name]):
        with suppress(ValueError):  # reported when images are written
            return image_size_from_message(message.content)
    return None


def _usable_info(bag: Bag, topics: ChosenTopics) -> tuple[Any, tuple[str, ...]]:
    """Return the first valid CameraInfo, and notes on the others."""
    chosen, chosen_number, fault = None, 0, None
    unusable, others, total = 0, 0, 0
    for message in bag.messages([_info_name(topics)]):
        total += 1
        info = message.content
        try:
            checked_matrices(*_projection(info, topics))
        except ValueError as error:
            unusable += 1
            fault = fault or error
            continue
        if chosen is None:
            chosen, chosen_number = info, message.number
        elif _info_content(info) != _info_content(chosen):
            others += 1
    notes = bag.undecodable_notes([_info_name(topics)])
    if chosen is None and fault is not None:
        raise ValueError(f"topic {_info_label(topics)}: {fault}; {_FILE}") from fault
    if chosen is None:
        raise bag.unreadable_topic_error(_info_name(topics))
    if unusable:
        notes += (
            f"{unusable} of {total} messages of {_info_label(topics)} hold no calibration: number "
            f"{chosen_number} (from 0), the first valid one, is used",
        )
    if others:
        notes += (
            f"warning: {others} of {total} messages of {_info_label(topics)} differ from number "
            f"{chosen_number} (from 0), which is used for all images",
        )
    return chosen, notes


def _info_content(info: Any) -> tuple[object, ...]:  # noqa: ANN401
    roi = info.roi
    numbers = (tuple(_field(info, name).tolist()) for name in ("d", "k", "r", "p"))
    region = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    frame = plain_frame(info.header.frame_id)
    return (frame, info.height, info.width, info.binning_x, info.binning_y, *region, *numbers)


def _projection(info: Any, topics: ChosenTopics) -> tuple[Float64[np.ndarray, "3 4"], Rigid]:  # noqa: ANN401
    """Read image_from_camera of the full resolution, and the rectifying rotation.

    Raises:
        ValueError: R is no rotation; the message continues a sentence that begins with the topic.
    """
    rectified_from_camera = np.eye(4)
    if topics.is_rectified:
        image_from_camera = _field(info, "p").reshape(3, 4)
        rotation = _field(info, "r").reshape(3, 3)
        fault = rotation_fault(rotation)
        if image_from_camera.any() and fault is not None:
            raise ValueError(f"R is no rotation: {fault}")
        rectified_from_camera[:3, :3] = rotation
    else:
        image_from_camera = np.pad(_field(info, "k").reshape(3, 3), ((0, 0), (0, 1)))
    return image_from_camera, rectified_from_camera


def _lens(info: Any, topics: ChosenTopics, *, undistort: bool) -> Lens | None:  # noqa: ANN401
    coefficients = tuple(_field(info, "d").tolist())
    if not any(coefficients):
        return None
    model_name = str(info.distortion_model)
    model = _LENS_MODELS.get(model_name, model_name)
    listed = ", ".join(f"{value:.4g}" for value in coefficients)
    if model not in get_args(LensModel):
        raise ValueError(
            f"topic {_info_label(topics)} has the unknown lens model {shortened(model_name)!r}; "
            f"{_FILE}"
        )
    try:
        check_lens(cast("LensModel", model), coefficients)
    except ValueError as error:
        raise ValueError(f"topic {_info_label(topics)}: {error}; {_FILE}") from error
    if not undistort:
        raise ValueError(
            f"topic {_info_label(topics)}: the lens distorts ({model_name}: {listed}); undistort "
            "the images by --undistort, or choose rectified ones by --camera-topic"
        )
    return Lens(model=cast("LensModel", model), coefficients=coefficients)


def _lidar_mount(
    bag: Bag, topics: ChosenTopics, camera_frames: Sequence[str]
) -> tuple[Rigid, Tilt | None, tuple[str, ...]]:
    """Find camera_from_lidar by TF, the LiDAR's tilt in the vehicle's frame, and notes.

    The first camera frame with a chain of transforms is used.
    """
    lidar = _first_frame(bag, topics.lidar.name)
    transforms = _transforms(bag)
    for camera in camera_frames:
        found = find_transform(transforms.first, camera, lidar)
        if found is not None:
            last = find_transform(transforms.last, camera, lidar)
            notes = _transform_notes(found, last, transforms, (lidar, camera))
            return found, _tilt_on_vehicle(transforms.first, lidar), notes
    if transforms.faults:
        raise ValueError(f"{bag.path}: {transforms.faults[0]}")
    camera = camera_frames[0] if camera_frames else ""
    sensors = (("LiDAR", topics.lidar, lidar), ("camera", topics.camera, camera))
    for sensor, topic, frame in sensors:
        if not frame:
            raise ValueError(
                f"{bag.path} lacks the pose of the {sensor}: no message of "
                f"{shortened(topic.name)} names its frame (header.frame_id); {_FILE}"
            )
    frames = sorted({frame for pair in transforms.first for frame in pair})
    known = f"has frames {describe_absent(frames)}" if frames else "is empty"
    raise ValueError(
        f"{bag.path} lacks the pose of the LiDAR: TF has no chain from frame "
        f"'{shortened(lidar)}' (topic {shortened(topics.lidar.name)}) to "
        f"'{shortened(camera)}' (topic {shortened(topics.camera.name)}), it {known}; "
        f"{_FILE}"
    )


def _tilt_on_vehicle(transforms: Mapping[tuple[str, str], Rigid], lidar: str) -> Tilt | None:
    """Find the LiDAR's tilt in a level frame of ROS (REP 105); None: no such frame, or no tilt.

    Frames with such a name in which the LiDAR is upside down are not the vehicle's.
    """
    for vehicle in _LEVEL_FRAMES:
        vehicle_from_lidar = find_transform(transforms, vehicle, lidar)
        if vehicle_from_lidar is not None:
            tilt = Tilt.from_up(vehicle_from_lidar[2, :3])
            return tilt if _MIN_TILT_DEG <= tilt.angle_deg <= MAX_TILT_DEG else None
    return None


@dataclass(frozen=True, slots=True)
class _Transforms:
    """Transforms parent_from_child by (parent, child)."""

    first: dict[tuple[str, str], Rigid]
    """First usable transform of each pair, static ones before dynamic ones."""
    last: dict[tuple[str, str], Rigid]
    faults: tuple[str, ...]
    """Reasons why some transforms are invalid."""


def _transforms(bag: Bag) -> _Transforms:
    first: dict[tuple[str, str], Rigid] = {}
    last: dict[tuple[str, str], Rigid] = {}
    faults: list[str] = []
    names = [topic.name for topic in bag.topics_of_kind(TRANSFORMS)]
    for name in sorted(names, key=lambda name: "static" not in name):
        for message in bag.messages([name]):
            for each in message.content.transforms:
                pair = (plain_frame(each.header.frame_id), plain_frame(each.child_frame_id))
                rotation, translation = each.transform.rotation, each.transform.translation
                try:
                    rigid = rigid_from_quaternion(
                        np.array(
                            (rotation.x, rotation.y, rotation.z, rotation.w), dtype=np.float64
                        ),
                        np.array((translation.x, translation.y, translation.z), dtype=np.float64),
                    )
                except ValueError as error:
                    label = f"{shortened(pair[1])} in {shortened(pair[0])}"
                    faults.append(f"{name}: the transform of {label} {error}")
                    continue
                first.setdefault(pair, rigid)
                last[pair] = rigid
    return _Transforms(first, last, tuple(faults))


def _transform_notes(
    first: Rigid, last: Rigid | None, transforms: _Transforms, frames: tuple[str, str]
) -> tuple[str, ...]:
    """Return notes on unusable transforms, moving sensors and contradicting chains."""
    notes = []
    if transforms.faults:
        notes.append(
            f"left out {len(transforms.faults)} invalid transforms, the first: "
            f"{transforms.faults[0].removesuffix('; calibrate again')}"
        )
    lidar, camera = frames
    difference = _difference(first, last)
    if difference is not None:
        notes.append(
            f"warning: by TF {shortened(lidar)} moves relative to {shortened(camera)} in the "
            f"drive, by {difference} from first to last: the first is used"
        )
    chain = find_chain(transforms.first, camera, lidar) or []
    for pair in list(pairwise(chain))[:_MAX_COMPARED_TRANSFORMS]:
        for step in (pair, pair[::-1]):
            others = {each: rigid for each, rigid in transforms.first.items() if each != step}
            difference = _difference(first, find_transform(others, camera, lidar))
            if difference is not None:
                notes.append(
                    f"warning: TF has several chains from {shortened(lidar)} to "
                    f"{shortened(camera)} that differ by {difference}: the shortest is used, "
                    f"through {shortened(pair[0])} and {shortened(pair[1])}"
                )
                return tuple(notes)
    return tuple(notes)


def _difference(first: Rigid, other: Rigid | None) -> str | None:
    """Describe the difference of two transforms; None: no difference, or no other transform."""
    difference = np.eye(4) if other is None else np.linalg.inv(first) @ other
    translation_m = float(np.linalg.norm(difference[:3, 3]))
    rotation_deg = float(np.degrees(Rotation.from_matrix(difference[:3, :3]).magnitude()))
    if translation_m <= _TRANSLATION_TOLERANCE_M and rotation_deg <= _ROTATION_TOLERANCE_DEG:
        return None
    return f"{translation_m:.3g} m and {rotation_deg:.3g} degrees"


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


def _field(info: Any, name: str) -> Float64[np.ndarray, " count"]:  # noqa: ANN401
    """Read K, D, R or P, which have capital names in ROS 1."""
    value = getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())
    return np.asarray(value, dtype=np.float64)


def _info_name(topics: ChosenTopics) -> str:
    assert topics.info is not None, "it was read"
    return topics.info.name


def _info_label(topics: ChosenTopics) -> str:
    return shortened(_info_name(topics))
