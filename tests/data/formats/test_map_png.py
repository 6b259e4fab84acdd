import math
import struct
import zlib

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import (
    MAX_DEPTH_M,
    read_depth_png,
    read_mask_png,
    write_depth_png,
    write_instance_png,
    write_mask_png,
)
from sightline.files.problem import FileError
from tests.data.scenes import few, seeds
from tests.data.trees import depth_map

steps = arrays.arrays(np.uint16, arrays.array_shapes(min_dims=2, max_dims=2, max_side=9))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("depth") / "0.png"


@given(values=steps)
def test_every_16_bit_value_survives_reading_and_writing(path, values):
    depth_m = (values / 256).astype(np.float32)
    write_depth_png(path, depth_m)
    assert np.array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), values)
    assert np.array_equal(read_depth_png(path), depth_m)
    assert read_depth_png(path).dtype == np.float32


@given(depth=st.floats(0, 255.99))
def test_depths_are_rounded_half_up_and_none_vanishes(path, depth):
    write_depth_png(path, np.array([[depth]]))
    expected = max(math.floor(depth * 256 + 0.5), 1 if depth > 0 else 0)
    assert read_depth_png(path)[0, 0] * 256 == expected


def test_convention_a_half_step_is_rounded_up_and_zero_stays_no_value(path):
    write_depth_png(path, np.array([[0.0, 1 / 512, 2.5 / 256, 1e-9]]))
    assert (read_depth_png(path) * 256).tolist() == [[0, 1, 3, 1]]


@pytest.mark.parametrize("depth", [256.0, MAX_DEPTH_M + 1 / 256, -1.0, math.nan, math.inf, 1e308])
def test_a_depth_that_16_bits_cannot_hold_is_refused_with_its_place(tmp_path, depth):
    depth_m = np.zeros((3, 4))
    depth_m[1, 2] = depth
    with pytest.raises(ValueError, match=r"1 depths lie outside .* at row 1, column 2"):
        write_depth_png(tmp_path / "0.png", depth_m)
    assert list(tmp_path.iterdir()) == []


def test_a_depth_map_without_pixels_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least one pixel"):
        write_depth_png(tmp_path / "0.png", np.zeros((0, 4)))


@pytest.mark.parametrize(
    "pixels",
    [
        np.ones((3, 4), np.uint8),
        np.ones((3, 4, 3), np.uint8),
        np.ones((3, 4, 3), np.uint16),
        np.ones((3, 4, 4), np.uint16),
    ],
    ids=["8 bits", "8-bit colour", "16-bit colour", "16-bit colour and opacity"],
)
def test_pictures_that_are_no_depth_maps_are_refused_by_name(tmp_path, pixels):
    cv2.imwrite(str(tmp_path / "0.png"), pixels)
    with pytest.raises(ValueError, match=r"0\.png: is a PNG of .* expected a depth map: PNG, 1 ch"):
        read_depth_png(tmp_path / "0.png")


@pytest.mark.parametrize("length", [0, 10, 40, 200, -1])
def test_a_file_cut_short_is_refused_by_name(tmp_path, length):
    write_depth_png(tmp_path / "0.png", depth_map())
    whole = (tmp_path / "0.png").read_bytes()
    (tmp_path / "0.png").write_bytes(whole[:length])
    with pytest.raises(ValueError, match=r"0\.png: is"):
        read_depth_png(tmp_path / "0.png")


