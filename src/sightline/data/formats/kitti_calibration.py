"""KITTI's calibration files: readers, writers and plausibility checks of their matrices.

There are two formats with the same contents: one file per frame in the object benchmark, files
per day in raw recordings. Without PyTorch, so that checks start at once; `kitti_files` converts
the matrices to a `Calibration`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.image_file import read_rgb
from sightline.files.plain_file import as_path
from sightline.files.plain_text import (
    MAX_CALIBRATION_BYTES,
    parse_numbers,
    read_text,
    shortened,
)
from sightline.files.problem import FileError, Problem, read_or_note
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.kitti_sizes import CROP_REMEDY, kitti_size_doubt
from sightline.geometry.mount import (
    MAX_OFFSET_M,
    focal_fault,
    mount_doubt,
    off_centre_doubt,
    resolution_doubt,
    size_doubt,
    skew_doubt,
    stretch_doubt,
)
from sightline.geometry.road_height import (
    MAX_LIDAR_HEIGHT_M,
    MAX_TILT_DEG,
    MIN_LIDAR_HEIGHT_M,
    LidarPose,
)
from sightline.geometry.rotations import rotation_fault
from sightline.geometry.tilt import Tilt

_LIMIT = 1e9  # far above any focal length, baseline or mounting; products stay finite
_LAST_ROW_TOLERANCE = 1e-9
_ROUNDING: Final = 1e-5  # hundredths of a pixel, of a millimetre and of an arc minute
_REMEDY = "correct it or extract the calibration archive again"
_NO_LIDAR_REMEDY: Final = (
    f"{_REMEDY}; for a level camera without a LiDAR add 'R0_rect: 1 0 0 0 1 0 0 0 1' and "
    "'Tr_velo_to_cam: 0 -1 0 0 0 0 -1 H 1 0 0 0', where H is the camera's height above the road "
    f"less {KITTI_LIDAR_HEIGHT_M} m"
)
_HEIGHT_ENTRY, _TILT_ENTRY = "lidar_height_m", "lidar_tilt_deg"
_TRACKING_NAMES: Final = {
    "R_rect": "R0_rect",
    "Tr_velo_cam": "Tr_velo_to_cam",
    "Tr_imu_velo": "Tr_imu_to_velo",
}
"""Names of the object benchmark by those of the tracking benchmark."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationMatrices:
    """The two matrices of a `sightline.geometry.calibration.Calibration`, checked."""

    image_from_camera: Float64[np.ndarray, "3 4"]
    camera_from_lidar: Float64[np.ndarray, "4 4"]

    @property
    def stacked(self) -> Float64[np.ndarray, "7 4"]:
        """All numbers, one matrix below the other."""
        return np.vstack((self.image_from_camera, self.camera_from_lidar))


def read_object_matrices(path: Path | str) -> CalibrationMatrices:
    """Read P2, R0_rect and Tr_velo_to_cam of an object benchmark's calibration file.

    The entries of other cameras and the IMU are optional and ignored. KITTI's tracking benchmark
    calls the last two R_rect and Tr_velo_cam, without a colon; Tr of its odometry benchmark is
    their product.

    Raises:
        FileError: One of the three is missing, has a wrong number of values, is not numeric or
            singular, or is not a valid rotation.
    """
    entries = _object_entries(path)
    projection = _matrix(entries, "P2", (3, 4), path)
    if not {"R0_rect", "Tr_velo_to_cam"} & entries.keys():
        problem = "lacks R0_rect and Tr_velo_to_cam, expected lines with 9 and 12 numbers"
        raise FileError(path, problem, _NO_LIDAR_REMEDY)
    rectification = _matrix(entries, "R0_rect", (3, 3), path)
    mounting = _matrix(entries, "Tr_velo_to_cam", (3, 4), path)
    _check_projection(projection, path, "P2")
    return CalibrationMatrices(
        image_from_camera=projection,
        camera_from_lidar=_rectified(rectification, mounting, path, ("R0_rect", "Tr_velo_to_cam")),
    )


