import struct
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pypcd4 import Encoding, PointCloud

from sightline.data.formats.point_files import read_cloud
from sightline.data.formats.rings import ring_numbers
from sightline.files.problem import FileError
from tests.data.recordings import POINTS, write_cloud_file

SCALED = POINTS * np.float32([1, 1, 1, 255])


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".pcd", ".PCD", ".ply"])
def test_a_cloud_of_any_format_is_the_simulated_one(tmp_path, suffix):
    path = tmp_path / f"cloud{suffix.lower()}"
    write_cloud_file(path)
    path = path.rename(tmp_path / f"cloud{suffix}")
    np.testing.assert_allclose(read_cloud(path, 255.0), POINTS, atol=1e-6)


@pytest.mark.parametrize("encoding", list(Encoding)[:3])
def test_every_encoding_of_pcd_is_read(tmp_path, encoding):
    path = tmp_path / "cloud.pcd"
    PointCloud.from_xyzi_points(SCALED[:50]).save(path, encoding)
    np.testing.assert_allclose(read_cloud(path, 255.0), POINTS[:50], rtol=1e-6, atol=1e-5)


def test_fields_are_found_by_name_and_what_is_not_finite_is_left_out(tmp_path):
    rows = np.zeros(
        3, [("ring", "u2"), ("z", "f8"), ("Reflectivity", "u1"), ("Y", "f4"), ("x", "f4")]
    )
    rows["x"], rows["Y"], rows["z"] = (1, np.nan, 3), (4, 5, 6), (7, 8, 9)
    rows["Reflectivity"] = (51, 0, 255)
    np.save(tmp_path / "cloud.npy", rows)
    expected = np.float32([[1, 4, 7, 0.2], [3, 6, 9, 1]])
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.npy", 255.0), expected)


@pytest.mark.parametrize("kind", ["(2,)f4", "S3", "c8"])
def test_a_field_that_is_no_number_a_point_is_refused_by_name(tmp_path, kind):
    np.save(tmp_path / "cloud.npy", np.zeros(3, [("x", "f4"), ("Y", kind), ("z", "f4")]))
    with pytest.raises(FileError, match=r"cloud.npy: has the field Y of .*, expected one number"):
        read_cloud(tmp_path / "cloud.npy")


def test_what_float32_cannot_hold_is_left_out_like_other_marks_of_no_echo(tmp_path):
    rows = np.zeros(2, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("i", "f8")])
    rows["x"] = (3, np.finfo(np.float64).max)
    np.save(tmp_path / "cloud.npy", rows)
    assert read_cloud(tmp_path / "cloud.npy").tolist() == [[3, 0, 0, 0]]


def test_an_archive_of_arrays_is_no_npy_file(tmp_path):
    np.savez(tmp_path / "cloud", points=POINTS)
    (tmp_path / "cloud.npz").rename(tmp_path / "cloud.npy")
    with pytest.raises(FileError, match=r"cloud.npy: is an archive of arrays \(.npz\), expected"):
        read_cloud(tmp_path / "cloud.npy")


def test_without_intensities_reflectance_is_none_and_an_empty_cloud_is_a_cloud(tmp_path):
    np.save(tmp_path / "cloud.npy", POINTS[:5, :3])
    with pytest.warns(UserWarning, match="have three columns, x, y, z: the reflectance of"):
        assert not read_cloud(tmp_path / "cloud.npy")[:, 3].any()
    np.save(tmp_path / "empty.npy", POINTS[:0])
    assert read_cloud(tmp_path / "empty.npy").shape == (0, 4)
    PointCloud.from_xyz_points(POINTS[:7, :3]).save(tmp_path / "cloud.pcd")
    with pytest.warns(UserWarning, match="have no intensity field among x, y, z: the reflectance"):
        points = read_cloud(tmp_path / "cloud.pcd")
    np.testing.assert_array_equal(points[:, :3], POINTS[:7, :3])


def test_an_organised_cloud_is_read_row_by_row(tmp_path):
    np.save(tmp_path / "cloud.npy", SCALED[:60].reshape(6, 10, 4))
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.npy", 255.0), POINTS[:60], atol=1e-6)


def test_points_without_an_echo_are_left_out(tmp_path):
    cloud = SCALED[:4].copy()
    cloud[1, :3] = 0  # as Ouster's drivers write it
    cloud[2, 0] = np.nan
    np.save(tmp_path / "cloud.npy", cloud)
    expected = POINTS[[0, 3]]
    np.testing.assert_allclose(read_cloud(tmp_path / "cloud.npy", 255.0), expected, atol=1e-6)
    np.save(
        tmp_path / "cloud.npy", np.array([[1e300, 0, 0, 0], [1, 2, 3, 0]])
    )  # more than float32 has
    np.testing.assert_array_equal(read_cloud(tmp_path / "cloud.npy"), [[1, 2, 3, 0]])


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".pcd", ".ply"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_intensity_costs_no_point_in_any_format(tmp_path, suffix, bad):
    path, cloud = tmp_path / f"cloud{suffix}", POINTS[:90].copy()
    cloud[:, 3] = bad
    write_cloud_file(path, cloud)
    with pytest.warns(UserWarning, match="90 of 90 points have an intensity that is not finite"):
        points = read_cloud(path, 255.0)
    np.testing.assert_array_equal(points[:, :3], POINTS[:90, :3])
    assert not points[:, 3].any()