def test_a_flipped_bit_is_found_by_the_checksum(tmp_path):
    write_depth_png(tmp_path / "0.png", depth_map())
    content = bytearray((tmp_path / "0.png").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "0.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"0\.png: is damaged: a PNG checksum is wrong"):
        read_depth_png(tmp_path / "0.png")


@few
@given(size=st.tuples(st.integers(1, 20), st.integers(1, 20)), seed=seeds)
def test_a_mask_is_read_as_it_was_written(tmp_path_factory, size, seed):
    path = tmp_path_factory.mktemp("masks") / "0.png"
    mask = np.random.default_rng(seed).random(size) < 0.5
    write_mask_png(path, mask)
    assert np.array_equal(read_mask_png(path), mask)


def test_a_mask_of_another_maker_is_cut_at_middle_grey(tmp_path):
    levels = np.array([[0, 127, 128, 255]], dtype=np.uint8)
    write_rgb(tmp_path / "0.png", np.repeat(levels[..., None], 3, axis=2))
    assert read_mask_png(tmp_path / "0.png").tolist() == [[False, False, True, True]]


@pytest.mark.parametrize("channels", [3, 1])
def test_a_camera_picture_is_no_mask(tmp_path, channels):
    picture = np.random.default_rng(0).integers(0, 256, (40, 60, channels), dtype=np.uint8)
    write_rgb(tmp_path / "0.png", np.broadcast_to(picture, (40, 60, 3)))
    with pytest.raises(FileError, match=r"is a picture of \d+ levels, .* expected a mask"):
        read_mask_png(tmp_path / "0.png")


def test_a_mask_of_the_levels_0_and_1_would_be_all_false(tmp_path):
    write_rgb(tmp_path / "0.png", np.repeat(np.eye(4, dtype=np.uint8)[..., None], 3, axis=2))
    cv2.imwrite(str(tmp_path / "dark.png"), np.uint8([[0, 100], [100, 0]]))
    with pytest.raises(FileError, match="has no level above 100, expected a mask"):
        read_mask_png(tmp_path / "dark.png")
    green = np.zeros((2, 2, 3), np.uint8)
    green[0, :, 1] = 255
    cv2.imwrite(str(tmp_path / "green.png"), green)
    assert read_mask_png(tmp_path / "green.png").tolist() == [[True, True], [False, False]]
    with pytest.raises(FileError, match="has no level above 1, expected a mask: 255 for True"):
        read_mask_png(tmp_path / "0.png")


def test_what_is_no_mask_is_refused(tmp_path):
    with pytest.raises(ValueError, match="at least one pixel"):
        write_mask_png(tmp_path / "0.png", np.zeros((0, 4), dtype=np.bool_))
    (tmp_path / "0.png").write_bytes(b"no picture")
    with pytest.raises(FileError):
        read_mask_png(tmp_path / "0.png")


def test_masked_depths_have_no_value_and_tensors_are_taken(tmp_path):
    far = np.ma.masked_greater(np.array([[3.0, 0, 20, 60]]), 50)
    write_depth_png(tmp_path / "0.png", far)
    assert read_depth_png(tmp_path / "0.png").tolist() == [[3, 0, 20, 0]]
    write_depth_png(tmp_path / "0.png", np.ma.masked_less(np.array([[3.0, -1, 20]]), 0))
    assert read_depth_png(tmp_path / "0.png").tolist() == [[3, 0, 20]]
    write_depth_png(tmp_path / "1.png", torch.tensor([[3.0, 0, 20]]))
    assert read_depth_png(tmp_path / "1.png").tolist() == [[3, 0, 20]]


@pytest.mark.parametrize(
    ("write", "given", "said"),
    [
        (
            write_depth_png,
            np.ones((1, 3, 4)),
            r"\(1, 3, 4\), expected numbers of height, width; give",
        ),
        (write_depth_png, np.array([["a"]]), "expected numbers of height, width; give metres"),
        (write_mask_png, np.array([[0, 1, 255]]), "is int64 of .*, expected bool of height, width"),
        (write_mask_png, np.array([[0.7]]), "is float64 of shape .*, expected bool"),
        (write_mask_png, np.ma.masked_equal([[True, False]], True), "1 of 2 values masked"),
        (write_instance_png, np.array([[1.7]]), "expected whole numbers of height, width; convert"),
        (write_instance_png, np.zeros((2, 2, 1), np.int32), "expected whole numbers"),
    ],
)
def test_maps_of_other_shapes_and_types_are_not_written(tmp_path, write, given, said):
    with pytest.raises(ValueError, match=rf"0\.png .*{said}"):
        write(tmp_path / "0.png", given)
    assert not (tmp_path / "0.png").exists()


@pytest.mark.parametrize("orientation", [2, 3, 6])
def test_a_note_on_the_orientation_of_a_map_is_not_followed(tmp_path, orientation):
    path = tmp_path / "map.png"
    depth = np.arange(12, dtype=np.float32).reshape(3, 4)
    write_depth_png(path, depth)
    content = path.read_bytes()
    note = b"eXIf" + struct.pack(">2sHIHHHIHHI", b"MM", 42, 8, 1, 0x112, 3, 1, orientation, 0, 0)
    chunk = struct.pack(">I", len(note) - 4) + note + struct.pack(">I", zlib.crc32(note))
    header_end = 33
    path.write_bytes(content[:header_end] + chunk + content[header_end:])
    np.testing.assert_array_equal(read_depth_png(path), depth)
