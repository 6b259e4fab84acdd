"""Checks over the frames of a tree: equal files, empty ones, sizes and orientations of images."""

import hashlib
import math
import os
import stat
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.checks.alpha_checks import ALPHA_REMEDY, doubt_about_labels
from sightline.data.checks.cut_sweeps import check_cut_sweeps
from sightline.data.checks.frame_checks import is_blank
from sightline.data.checks.label_alignment import LabelledSweep, check_label_alignment
from sightline.data.checks.label_checks import doubts_in_space, lacks_box3d
from sightline.data.checks.label_fit import visible_objects
from sightline.data.checks.label_units import UNITS_REMEDY, doubt_about_units
from sightline.data.checks.result_boxes import join_boxes, scored_boxes
from sightline.data.checks.truncations import TRUNCATION_REMEDY, TruncationTally
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.image_header import read_image_size, read_orientation
from sightline.data.formats.kitti_calibration import read_object_matrices
from sightline.data.formats.kitti_labels import (
    CLASS_NAMES,
    MAX_OCCLUSION,
    MAX_TRUNCATION,
    read_labels,
)
from sightline.data.formats.map_png import read_depth_png
from sightline.data.formats.point_files import holds_no_point, read_cloud
from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.formats.velodyne import read_sweep
from sightline.data.layouts.kitti_trees import (
    CORRUPTED,
    DepthFrame,
    DriveFrame,
    ObjectFrame,
    describe_absent,
)
from sightline.data.layouts.recording_files import CALIBRATION_SUFFIXES
from sightline.files.problem import Problem, read_or_note
from sightline.geometry.user_warning import warn_user

_MAX_BYTES: Final = 2**28  # larger files are refused by their readers
_COMPARED_BYTES: Final = 4096
_MAX_BLANK_BYTES: Final = 2  # a line end
_MIN_HIDDEN: Final = 5  # objects, of which by chance not all are hidden
_MAX_LISTED: Final = 5  # groups of equal files listed one by one


def check_object_frames(frames: Sequence[ObjectFrame], folder: Path) -> list[Problem]:
    """Check frames of an object tree against each other, unless it is corrupted."""
    if (folder / CORRUPTED).is_dir():
        return []
    return [
        *_check_sensors(frames),
        *_check_labels(frames),
        *_check_image_sizes(frames),
        *_check_label_scale(frames, _read_object_frame),
    ]


def check_drive_frames(frames: Sequence[DriveFrame]) -> list[Problem]:
    """Check frames of a raw drive, of one calibration, against each other."""
    images = [frame.image for frame in frames if frame.image is not None]
    return [*_check_sensors(frames), *_check_sizes_of_camera(images)]


def check_depth_frames(frames: Sequence[DepthFrame]) -> list[Problem]:
    """Check frames of a depth tree against each other."""
    sparse = [frame.sparse for frame in frames if frame.sparse is not None]
    return [
        *check_repeats(frames),
        *check_orientations(frames),
        *_check_all_empty(sparse, _holds_no_depth, "sparse depth maps, all without a depth"),
    ]


def check_recording_frames(frames: Sequence[ObjectFrame]) -> list[Problem]:
    """Check frames of a recording against each other; sizes of images are checked by frame."""
    return [
        *check_repeats(frames),
        *check_orientations(frames),
        *_check_clouds(frames),
        *_check_labels(frames),
        *_check_label_scale(frames, _read_recording_frame),
    ]