@pytest.mark.parametrize("suffix", [".bin", ".npy", ".pcd", ".ply"])
def test_a_cloud_of_which_no_point_is_left_is_said_to_be_empty(tmp_path, suffix):
    path, cloud = tmp_path / f"cloud{suffix}", POINTS[:90].copy()
    cloud[:60, 2], cloud[60:, :3] = np.nan, 0
    write_cloud_file(path, cloud)
    with pytest.warns(UserWarning, match=rf"cloud{suffix}: 90 of 90 points .* none is left"):
        assert read_cloud(path, 255.0).shape == (0, 4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300, -1])
def test_fields_that_nobody_needs_may_hold_anything(tmp_path, bad):
    kinds = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", "f8"), ("ring", "f8"), ("i", "f4")]
    rows = np.zeros(9, kinds)
    rows["x"], rows["time"], rows["ring"] = 5, bad, bad
    np.save(tmp_path / "cloud.npy", rows)
    assert read_cloud(tmp_path / "cloud.npy").tolist() == [[5, 0, 0, 0]] * 9
    np.save(tmp_path / "rows.npy", np.hstack([POINTS[:9], np.full((9, 2), bad)]))
    with pytest.warns(UserWarning, match="have 6 columns: the first four are read as x, y, z"):
        np.testing.assert_array_equal(read_cloud(tmp_path / "rows.npy"), POINTS[:9])


def test_one_point_in_a_hundred_may_be_brighter_than_the_scale(tmp_path):
    cloud = SCALED[:300].clip(max=200)
    cloud[:3, 3] = 1000
    np.save(tmp_path / "cloud.npy", cloud)
    reflectance = read_cloud(tmp_path / "cloud.npy", 255.0)[:, 3]
    assert reflectance[:3].tolist() == [1, 1, 1]
    np.testing.assert_allclose(reflectance[3:], cloud[3:, 3] / 255, atol=1e-6)
    cloud[3, 3] = 1000
    np.save(tmp_path / "cloud.npy", cloud)
    with pytest.raises(FileError, match="intensities from 0 to 1000, expected 0 to 255"):
        read_cloud(tmp_path / "cloud.npy", 255.0)


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_a_pcd_of_fewer_points_than_it_declares_is_cut_short(tmp_path, data):
    path = tmp_path / "cloud.pcd"
    PointCloud.from_xyz_points(POINTS[:50, :3]).save(path, Encoding(data))
    content = path.read_bytes()
    lines = content.splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-9]) if data == "ascii" else content[: -9 * 12])
    with pytest.raises(FileError, match=r"holds 41 of the 50 declared points: it is cut short"):
        read_cloud(path)


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npy"])
@pytest.mark.parametrize("name", ["ring", "scalar_Ring"])
def test_a_field_of_rings_brings_points_into_kittis_order(tmp_path, suffix, name):
    path, rings = tmp_path / f"cloud{suffix}", ring_numbers(POINTS)
    laser = 63 - (rings - (POINTS[:, 1] < 0))  # from the bottom, as many drivers number them
    kinds = [(field, "<f4") for field in ("x", "y", "z", "intensity", name)]
    order = np.argsort(np.arctan2(POINTS[:, 1], POINTS[:, 0]))
    rows = np.hstack([POINTS, laser[:, None]])[order].astype(np.float32)
    if suffix == ".npy":
        np.save(path, rows.view(kinds).ravel())
    elif suffix == ".pcd":
        header = f"FIELDS x y z intensity {name}\nWIDTH {len(rows)}\nDATA binary\n"
        path.write_bytes(header.encode() + rows.tobytes())
    else:
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n"
        header += "".join(f"property float {field}\n" for field, _ in kinds) + "end_header\n"
        path.write_bytes(header.encode() + rows.tobytes())
    found = ring_numbers(read_cloud(path))
    assert abs(found.max() - rings.max()) <= 1
    np.testing.assert_array_equal(np.sort(read_cloud(path), axis=0), np.sort(POINTS, axis=0))


