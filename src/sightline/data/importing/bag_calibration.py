"""A recording's calibration from the CameraInfo and TF messages of a bag."""

from typing import Any, Final, cast, get_args

import numpy as np
from jaxtyping import Float64

from sightline.data.importing.bag import TRANSFORMS, Bag
from sightline.data.importing.bag_topics import ChosenTopics
from sightline.data.importing.frames import Rigid, find_transform, rigid_from_quaternion
from sightline.data.recording_calibration import Lens, RecordingCalibration, checked_matrices
from sightline.data.undistortion import LensModel, check_lens

_FILE: Final = "give a calibration file by --calibration (docs/recordings.md has an example)"
_MODELS: Final[dict[str, LensModel]] = {"fisheye": "equidistant", "": "plumb_bob"}


def calibration_of_bag(bag: Bag, topics: ChosenTopics, *, undistort: bool) -> RecordingCalibration:
    """The calibration of a bag's camera and LiDAR, for all frames.

    Of moving transforms the first of each is taken: between two sensors there should be none.

    Args:
        bag: The bag.
        topics: Its camera and LiDAR.
        undistort: Whether images of a lens that distorts are to be straightened.

    Raises:
        ValueError: There is no CameraInfo, or no way from the LiDAR's frame to the camera's by TF;
            or what they say is no calibration; or the lens distorts and nobody asked to straighten
            the images.
    """
    if topics.info is None:
        raise ValueError(f"{bag.path} has no CameraInfo of {topics.camera.name}; {_FILE}")
    info = _first(bag, topics.info.name)
    image_from_camera, rectified_from_camera = _projection(info, topics)
    lens = None if topics.is_rectified else _lens(info, topics, undistort=undistort)
    camera_from_lidar = rectified_from_camera @ _camera_from_lidar(bag, topics)
    try:
        matrices = checked_matrices(image_from_camera, camera_from_lidar)
    except ValueError as error:
        raise ValueError(f"by topic {_info_name(topics)} {error}; {_FILE}") from error
    return RecordingCalibration(
        matrices=matrices,
        # Makeshift publishers fill in the matrix alone.
        image_size=(int(info.height), int(info.width)) if info.height and info.width else None,
        lens=lens,
    )


def _projection(info: Any, topics: ChosenTopics) -> tuple[Float64[np.ndarray, "3 4"], Rigid]:  # noqa: ANN401
    """image_from_camera, and the rotation of rectified cameras."""
    rectified_from_camera = np.eye(4)
    if topics.is_rectified:
        image_from_camera = _field(info, "p").reshape(3, 4)
        rectified_from_camera[:3, :3] = _field(info, "r").reshape(3, 3)
    else:
        image_from_camera = np.pad(_field(info, "k").reshape(3, 3), ((0, 0), (0, 1)))
    is_camera = image_from_camera[0, 0] > 0 and image_from_camera[1, 1] > 0
    if not (is_camera and np.isfinite(image_from_camera).all()):
        raise ValueError(
            f"topic {_info_name(topics)} holds no calibration: its focal lengths are "
            f"{image_from_camera[0, 0]:.4g} and {image_from_camera[1, 1]:.4g} px; {_FILE}"
        )
    return image_from_camera, rectified_from_camera


def _lens(info: Any, topics: ChosenTopics, *, undistort: bool) -> Lens | None:  # noqa: ANN401
    coefficients = tuple(_field(info, "d").tolist())
    if not any(coefficients):
        return None
    said = str(info.distortion_model)
    model = _MODELS.get(said, said)
    shown = ", ".join(f"{value:.4g}" for value in coefficients)
    if model not in get_args(LensModel):
        raise ValueError(f"topic {_info_name(topics)} has the unknown lens model {said!r}; {_FILE}")
    try:
        check_lens(cast("LensModel", model), coefficients)
    except ValueError as error:
        raise ValueError(f"topic {_info_name(topics)}: {error}; {_FILE}") from error
    if not undistort:
        raise ValueError(
            f"topic {_info_name(topics)} tells of a lens that distorts ({said}: {shown}); give "
            "--undistort to have the images straightened, or choose rectified ones by "
            "--camera-topic"
        )
    return Lens(model=cast("LensModel", model), coefficients=coefficients)


def _camera_from_lidar(bag: Bag, topics: ChosenTopics) -> Rigid:
    camera, lidar = (
        str(_first(bag, topic.name).header.frame_id).lstrip("/")
        for topic in (topics.camera, topics.lidar)
    )
    transforms, faults = _transforms(bag)
    found = find_transform(transforms, camera, lidar)
    if found is None and faults:
        raise ValueError(f"{bag.path}: {faults[0]}")
    if found is None:
        frames = sorted({frame for pair in transforms for frame in pair})
        known = f"knows {', '.join(frames)}" if frames else "is empty"
        raise ValueError(
            f"{bag.path} does not tell where the LiDAR sits: TF has no way from frame {lidar!r} "
            f"(topic {topics.lidar.name}) to {camera!r} (topic {topics.camera.name}), it {known}; "
            f"{_FILE}"
        )
    return found


def _transforms(bag: Bag) -> tuple[dict[tuple[str, str], Rigid], list[str]]:
    """parent_from_child, the first that the bag has of each; static ones before moving ones.

    Returns:
        The transforms, and what is wrong with those that are none.
    """
    found: dict[tuple[str, str], Rigid] = {}
    faults: list[str] = []
    names = [topic.name for topic in bag.of_kind(TRANSFORMS)]
    for name in sorted(names, key=lambda name: "static" not in name):
        for message in bag.messages([name]):
            for each in message.content.transforms:
                pair = (each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/"))
                turn, move = each.transform.rotation, each.transform.translation
                if pair in found:
                    continue
                try:
                    found[pair] = rigid_from_quaternion(
                        np.array((turn.x, turn.y, turn.z, turn.w), dtype=np.float64),
                        np.array((move.x, move.y, move.z), dtype=np.float64),
                    )
                except ValueError as error:
                    faults.append(f"{name}: the transform of {pair[1]} in {pair[0]} {error}")
    return found, faults


def _first(bag: Bag, topic: str) -> Any:  # noqa: ANN401 - a message of any type
    return next(bag.messages([topic], wanted={(topic, 0)})).content


def _field(info: Any, name: str) -> Float64[np.ndarray, " count"]:  # noqa: ANN401
    """K, D, R or P: in capitals in ROS 1."""
    value = getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())
    return np.asarray(value, dtype=np.float64)


def _info_name(topics: ChosenTopics) -> str:
    assert topics.info is not None, "it was read"
    return topics.info.name