def read_raw_matrices(folder: Path | str) -> CalibrationMatrices:
    """Read camera 2's part of `calib_cam_to_cam.txt` and all of `calib_velo_to_cam.txt`.

    Raises:
        FileError: A file lacks P_rect_02, R_rect_00, R or T, or one of them is invalid; see
            `read_object_matrices`.
    """
    folder = as_path(folder)
    cameras, lidar = folder / "calib_cam_to_cam.txt", folder / "calib_velo_to_cam.txt"
    entries = _read_entries(cameras)
    projection = _matrix(entries, "P_rect_02", (3, 4), cameras)
    rectification = _matrix(entries, "R_rect_00", (3, 3), cameras)
    _check_projection(projection, cameras, "P_rect_02")
    return CalibrationMatrices(
        image_from_camera=projection,
        camera_from_lidar=_rectified(
            rectification,
            read_rigid_transform(lidar)[:3],
            cameras,
            ("R_rect_00", f"R of {lidar.name}"),
        ),
    )


def read_intrinsics(path: Path | str) -> Float64[np.ndarray, "3 3"]:
    """Read the nine numbers of an `intrinsics` file of the depth benchmark, row by row.

    Raises:
        FileError: There are not nine numbers, or they are no valid camera.
    """
    values = parse_numbers(_read(path).split(), path, limit=_LIMIT)
    if len(values) != 9:
        raise FileError(
            path, f"holds {len(values)} numbers, expected the 9 of a 3x3 matrix", _REMEDY
        )
    intrinsics = np.array(values).reshape(3, 3)
    _check_projection(intrinsics, path, "the matrix")
    return intrinsics


def read_rectified_intrinsics(path: Path | str, camera: int) -> Float64[np.ndarray, "3 3"]:
    """Read the left 3x3 part of P_rect_0N of a `calib_cam_to_cam.txt`.

    Raises:
        FileError: The entry is missing, has a wrong number of values, is not numeric or singular.
    """
    name = f"P_rect_{camera:02d}"
    projection = _matrix(_read_entries(path), name, (3, 4), path)
    _check_projection(projection, path, name)
    return projection[:, :3]


def read_rigid_transform(path: Path | str) -> Float64[np.ndarray, "4 4"]:
    """Read the R and T of a `calib_velo_to_cam.txt` or `calib_imu_to_velo.txt`.

    Raises:
        FileError: One is missing, has a wrong number of values or is not numeric, or R is not a
            rotation.
    """
    entries = _read_entries(path)
    target_from_source = np.eye(4)
    target_from_source[:3, :3] = _matrix(entries, "R", (3, 3), path)
    target_from_source[:3, 3:] = _matrix(entries, "T", (3, 1), path)
    _check_rotation(target_from_source[:3, :3], path, "R")
    return target_from_source


def read_stated_size(path: Path | str, name: str) -> tuple[int, int] | None:
    """Read a camera's image size from a `calib_cam_to_cam.txt`; None: the file does not state it.

    Args:
        path: The file, which holds the width before the height.
        name: Entry: S_rect_02, or S_02 for the size before the rectification.

    Returns:
        Height, width [px].

    Raises:
        FileError: The entry has a wrong number of values, or is not numeric.
    """
    entries = _read_entries(path)
    if name not in entries:
        return None
    width, height = _matrix(entries, name, (1, 2), path)[0].tolist()
    return round(height), round(width)


def have_same_values(path: Path, other: Path) -> bool:
    """Compare the numbers of the entries that two calibration files share, but for rounding.

    Entries without numbers, such as the time of the calibration, are not compared, nor is a file
    that cannot be read.
    """
    try:
        entries, others = _read_entries(path), _read_entries(other)
    except FileError:
        return True
    common = entries.keys() & others.keys()
    return all(_are_close(entries[name], others[name], path) for name in common)