def test_rings_in_the_place_of_intensities_are_told_as_such(tmp_path):
    elevation = np.degrees(np.arctan2(POINTS[:, 2], np.hypot(*POINTS[:, :2].T)))
    rings = np.floor(elevation - elevation.min())[:, None]
    rows = np.hstack([POINTS[:, :3], rings, POINTS[:, 3:]])
    np.save(tmp_path / "cloud.npy", rows)
    with (
        pytest.warns(UserWarning, match="have 5 columns"),
        pytest.raises(FileError, match=r"holds ring numbers \(0 to \d+, .* x, y, z, intensity$"),
    ):
        read_cloud(tmp_path / "cloud.npy", 255.0)


def save(array):
    return lambda path: np.save(path, array)


@pytest.mark.parametrize("num_more", [4, 160])
def test_what_follows_the_array_of_an_npy_file_is_told(tmp_path, num_more):
    np.save(tmp_path / "cloud.npy", POINTS)
    with (tmp_path / "cloud.npy").open("ab") as file:
        file.write(bytes(num_more))
    with pytest.warns(UserWarning, match=f"cloud.npy: {num_more} bytes follow the array"):
        assert len(read_cloud(tmp_path / "cloud.npy")) == len(POINTS)


@pytest.mark.parametrize(
    ("kind", "is_doubted"),
    [("u1", True), ("u4", True), ("i2", True), ("i4", False), ("f2", False), (">f8", False)],
)
def test_coordinates_of_short_or_unsigned_integers_are_doubted(tmp_path, kind, is_doubted):
    rows = np.abs(POINTS[:100]).astype(kind)
    fields = np.zeros(100, [(name, kind) for name in "xyz"] + [("intensity", "u1")])
    for column, name in enumerate("xyz"):
        fields[name] = rows[:, column]
    for content in (rows, fields):
        np.save(tmp_path / "cloud.npy", content)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            read_cloud(tmp_path / "cloud.npy", 255.0)
        doubts = [each for each in caught if "they are in whole metres" in str(each.message)]
        assert bool(doubts) == is_doubted


def test_a_ply_of_two_sets_of_vertices_is_refused(tmp_path):
    element = "element vertex 0\nproperty float x\nproperty float y\nproperty float z\n"
    header = f"ply\nformat ascii 1.0\n{element}{element}end_header\n"
    (tmp_path / "cloud.ply").write_text(header)
    with pytest.raises(FileError, match="has several elements vertex"):
        read_cloud(tmp_path / "cloud.ply")


@pytest.mark.parametrize(
    ("name", "write", "said"),
    [
        ("a.npy", save(POINTS[:, :2]), "expected rows of x, y, z"),
        ("a.npy", save(POINTS[:500].T), r"of shape \(4, 500\), expected rows of x, y, z"),
        ("a.npy", save(np.array([None])), "is no .npy file of numbers: it holds Python objects"),
        ("a.npy", lambda path: path.write_bytes(b"\x93NUMPY\x01"), "is no whole .npy file"),
        ("a.npy", save(POINTS * 1000), "probably in millimetres"),
        ("a.npy", save(SCALED), "intensities from 0 to .* set max_intensity"),
        ("a.npy", save(np.zeros(2, [("x", "f4"), ("y", "f4")])), "has the fields x, y, but not z"),
        ("a.pcd", lambda path: path.write_bytes(b"VERSION .7\nFIELDS x y"), "is no whole PCD file"),
        ("a.pcd", lambda path: path.write_bytes(b""), "is no whole PCD file"),
        ("a.bin", lambda path: path.write_bytes(bytes(17)), "holds 17 bytes"),
    ],
)
def test_what_is_no_cloud_is_refused_by_name(tmp_path, name, write, said):
    path = tmp_path / name
    write(path)
    with pytest.raises(FileError, match=said) as caught:
        read_cloud(path)
    assert caught.value.problem.path == path


def test_a_pcd_that_declares_gigabytes_is_refused_unread(tmp_path):
    path = tmp_path / "cloud.pcd"
    PointCloud.from_xyzi_points(SCALED[:50]).save(path, Encoding.BINARY_COMPRESSED)
    content = path.read_bytes()
    body = content.index(b"\nDATA binary_compressed\n") + len(b"\nDATA binary_compressed\n")
    forged = struct.pack("<I", 2**31)
    path.write_bytes(content[: body + 4] + forged + content[body + 8 :])
    with pytest.raises(FileError, match="declares 2147483648 bytes"):
        read_cloud(path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(data=st.data(), suffix=st.sampled_from([".npy", ".pcd", ".ply"]))
def test_any_bytes_give_a_cloud_or_a_file_error(tmp_path, data, suffix):
    path = tmp_path / f"cloud{suffix}"
    write_cloud_file(path, POINTS[:9])
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        points = read_cloud(path, 255.0)
    except FileError:
        return
    assert points.shape[1] == 4
    assert np.isfinite(points).all()


def test_a_file_with_a_batch_of_clouds_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.stack((POINTS, POINTS)))
    with pytest.raises(FileError, match=r"holds 2 clouds by its shape .*; write one file for"):
        read_cloud(tmp_path / "a.npy")