def _check_sensors(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> list[Problem]:
    return [*check_repeats(frames), *check_orientations(frames), *_check_clouds(frames)]


def _check_labels(frames: Sequence[ObjectFrame]) -> list[Problem]:
    labels = [frame.objects for frame in frames if frame.objects is not None]
    remedy = "check how they were written, or remove the folder if nothing was labelled"
    empty = _check_all_empty(labels, _is_blank, "label files, all without an object", remedy)
    return [
        *(
            empty
            or _check_all_empty(
                labels, _holds_no_object, "label files, all without an object but DontCare", remedy
            )
        ),
        *_check_counted(labels),
        *_check_truncations(labels),
        *_check_alphas(labels),
    ]


def describe_flat_labels(frames: Sequence[ObjectFrame]) -> tuple[str, ...]:
    """Count the labelled objects without a 3D box, in a clause; empty: all have one."""
    total, flat = 0, 0
    for frame in frames:
        objects = read_or_note(read_labels, frame.objects, [])
        if objects is not None:
            total += sum(name in CLASS_NAMES for name in objects.class_names)
            flat += int(lacks_box3d(objects).sum())
    return (f"{flat:,} of {total:,} labelled objects have no 3D box",) if flat else ()


def _check_counted(paths: Sequence[Path]) -> Iterator[Problem]:
    """Yield a problem if no labelled object counts in scores, by occlusion and truncation."""
    total = 0
    for path in paths:
        objects = read_or_note(read_labels, path, [])
        if objects is None:
            continue
        names = np.array(objects.class_names, dtype=object)
        is_object = np.isin(names, CLASS_NAMES)
        is_hidden = (objects.occlusion > MAX_OCCLUSION) | (objects.truncation > MAX_TRUNCATION)
        if (is_object & ~is_hidden).any():
            return
        total += int(is_object.sum())
    if total >= _MIN_HIDDEN:
        yield Problem(
            path=paths[0].parent,
            problem=f"holds {total} objects, all with an occlusion above {MAX_OCCLUSION} (3 is "
            f"unknown) or a truncation above {MAX_TRUNCATION}: none counts in KITTI's scores",
            remedy="write 0 where the occlusion is not known, and the truncation from 0 to 1",
        )


def _check_truncations(paths: Sequence[Path]) -> Iterator[Problem]:
    """Yield a problem if truncations are flags or numbers, by which scores ignore objects."""
    tally = TruncationTally()
    for path in paths:
        objects = read_or_note(read_labels, path, [])
        if objects is not None:
            tally.add(objects)
    doubt = tally.doubt()
    if doubt is not None:
        yield Problem(
            path=paths[0].parent,
            problem=f"holds labels that {doubt}; scores ignore objects above {MAX_TRUNCATION}",
            remedy=TRUNCATION_REMEDY,
        )


def _check_label_scale(
    frames: Sequence[ObjectFrame], read: Callable[[ObjectFrame], LabelledSweep | None]
) -> list[Problem]:
    """Find labels in another unit than metres, or else clouds that do not fit them."""
    paths = [frame.objects for frame in frames if frame.objects is not None]
    labels = (read_or_note(read_labels, path, []) for path in paths)
    doubt = doubt_about_units(objects for objects in labels if objects is not None)
    if doubt is None:
        return check_label_alignment(frames, read)
    return [Problem(path=paths[0].parent, problem=f"holds {doubt}", remedy=UNITS_REMEDY)]


def _check_alphas(paths: Sequence[Path]) -> Iterator[Problem]:
    """Yield a problem if the alphas of labels with 3D boxes contradict rotation_y and place."""
    read = (read_or_note(read_labels, path, []) for path in paths)
    frames = [scored_boxes(objects) for objects in read if objects is not None]
    labels = join_boxes(frames) if frames else None
    doubt = None if labels is None else doubt_about_labels(labels.select(labels.has_3d))
    if doubt is not None:
        yield Problem(
            path=paths[0].parent,
            problem=f"holds labels by which no orientation can be scored: {doubt}",
            remedy=f"{ALPHA_REMEDY} for alpha, once rotation_y is right",
        )


def _read_object_frame(frame: ObjectFrame) -> LabelledSweep | None:
    """Read a labelled sweep; None: a file cannot be read, or `check_objects` doubts its units."""
    objects = read_or_note(read_labels, frame.objects, [])
    matrices = read_or_note(read_object_matrices, frame.calibration, [])
    points = read_or_note(read_sweep, frame.points, [])
    if objects is None or doubts_in_space(objects) or matrices is None or points is None:
        return None
    return LabelledSweep(objects=objects, matrices=matrices, points=points)


def _read_recording_frame(frame: ObjectFrame) -> LabelledSweep | None:
    """Read a labelled sweep of a recording, like `_read_object_frame`."""
    objects = read_or_note(read_labels, frame.objects, [])
    calibration = read_or_note(read_recording_calibration, frame.calibration, [])
    points = read_or_note(partial(read_cloud, max_intensity=math.inf), frame.points, [])
    if objects is None or doubts_in_space(objects) or calibration is None or points is None:
        return None
    return LabelledSweep(objects=objects, matrices=calibration.matrices, points=points)


def check_repeats(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame] | Sequence[DepthFrame],
) -> list[Problem]:
    """Find frames with equal pictures, clouds or labels; noise makes true recordings differ.

    Images of one colour, empty files and labels without a 3D box are left out. Frames of several
    cameras, which have calibrations of their own in a recording, may share a cloud; consecutive
    frames may share labels, as where the car stands.
    """
    pictures = [frame.image for frame in frames if frame.image is not None]
    labels = [frame.objects for frame in frames if isinstance(frame, ObjectFrame) and frame.objects]
    by_camera: dict[Hashable, list[Path]] = defaultdict(list)
    digests: dict[Path | None, bytes | None] = {}
    for frame in frames:
        cloud = frame.sparse if isinstance(frame, DepthFrame) else frame.points
        if cloud is not None:
            path = _calibration_file(frame)
            if path not in digests:
                digests[path] = None if path is None else _digest(path)
            by_camera[digests[path]].append(cloud)
    repeated_clouds = [
        group
        for each in by_camera.values()
        for group in _equal_files([path for path in each if not holds_no_point(path)])
    ]
    repeated_pictures = [
        group for group in _equal_files(pictures) if not _is_blank_or_unreadable(group[0])
    ]
    places = {path: place for place, path in enumerate(labels)}
    repeated_labels = [
        group
        for group in _equal_files(labels)
        if places[group[-1]] - places[group[0]] >= len(group) and _has_box3d(group[0])
    ]
    return [
        *_describe_repeats(repeated_pictures, "picture"),
        *_describe_repeats(repeated_clouds, "cloud"),
        *_describe_repeats(repeated_labels, "label file"),
    ]


