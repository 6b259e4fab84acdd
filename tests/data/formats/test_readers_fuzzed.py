"""Any bytes give a value or a ValueError of one line that names the file."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    read_intrinsics,
    read_object_matrices,
    read_raw_matrices,
    read_rectified_intrinsics,
    read_rigid_transform,
)
from sightline.data.formats.kitti_files import read_object_calibration
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.map_png import read_depth_png
from sightline.data.formats.velodyne import read_sweep
from sightline.data.layouts.drive_poses import read_oxts_poses, read_poses
from sightline.data.layouts.drive_times import read_timestamps
from sightline.data.layouts.frame_lists import read_sample_list
from tests.data.formats.test_image_file import png
from tests.data.trees import depth_map, picture

NUMBERS = ("0", "1", "-1", "1.5e3", "nan", "-inf", "1e400", "1e308", "9" * 5000, "1_0", "x", "٣")
NAMES = (
    *("P2:", "R0_rect:", "Tr_velo_to_cam:", "P_rect_02:", "R_rect_00:", "R:", "T:", "P2"),
    *("Car", "2011-09-26", "13:02:25.5", "\n", "\r\n", "\0", "\u2028", "\ufeff", ":", "#"),
)
IDENTITY = "1 0 0 0 1 0 0 0 1"
VALID_TEXTS = (
    f"P2: 7 0 6 0 0 7 2 0 0 0 1 0\nR0_rect: {IDENTITY}\nTr_velo_to_cam: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    f"P_rect_02: 7 0 6 0 0 7 2 0 0 0 1 0\nR_rect_00: {IDENTITY}\nR: {IDENTITY}\nT: 0 0 0\n",
    "1 0 0 0 0 1 0 0 0 0 1 0\n" * 2,
    "2011-09-26 13:02:25.964389445\n" * 2,
    "Car 0.10 0 -1.57 5 3 20 9 1.5 1.6 3.9 0.5 1.6 12 -1.53\n",
    " ".join(["0.5"] * 30),
)


def read_raw_pair(path: Path) -> object:
    """Both files of a raw recording with the same content."""
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        (path.parent / name).write_bytes(path.read_bytes())
    return read_raw_matrices(path.parent)


def read_oxts(path: Path) -> object:
    """One reading, with a mounting that is right."""
    mounting = path.with_name("calib_imu_to_velo.txt")
    mounting.write_text(f"R: {IDENTITY}\nT: 0 0 0\n")
    return read_oxts_poses([path], mounting)


READERS: tuple[Callable[[Path], object], ...] = (
    read_sweep,
    read_rgb,
    read_image_size,
    read_depth_png,
    read_labels,
    read_object_matrices,
    read_object_calibration,
    read_raw_pair,
    read_intrinsics,
    lambda path: read_rectified_intrinsics(path, 2),
    read_rigid_transform,
    read_poses,
    read_timestamps,
    read_oxts,
    lambda path: read_sample_list(path, path.parent),
)


def encoded(suffix: str, pixels: np.ndarray) -> bytes:
    return cv2.imencode(suffix, pixels)[1].tobytes()


VALID_BINARIES = (
    encoded(".png", (depth_map() * 256).astype(np.uint16)),
    encoded(".png", picture()),
    encoded(".jpg", picture()),
    np.ones((3, 4), "<f4").tobytes(),
)

texts = st.lists(st.sampled_from(NUMBERS + NAMES), max_size=40).map(" ".join).map(str.encode)
pngs = st.builds(
    png,
    st.integers(0, 2**32 - 1) | st.integers(0, 9),
    st.integers(0, 2**32 - 1) | st.integers(0, 9),
    data=st.binary(max_size=200),
    bits=st.sampled_from([0, 1, 8, 16, 255]),
    colour_type=st.integers(0, 7),
)


@st.composite
def damaged(draw: st.DrawFn) -> bytes:
    """A valid file with some bytes changed, put in or left out."""
    content = bytearray(draw(st.sampled_from(VALID_BINARIES + tuple(map(str.encode, VALID_TEXTS)))))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(content)))
        end = start + draw(st.integers(0, 4))
        content[start:end] = draw(st.binary(max_size=4))
    return bytes(content)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzzed") / "0.dat"


def complaint(reader: Callable[[Path], object], path: Path) -> str | None:
    """What the reader says of a file that it refuses; None where it gives a value."""
    try:
        assert reader(path) is not None
    except ValueError as error:
        return str(error)
    return None


@pytest.mark.filterwarnings("ignore:.*points are left out")
@settings(max_examples=400, suppress_health_check=[HealthCheck.too_slow])
@given(content=st.binary(max_size=200) | damaged() | texts | pngs)
def test_any_bytes_give_a_value_or_one_line_that_names_the_file(path, content):
    path.write_bytes(content)
    for said in (complaint(reader, path) for reader in READERS):
        assert said is None or (str(path.parent) in said and "\n" not in said and len(said) < 1000)


@pytest.mark.parametrize(
    "content",
    [b"1" * 10**7, b"1 " * 10**6, b"P2: " + b"1 " * 10**6, b"a\n" * 10**6],
    ids=["one word", "one line", "one entry", "many lines"],
)
def test_very_long_lines_and_very_many_lines_are_answered_at_once(path, content):
    path.write_bytes(content)
    for said in (complaint(reader, path) for reader in READERS):
        assert said is None or (str(path.parent) in said and len(said) < 1000)


def test_a_text_file_of_absurd_size_is_refused_unread(path):
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(ValueError, match=r"0\.dat: is 1099511627776 bytes long, expected up to"):
        read_poses(path)
    path.write_bytes(b"")