def _are_close(words: list[str], others: list[str], path: Path) -> bool:
    try:
        values, other_values = parse_numbers(words, path), parse_numbers(others, path)
    except FileError:
        return True
    return len(values) == len(other_values) and np.allclose(
        values, other_values, rtol=_ROUNDING, atol=_ROUNDING
    )


def object_calibration_text(matrices: CalibrationMatrices, pose: LidarPose | None = None) -> str:
    """The text of an object benchmark's calibration file, exact to the last bit.

    The given camera is written for all four (P0 to P3), the rectification is the identity and
    Tr_velo_to_cam is the complete transform to the rectified camera. Tr_imu_to_velo is not used
    here and is the identity. A known mount over the road follows, as `read_object_pose` reads it.
    """
    identity = np.eye(4)
    entries: list[tuple[str, Float64[np.ndarray, "..."]]] = [
        (f"P{camera}", matrices.image_from_camera) for camera in range(4)
    ]
    entries += [
        ("R0_rect", identity[:3, :3]),
        ("Tr_velo_to_cam", matrices.camera_from_lidar[:3]),
        ("Tr_imu_to_velo", identity[:3]),
    ]
    return _entries_text([*entries, *_pose_entries(pose)])


def _pose_entries(pose: LidarPose | None) -> list[tuple[str, Float64[np.ndarray, "..."]]]:
    """Entries that `read_object_pose` reads; empty: the pose is not known."""
    if pose is None or pose.height_m is None:
        return []
    tilt_deg = (0.0, 0.0) if pose.tilt is None else (pose.tilt.roll_deg, pose.tilt.pitch_deg)
    return [(_HEIGHT_ENTRY, np.array([pose.height_m])), (_TILT_ENTRY, np.array(tilt_deg))]


def read_object_pose(path: Path | str) -> LidarPose | None:
    """Read the mount of the LiDAR over the road, an addition to KITTI's format; None: not given.

    It has two lines, which other readers of KITTI's files ignore: the height [m], and roll and
    pitch [degrees] as in `Tilt`.

    Raises:
        FileError: One of the two is missing, not numeric or not plausible.
    """
    entries = _read_entries(path)
    if _HEIGHT_ENTRY not in entries and _TILT_ENTRY not in entries:
        return None
    height_m = float(_matrix(entries, _HEIGHT_ENTRY, (1, 1), path)[0, 0])
    roll_deg, pitch_deg = _matrix(entries, _TILT_ENTRY, (1, 2), path)[0].tolist()
    if not MIN_LIDAR_HEIGHT_M <= height_m <= MAX_LIDAR_HEIGHT_M:
        problem = (
            f"{_HEIGHT_ENTRY} is {height_m:g} m, expected {MIN_LIDAR_HEIGHT_M:g} to "
            f"{MAX_LIDAR_HEIGHT_M:g}"
        )
        raise FileError(path, problem, _REMEDY)
    if max(abs(roll_deg), abs(pitch_deg)) > MAX_TILT_DEG:
        problem = f"{_TILT_ENTRY} exceeds {MAX_TILT_DEG:g} degrees, expected a LiDAR nearly level"
        raise FileError(path, problem, _REMEDY)
    is_tilted = bool(roll_deg or pitch_deg)
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg) if is_tilted else None
    return LidarPose(height_m=height_m, tilt=tilt)


def read_drive_pose(folder: Path | str) -> LidarPose | None:
    """Read the mount of a drive's LiDAR from `calib_velo_to_cam.txt`; see `read_object_pose`."""
    return read_object_pose(as_path(folder) / "calib_velo_to_cam.txt")


def raw_calibration_texts(
    matrices: CalibrationMatrices, pose: LidarPose | None = None
) -> tuple[str, str]:
    """The texts of `calib_cam_to_cam.txt` and `calib_velo_to_cam.txt`, exact to the last bit.

    As in `object_calibration_text` the rectification is the identity, and a known mount follows.
    """
    cameras = [("R_rect_00", np.eye(3)), ("P_rect_02", matrices.image_from_camera)]
    lidar = [
        ("R", matrices.camera_from_lidar[:3, :3]),
        ("T", matrices.camera_from_lidar[:3, 3]),
        *_pose_entries(pose),
    ]
    return _entries_text(cameras), _entries_text(lidar)


