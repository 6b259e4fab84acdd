"""Calibration of a bag's camera from its CameraInfo messages."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.kitti_calibration import check_intrinsics
from sightline.data.formats.recording_calibration import Lens, checked_matrices
from sightline.data.formats.undistortion import check_lens, is_straight, lens_model, without_filling
from sightline.data.importing.bag import Bag, plain_frame
from sightline.data.importing.bag_topics import ChosenTopics
from sightline.data.importing.camera_region import ImageRegion, region_of_image
from sightline.data.importing.frames import Rigid
from sightline.files.plain_text import shortened
from sightline.geometry.mount import resolution_doubt
from sightline.geometry.rotations import rotation_fault

CALIBRATION_REMEDY: Final = (
    "give a calibration file by --calibration (docs/recordings.md has an example)"
)
_OFF_MIDDLE: Final = 0.1
"""Distance of a principal point from the middle of the images, as a share of their half size: K of
KITTI's raw images is 0.12 and 0.20 off that of its rectified ones, their P 0.02 and 0.08."""
_PLACEHOLDER_FOCAL_PX: Final = 1.0
"""Largest focal length of a P that was not filled in: zeros, or the identity."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraCalibration:
    """Calibration of a camera."""

    frame: str
    """Coordinate frame of the message; empty: not named."""
    region: ImageRegion
    """Camera matrix of the images."""
    rectified_from_camera: Rigid
    lens: Lens | None
    """Distortion of the images; None: they are straight."""
    looks_rectified: bool
    """True if P fits the images and K does not, although the topic's name tells nothing: by tools
    such as kitti2bag, which publish rectified images with the K and the lens of raw ones."""


@dataclass(slots=True)
class _Candidate:
    """Messages of one usable content."""

    calibration: CameraCalibration
    first: int
    """Number of the first of these messages, from 0."""
    doubts: tuple[str, ...]
    """Reasons to prefer others: it does not fit the images, or lacks P, in this order; an empty
    reason does not apply."""
    has_size: bool
    """True if the messages are for images of the first image's size, which may differ from most."""
    notes: tuple[str, ...]
    """Notes on the reading."""
    count: int = 0

    @property
    def rank(self) -> tuple[bool, ...]:
        """Order of preference, the best one first."""
        return tuple(map(bool, self.doubts))


def camera_of_bag(
    bag: Bag, topics: ChosenTopics, image_size: tuple[int, int] | None
) -> tuple[CameraCalibration, tuple[str, ...]]:
    """Choose the calibration that most usable CameraInfo messages have, otherwise the first one.

    Args:
        bag: The bag.
        topics: Topics of its camera and LiDAR, with a CameraInfo.
        image_size: Height, width [px] of the images; None: none could be read.

    Returns:
        The calibration, and notes on the other messages.

    Raises:
        ValueError: No message can be decoded, or none is a calibration.
    """
    assert topics.info is not None, "the caller checks it"
    label = shortened(topics.info.name)
    candidates: dict[tuple[object, ...], _Candidate] = {}
    fault, unusable, total = "", 0, 0
    for message in bag.messages([topics.info.name]):
        total += 1
        info = message.content
        content = _content(info)
        if content not in candidates:
            try:
                calibration = _calibration(info, topics, image_size)
            except ValueError as error:
                unusable += 1
                fault = fault or str(error)
                continue
            read_notes = _projection_notes(info, topics)
            lack = "P has no usable focal length" if topics.is_rectified else "K holds only zeros"
            candidates[content] = _Candidate(
                calibration,
                message.number,
                (_doubt(calibration, image_size), lack if read_notes else ""),
                _has_size(info, topics, calibration, image_size),
                read_notes,
            )
        candidates[content].count += 1
    if not candidates and fault:
        raise ValueError(f"topic {label}: {fault}; {CALIBRATION_REMEDY}")
    if not candidates:
        raise bag.unreadable_topic_error(topics.info.name)
    found = list(candidates.values())
    best = min(each.rank for each in found)  # not always without a doubt: images may be damaged
    fitting = [each for each in found if each.rank == best]
    for each in found:
        if each.rank != best:
            unusable += each.count
            reasons = zip(each.doubts, best, strict=True)
            fault = fault or next(doubt for doubt, is_usual in reasons if doubt and not is_usual)
    usable = total - unusable
    first = next((each for each in fitting if each.has_size), fitting[0])
    chosen = next((each for each in fitting if each.count * 2 > usable), first)
    notes = bag.undecodable_notes([topics.info.name])
    if unusable:
        level = "warning: " if 2 * unusable > total else ""
        notes += (
            f"{level}{unusable} of {total} messages of {label} are unusable or less usable than "
            f"number {chosen.first} (from 0), which is used; the first of them: {fault}",
        )
    if chosen.count < usable:
        reason = "which most of them repeat" if chosen.count * 2 > usable else "the first valid one"
        notes += (
            f"warning: {usable - chosen.count} of {total} messages of {label} differ from number "
            f"{chosen.first} (from 0), {reason}: it is used for all images",
        )
    return chosen.calibration, (*notes, *chosen.notes)


def _content(info: Any) -> tuple[object, ...]:  # noqa: ANN401 - a message
    roi = info.roi
    numbers = (_field(info, name).tobytes() for name in ("d", "k", "r", "p"))
    region = (roi.x_offset, roi.y_offset, roi.height, roi.width)
    sizes = (info.height, info.width, info.binning_x, info.binning_y)
    return (
        plain_frame(info.header.frame_id),
        str(info.distortion_model),
        *sizes,
        *region,
        *numbers,
    )