def _calibration_file(frame: ObjectFrame | DriveFrame | DepthFrame) -> Path | None:
    """Calibration file of a recording's frame; None: another layout, or without calibration."""
    path = frame.calibration if isinstance(frame, ObjectFrame) else None
    return path if path is not None and path.suffix in CALIBRATION_SUFFIXES else None


def check_orientations(
    frames: Sequence[ObjectFrame] | Sequence[DriveFrame] | Sequence[DepthFrame],
) -> list[Problem]:
    """Find pictures that viewers turn or mirror by their EXIF tag, one problem for all."""
    pictures = [frame.image for frame in frames if frame.image is not None]
    turned = [
        (path, orientation)
        for path in pictures
        if (orientation := read_or_note(read_orientation, path, []) or 1) != 1
    ]
    if not turned:
        return []
    first, orientation = turned[0]
    return [
        Problem(
            path=first,
            problem=f"has EXIF orientation {orientation}{_more([path for path, _ in turned])}, of "
            f"{len(pictures)} pictures: pixels are used as stored, but viewers and OpenCV turn "
            "them",
            remedy="if the camera was calibrated by turned pictures, turn the pixels; in any case "
            "remove the tag",
        )
    ]


def _check_clouds(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> list[Problem]:
    """Find clouds that all have zero points or were cut, and warn of empty ones among others."""
    clouds = [frame.points for frame in frames if frame.points is not None]
    empty = [path for path in clouds if holds_no_point(path)]
    if 0 < len(empty) < len(clouds):
        warn_user(
            f"{empty[0]}: holds no point{_more(empty)}, of {len(clouds)} point clouds: check "
            "whether the LiDAR delivered points",
        )
    return [
        *_check_all_empty(clouds, holds_no_point, "clouds, all without a point"),
        *check_cut_sweeps(clouds),
    ]


def _check_all_empty(
    paths: Sequence[Path],
    is_empty: Callable[[Path], bool],
    described: str,
    remedy: str = "check whether the LiDAR delivered points, and how they were converted",
) -> list[Problem]:
    """Find the folders of files that all hold nothing; single empty ones are no problem."""
    if not all(map(is_empty, paths)):
        return []
    counts = Counter(path.parent for path in paths)
    return [
        Problem(path=folder, problem=f"holds {count} {described}", remedy=remedy)
        for folder, count in counts.items()
    ]


def _is_blank(path: Path) -> bool:
    size = _size(path)
    return size is not None and size <= _MAX_BLANK_BYTES


def _holds_no_object(path: Path) -> bool:
    """Test if a label file is readable and has no object but regions of DontCare."""
    objects = read_or_note(read_labels, path, [])
    return objects is not None and set(objects.class_names) <= {"DontCare"}


def _holds_no_depth(path: Path) -> bool:
    """Test if a depth map is readable and has no depth."""
    depth_m = read_or_note(read_depth_png, path, [])
    return depth_m is not None and not depth_m.any()


def _check_image_sizes(frames: Sequence[ObjectFrame]) -> list[Problem]:
    """Find images of other sizes than most with the same camera matrix (P2).

    Each of the four camera matrices of KITTI's 7,481 training frames has one size of image.
    """
    by_camera: dict[Hashable, list[Path]] = defaultdict(list)
    for frame in frames:
        matrices = read_or_note(read_object_matrices, frame.calibration, [])
        if matrices is not None and frame.image is not None:
            by_camera[matrices.image_from_camera.tobytes()].append(frame.image)
    return [each for images in by_camera.values() for each in _check_sizes_of_camera(images)]


def _check_sizes_of_camera(images: Sequence[Path]) -> list[Problem]:
    """Find images of other sizes than most images of their camera, one problem a size.

    If no size is the most frequent one, a single problem lists all sizes.
    """
    by_size: dict[tuple[int, int], list[Path]] = defaultdict(list)
    for image in images:
        size = read_or_note(read_image_size, image, [])
        if size is not None:
            by_size[size].append(image)
    if len(by_size) < 2:
        return []
    remedy = "give the calibrated image, or its own calibration"
    (usual, usual_images), (_, next_images), *_ = sorted(
        by_size.items(), key=lambda each: -len(each[1])
    )
    if len(usual_images) == len(next_images):
        sizes = [
            f"{images_of_size[0].name} of {height}x{width}{_more(images_of_size)}"
            for (height, width), images_of_size in by_size.items()
        ]
        listed = ", ".join(sizes[:_MAX_LISTED]) + (", ..." if len(sizes) > _MAX_LISTED else "")
        problem = (
            f"holds images of {len(sizes)} sizes (height x width) with the same calibration, and "
            f"none is the most frequent: {listed}"
        )
        return [Problem(path=usual_images[0].parent, problem=problem, remedy=remedy)]
    return [
        Problem(
            path=differing[0],
            problem=f"is {size[0]}x{size[1]} (height x width){_more(differing)}, expected "
            f"{usual[0]}x{usual[1]} like {len(usual_images)} images of the same calibration",
            remedy=remedy,
        )
        for size, differing in by_size.items()
        if size != usual
    ]


def _other_name(path: Path, first: Path) -> str:
    """Name of a file, with the folders by which it differs from another of the same name."""
    if path.stem != first.stem:
        return path.stem
    return str(path.relative_to(os.path.commonpath((path, first))))


def _describe_repeats(groups: Sequence[Sequence[Path]], kind: str) -> list[Problem]:
    remedy = f"give each frame its own {kind}"
    listed = groups[:_MAX_LISTED] if len(groups) > _MAX_LISTED + 1 else groups
    problems = [
        Problem(
            path=first,
            problem=f"is the same {kind}, byte for byte, as that of {len(others)} other "
            f"{'frame' if len(others) == 1 else 'frames'} "
            f"({describe_absent([_other_name(path, first) for path in others])})",
            remedy=remedy,
        )
        for first, *others in listed
    ]
    if len(groups) > len(listed):
        first = groups[_MAX_LISTED][0]
        more = (
            f"is of one of {len(groups) - _MAX_LISTED} more groups of frames with the same {kind}"
        )
        problems.append(Problem(path=first, problem=more, remedy=remedy))
    return problems


def _more(paths: Sequence[Path]) -> str:
    return f", like {len(paths) - 1} more" if len(paths) > 1 else ""


def _is_blank_or_unreadable(path: Path) -> bool:
    """Whether an image is unreadable, which its reader reports, or has a single colour."""
    image = read_or_note(read_rgb, path, [])
    return image is None or is_blank(image)


def _has_box3d(path: Path) -> bool:
    objects = read_or_note(read_labels, path, [])
    return objects is not None and bool(visible_objects(objects, within_m=math.inf))


def _equal_files(paths: Sequence[Path]) -> list[list[Path]]:
    """Group equal files that are not empty; most are distinguished without reading them."""
    groups = [list(paths)]
    for key in (_size_to_compare, _middle_bytes, _digest):
        groups = [equal for group in groups for equal in _grouped(group, key)]
    return groups


def _grouped(paths: Iterable[Path], key: Callable[[Path], Hashable | None]) -> list[list[Path]]:
    """Group files by a key, leaving out those without one, and those alone with theirs."""
    by_key: dict[Hashable, list[Path]] = defaultdict(list)
    for path in paths:
        value = key(path)
        if value is not None:
            by_key[value].append(path)
    return [group for group in by_key.values() if len(group) > 1]


def _size(path: Path) -> int | None:
    """Length of a regular file; None: it is none, or absent."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None


def _size_to_compare(path: Path) -> int | None:
    size = _size(path)
    return size if size is not None and 0 < size <= _MAX_BYTES else None


def _middle_bytes(path: Path) -> bytes | None:
    """Some bytes from the middle, which differ between clouds of one length."""
    try:
        with path.open("rb") as file:
            file.seek(max(path.stat().st_size - _COMPARED_BYTES, 0) // 2)
            return file.read(_COMPARED_BYTES)
    except OSError:
        return None


def _digest(path: Path) -> bytes | None:
    try:
        # a pipe could be waited for without end
        if not path.is_file() or path.stat().st_size > _MAX_BYTES:
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "blake2b").digest()
    except OSError:
        return None