def _entries_text(entries: Sequence[tuple[str, Float64[np.ndarray, "..."]]]) -> str:
    return "".join(
        f"{name}: {' '.join(f'{value:.16e}' for value in matrix.flat)}\n"
        for name, matrix in entries
    )


def _read(path: Path | str) -> str:
    return read_text(path, max_bytes=MAX_CALIBRATION_BYTES)


def _object_entries(path: Path | str) -> dict[str, list[str]]:
    """Read the entries of an object tree's file, also of the odometry benchmark.

    Raises:
        FileError: A line has another form, or the names are those of Waymo's data in KITTI's form.
    """
    entries = _read_entries(path)
    mounting = "Tr_velo_to_cam"
    if mounting not in entries and f"{mounting}_0" in entries:
        raise FileError(
            path,
            f"has {mounting}_0, a name of Waymo's data in KITTI's form, where P2 is another camera",
            f"write the chosen camera's projection as P2 and its transform as {mounting}, and give "
            "its pictures as image_2 and its labels as label_2 (camera 0, image_0, looks ahead)",
        )
    if "Tr" in entries and not {mounting, "R0_rect"} & entries.keys():
        entries["R0_rect"], entries[mounting] = [*"100010001"], entries["Tr"]
    return entries


def _read_entries(path: Path | str) -> dict[str, list[str]]:
    """Read the words of each name from a file with lines `NAME: word word ...`.

    Names of the tracking benchmark, which stand without a colon, become those of the object
    benchmark.
    """
    entries: dict[str, list[str]] = {}
    for number, line in enumerate(_read(path).split("\n"), start=1):
        name, colon, values = line.strip().partition(":")
        words = line.split()
        if words and not colon and words[0] in _TRACKING_NAMES:
            name, colon, values = words[0], " ", " ".join(words[1:])
        if not name and not colon:
            continue
        if not colon or name in entries:
            fault = "stands there twice" if colon else "has no colon"
            raise FileError(
                path,
                f"line {number}: '{shortened(name, 24)}' {fault}, expected lines 'NAME: numbers' "
                "with each name once",
                _REMEDY,
            )
        entries[name] = values.split()
    for other, name in _TRACKING_NAMES.items():
        if other in entries:
            entries.setdefault(name, entries.pop(other))
    return entries


def _matrix(
    entries: Mapping[str, list[str]], name: str, shape: tuple[int, int], path: Path | str
) -> Float64[np.ndarray, "rows columns"]:
    expected = f"{shape[0] * shape[1]} numbers ({shape[0]}x{shape[1]})"
    if name not in entries:
        raise FileError(path, f"lacks {name}, expected a line '{name}:' with {expected}", _REMEDY)
    words = entries[name]
    if len(words) != shape[0] * shape[1]:
        raise FileError(path, f"{name} holds {len(words)} values, expected {expected}", _REMEDY)
    return np.array(parse_numbers(words, path, f"{name}:", limit=_LIMIT)).reshape(shape)


def _check_projection(
    projection: Float64[np.ndarray, "3 columns"], path: Path | str, name: str
) -> None:
    intrinsics = projection[:, :3]
    scale = np.abs(intrinsics).max()
    if scale == 0 or abs(np.linalg.det(intrinsics / scale)) < 1e-12:
        raise FileError(
            path,
            f"{name} is singular in its left 3x3 part, so no pixel has a ray, expected focal "
            "lengths other than zero",
            _REMEDY,
        )
    if np.abs(intrinsics[2] - (0, 0, 1)).max() > _LAST_ROW_TOLERANCE:
        raise FileError(
            path,
            f"{name} has the third row {intrinsics[2].tolist()}, expected 0 0 1 as of a rectified "
            "camera, or depth would not be in metres",
            _REMEDY,
        )