def _calibration(
    info: Any,  # noqa: ANN401 - a message
    topics: ChosenTopics,
    image_size: tuple[int, int] | None,
) -> CameraCalibration:
    """Read a message.

    Raises:
        ValueError: It is no calibration; the message continues a sentence that begins with the
            topic.
    """
    image_from_camera, rectified_from_camera = _projection(info, topics)
    checked_matrices(image_from_camera, rectified_from_camera)
    return CameraCalibration(
        frame=plain_frame(info.header.frame_id),
        region=region_of_image(info, image_from_camera, image_size),
        rectified_from_camera=rectified_from_camera,
        lens=None if topics.is_rectified else _lens(info),
        looks_rectified=not topics.is_rectified and _looks_rectified(info, image_size),
    )


def _doubt(calibration: CameraCalibration, image_size: tuple[int, int] | None) -> str:
    """Reason why a calibration does not fit its images; empty: it does."""
    intrinsics = calibration.region.matrix[:, :3]
    doubts = check_intrinsics(intrinsics, image_size, Path(), usual=False)
    return f"camera_matrix {doubts[0].problem}" if doubts else ""


def _has_size(
    info: Any,  # noqa: ANN401 - a message
    topics: ChosenTopics,
    calibration: CameraCalibration,
    image_size: tuple[int, int] | None,
) -> bool:
    """Check if a message is for images of a size, by its own and by its principal point.

    The principal point is near the middle of the full resolution, not of a region of interest.
    """
    full_size = (int(info.height), int(info.width)) if info.height and info.width else image_size
    full_matrix, _ = _projection(info, topics)
    is_scaled = full_size is not None and resolution_doubt(full_matrix[:, :3], full_size)
    return not is_scaled and calibration.region.size in (None, image_size)


def _projection(info: Any, topics: ChosenTopics) -> tuple[Float64[np.ndarray, "3 4"], Rigid]:  # noqa: ANN401
    """Read image_from_camera of the full resolution, and the rectifying rotation.

    Nodes that undistort images often send K alone, and zeros or the identity for P and R; few send
    P alone.

    Raises:
        ValueError: R is no rotation, or K is missing beside a distortion; the message continues a
            sentence that begins with the topic.
    """
    rectified_from_camera = np.eye(4)
    has_p_alone = _has_p_alone(info)
    if has_p_alone and not topics.is_rectified and _lens(info) is not None:
        raise ValueError("K holds only zeros, and P, which is given, is without the lens of D")
    if has_p_alone or (topics.is_rectified and _has_projection(info)):
        image_from_camera = _field(info, "p").reshape(3, 4)
        rotation = _field(info, "r").reshape(3, 3)
        rotation = rotation if rotation.any() else np.eye(3)
        fault = rotation_fault(rotation)
        if fault is not None:
            raise ValueError(f"R is no rotation: {fault}")
        rectified_from_camera[:3, :3] = rotation
    else:
        image_from_camera = np.pad(_field(info, "k").reshape(3, 3), ((0, 0), (0, 1)))
    return image_from_camera, rectified_from_camera


def _has_projection(info: Any) -> bool:  # noqa: ANN401 - a message
    """Check if P has focal lengths, and is no placeholder."""
    focal_px = np.diag(_field(info, "p").reshape(3, 4))[:2]
    return bool((np.abs(focal_px) > _PLACEHOLDER_FOCAL_PX).all())


def _has_p_alone(info: Any) -> bool:  # noqa: ANN401 - a message
    """Check if P has focal lengths, and K holds only zeros."""
    return _has_projection(info) and not _field(info, "k").any()


def _looks_rectified(info: Any, image_size: tuple[int, int] | None) -> bool:  # noqa: ANN401
    """Check if the principal point of K is off the middle of the images, and that of P is not."""
    if image_size is None or (info.height, info.width) != image_size or not _has_projection(info):
        return False
    k, p = (_field(info, name).reshape(3, -1)[1::-1, 2] for name in ("k", "p"))
    off_k, off_p = (np.abs((2 * each + 1) / image_size - 1) for each in (k, p))
    return bool((off_k > _OFF_MIDDLE).all() and (off_p < _OFF_MIDDLE).all())


def _projection_notes(info: Any, topics: ChosenTopics) -> tuple[str, ...]:  # noqa: ANN401
    """Note that rectified images get K, as P is a placeholder, or others P; empty: not so."""
    if not topics.is_rectified and _has_p_alone(info):
        return (
            "K of CameraInfo holds only zeros: P is used in its place, so images of "
            f"{shortened(topics.camera.name)} count as rectified",
        )
    if not topics.is_rectified or _has_projection(info):
        return ()
    return (
        "P of CameraInfo has no usable focal length: K is used in its place, as images of "
        f"{shortened(topics.camera.name)} count as rectified by the topic's name",
    )


def _lens(info: Any) -> Lens | None:  # noqa: ANN401 - a message
    """Read the distortion; None: there is none.

    Raises:
        ValueError: The model is unknown, or its coefficients are invalid; the message continues a
            sentence that begins with the topic.
    """
    coefficients = tuple(_field(info, "d").tolist())
    name = str(info.distortion_model) or "plumb_bob"
    if is_straight(name, coefficients):
        return None
    model = lens_model(name, len(coefficients))
    if model is None:
        raise ValueError(f"the lens model {shortened(name, 40)!r} is unknown")
    coefficients = without_filling(model, coefficients)
    check_lens(model, coefficients)
    return Lens(model=model, coefficients=coefficients)


def _field(info: Any, name: str) -> Float64[np.ndarray, " count"]:  # noqa: ANN401
    """Read K, D, R or P, which have capital names in ROS 1."""
    value = getattr(info, name) if hasattr(info, name) else getattr(info, name.upper())
    return np.asarray(value, dtype=np.float64)