def _rectified(
    rectification: Float64[np.ndarray, "3 3"],
    mounting: Float64[np.ndarray, "3 4"],
    path: Path | str,
    names: tuple[str, str],
) -> Float64[np.ndarray, "4 4"]:
    _check_rotation(rectification, path, names[0])
    _check_rotation(mounting[:, :3], path, names[1])
    camera_from_lidar = np.eye(4)
    camera_from_lidar[:3] = rectification @ mounting
    # The product of two rotations just within the tolerance may be outside.
    _check_rotation(camera_from_lidar[:3, :3], path, " times ".join(names))
    return camera_from_lidar


def _check_rotation(rotation: Float64[np.ndarray, "3 3"], path: Path | str, name: str) -> None:
    fault = rotation_fault(rotation)
    if fault is not None:
        raise FileError(path, f"{name} holds no rotation: {fault}", _REMEDY)


def check_matrices(
    matrices: CalibrationMatrices,
    size: tuple[int, int] | None,
    path: Path,
    *,
    tilt: Tilt | None = None,
    remedy: str = _REMEDY,
    picture: Path | None = None,
) -> list[Problem]:
    """Find implausible values in a calibration.

    Args:
        matrices: Matrices as read.
        size: Height and width of the image, if known.
        path: File or folder of the matrices.
        tilt: Given tilt of the LiDAR, by which the camera is not upright in its frame.
        remedy: Remedy; by default that of KITTI's files.
        picture: See `check_intrinsics`.
    """
    intrinsics, column = np.hsplit(matrices.image_from_camera, [3])
    offset_m = float(np.linalg.norm(np.linalg.solve(intrinsics, column[:, 0])))
    doubts = []
    if offset_m > MAX_OFFSET_M:
        doubts.append(
            f"has a camera {offset_m:.4g} m from the rectified origin, expected at most "
            f"{MAX_OFFSET_M:.0f} m"
        )
    level_from_lidar = np.eye(4) if tilt is None else tilt.level_from_lidar
    mount = mount_doubt(matrices.camera_from_lidar @ level_from_lidar.T)
    if mount is not None:
        doubts.append(f"holds a transform from LiDAR to camera that {mount}")
    return check_intrinsics(intrinsics, size, path, remedy=remedy, picture=picture) + [
        Problem(path=path, problem=doubt, remedy=remedy) for doubt in doubts
    ]


def check_intrinsics(
    intrinsics: Float64[np.ndarray, "3 3"],
    size: tuple[int, int] | None,
    path: Path,
    *,
    usual: bool = True,
    remedy: str = _REMEDY,
    picture: Path | None = None,
) -> list[Problem]:
    """Find implausible focal lengths and principal points.

    Args:
        intrinsics: Camera matrix [px].
        size: Height and width of the image, if known.
        path: File of the matrix.
        usual: Whether to doubt also what is possible but unusual: pixels that are no squares, a
            principal point away from the centre, and a matrix for another resolution.
        remedy: See `check_matrices`.
        picture: Image, whose size is compared with that of KITTI's if the matrix is one of KITTI's;
            None: it is not compared.
    """
    doubt = (
        focal_fault(intrinsics)
        or (stretch_doubt(intrinsics) if usual else None)
        or skew_doubt(intrinsics)
        or (None if size is None else size_doubt(intrinsics, size))
    )
    if doubt is None and usual and size is not None:
        resolution = resolution_doubt(intrinsics, size)
        doubt = (
            off_centre_doubt(intrinsics, size)
            if resolution is None
            else f"holds a camera matrix that {resolution}"
        )
    if doubt is None and usual and size is not None and picture is not None:
        read_image = partial(read_or_note, read_rgb, picture, [])
        doubt = kitti_size_doubt(intrinsics, size, read_image)
        if doubt is not None:
            doubt, remedy = f"holds a camera matrix that {doubt}", CROP_REMEDY
    return [] if doubt is None else [Problem(path=path, problem=doubt, remedy=remedy)]
