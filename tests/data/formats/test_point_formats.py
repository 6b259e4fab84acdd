import struct
import tracemalloc
import warnings

import lzf
import numpy as np
import pytest
from pypcd4 import Encoding, PointCloud

from sightline.data.formats.point_files import read_cloud
from sightline.files.problem import FileError

PLACES = np.array([[5.5, -1.25, 0.5, 0.25], [12, 3, -1.5, 1], [40, -20.5, 2, 0]], np.float32)
HEADER = {
    "VERSION": "0.7",
    "FIELDS": "x y z intensity",
    "SIZE": "4 4 4 4",
    "TYPE": "F F F F",
    "COUNT": "1 1 1 1",
    "WIDTH": "3",
    "HEIGHT": "1",
    "VIEWPOINT": "0 0 0 1 0 0 0",
    "POINTS": "3",
    "DATA": "ascii",
}
ASCII = "".join(" ".join(map(str, row)) + "\n" for row in PLACES.tolist())
BINARY = PLACES.tobytes()


def pcd(path, body=ASCII, *, without=(), before="", **changes):
    """A PCD file of these points, with some header lines changed or left out."""
    header = {**HEADER, **changes}
    lines = [f"{key} {value}\n" for key, value in header.items() if key not in without]
    content = body.encode() if isinstance(body, str) else body
    path.write_bytes((before + "".join(lines)).encode() + content)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cloud.pcd"


@pytest.mark.parametrize(
    ("body", "without", "changes"),
    [
        (ASCII, (), {}),
        (ASCII, ("COUNT",), {}),
        (ASCII, ("POINTS",), {}),
        (ASCII, ("WIDTH", "HEIGHT"), {}),
        (ASCII, ("HEIGHT", "POINTS"), {}),
        (ASCII, ("VIEWPOINT",), {"VERSION": ".5"}),
        (ASCII, ("SIZE", "TYPE", "COUNT", "VERSION"), {}),
        (ASCII, ("POINTS",), {"WIDTH": "1", "HEIGHT": "3"}),
        (ASCII.replace(" ", "\t"), (), {"VERSION": ".6", "FIELDS": "x\ty\tz\tintensity"}),
        (ASCII.replace(" ", "   "), (), {"SIZE": " 4  4 4  4 "}),
        (ASCII.replace("\n", " \n"), (), {}),
        (ASCII.replace("\n", "\r\n"), (), {}),
        (ASCII.replace("\n", "\r"), (), {}),
        (ASCII, (), {"VIEWPOINT": "0 0 0 -1 0 0 0"}),
        (ASCII.rstrip(), (), {}),
        ("\n" + ASCII.replace("\n", "\n\n"), (), {"DATA": "ASCII"}),
        ("# a remark\n" + ASCII, (), {}),
        (BINARY, (), {"DATA": "binary"}),
        (BINARY, ("COUNT", "POINTS"), {"DATA": "Binary"}),
        (BINARY + b"\n", (), {"DATA": "binary"}),
        (PLACES.astype("<f8").tobytes(), (), {"SIZE": "8 8 8 8", "DATA": "binary"}),
    ],
)
def test_every_legal_form_of_a_pcd_gives_the_same_points(path, body, without, changes):
    pcd(path, body, without=without, before="# .PCD\n#\tremark\n\n", **changes)
    np.testing.assert_array_equal(read_cloud(path), PLACES)


def test_header_lines_may_come_in_any_order_and_end_in_carriage_returns(path):
    lines = [f"{key} {value}\r\n" for key, value in HEADER.items() if key != "DATA"]
    path.write_bytes(("".join(reversed(lines)) + "DATA binary\r\n").encode() + BINARY)
    np.testing.assert_array_equal(read_cloud(path), PLACES)


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_gaps_and_fields_of_any_type_and_count_are_passed_over(path, data):
    kinds = [("_", "u1", 4), ("x", "f8", 1), ("ring", "u2", 0), ("n", "f4", 3), ("y", "f4", 1)]
    kinds += [("_", "i8", 1), ("z", "f4", 1), ("Intensity", "u1", 1)]
    columns = [np.zeros((3, count), f"<{kind}") for _, kind, count in kinds]
    for at, field in ((1, 0), (4, 1), (6, 2), (7, 3)):
        columns[at][:, 0] = PLACES[:, field] * (8 if field == 3 else 1)
    columns[3][:] = np.nan
    if data == "ascii":
        rows = (" ".join(str(v) for c in columns for v in c[row].tolist()) for row in range(3))
        body = "\n".join(rows).encode()
    elif data == "binary":
        body = b"".join(c[row].tobytes() for row in range(3) for c in columns)
    else:
        plain = b"".join(c.tobytes() for c in columns)
        packed = lzf.compress(plain, 2 * len(plain))
        body = struct.pack("<II", len(packed), len(plain)) + packed
    pcd(
        path,
        body,
        FIELDS=" ".join(name for name, _, _ in kinds),
        SIZE=" ".join(kind[1] for _, kind, _ in kinds),
        TYPE=" ".join(kind[0].upper() for _, kind, _ in kinds),
        COUNT=" ".join(str(count) for _, _, count in kinds),
        DATA=data,
    )
    np.testing.assert_array_equal(read_cloud(path, 8.0), PLACES)


def test_a_compressed_file_without_its_gaps_is_read_as_pcl_writes_it(path):
    plain = PLACES.T.tobytes()
    packed = lzf.compress(plain, 2 * len(plain))
    body = struct.pack("<II", len(packed), len(plain)) + packed
    changes = {"FIELDS": "x y z _ intensity", "SIZE": "4 4 4 1 4", "TYPE": "F F F U F"}
    pcd(path, body, COUNT="1 1 1 4 1", DATA="binary_compressed", **changes)
    np.testing.assert_array_equal(read_cloud(path), PLACES)


@pytest.mark.parametrize("mark", ["nan", "NaN", "-nan", "-nan(ind)", "1.#QNAN", "inf", "1e400"])
def test_points_of_an_ascii_file_that_are_not_finite_are_left_out(path, mark):
    pcd(path, ASCII.replace("12.0", mark))
    np.testing.assert_array_equal(read_cloud(path), PLACES[[0, 2]])


def test_text_in_a_field_that_nobody_needs_costs_nothing(path):
    body = ASCII.replace("\n", " car\n")
    changes = {"FIELDS": "x y z intensity label", "SIZE": "4 4 4 4 4", "TYPE": "F F F F U"}
    np.testing.assert_array_equal(read_cloud(pcd(path, body, COUNT="1 1 1 1 1", **changes)), PLACES)


@pytest.mark.parametrize(
    ("body", "without", "changes", "said"),
    [
        (ASCII, ("FIELDS",), {}, "its header has no line FIELDS"),
        ("", ("DATA",), {}, "its header has no line DATA"),
        (ASCII, (), {"SIZE": "4 4 4"}, "has 4 FIELDS, but SIZE for 3"),
        (ASCII, (), {"SIZE": "4 4 4 3"}, "field intensity of TYPE F and SIZE 3"),
        (ASCII, (), {"TYPE": "F F F X"}, "field intensity of TYPE X and SIZE 4"),
        (ASCII, (), {"POINTS": "-3"}, "has POINTS '-3' in its header, expected a whole number"),
        (ASCII, (), {"POINTS": "9" * 5000}, "expected a whole number"),
        (ASCII, ("WIDTH", "POINTS"), {}, "has neither POINTS nor WIDTH"),
        (ASCII, (), {"DATA": "zipped"}, "holds DATA 'zipped', expected ascii"),
        (ASCII, (), {"FIELDS": "a b c d"}, "has the fields a, b, c, d, but not x, y, z"),
        (ASCII, (), {"COUNT": "1 1 1 2"}, r"has 4 values in point 0 \(from 0\), but .* defines 5"),
        (ASCII.replace("3.0", "three"), (), {}, "points that are not numbers: .*three"),
        (ASCII[:-8], (), {}, r"has 2 values in point 2 \(from 0\), but its header defines 4"),
        (ASCII.replace(" ", ","), (), {}, r"in point 0 .*; separate values by spaces, without"),
        (ASCII.replace("3.0", "3.0 7 7"), (), {}, r"has 6 values in point 1 \(from 0\)"),
        (ASCII, (), {"VIEWPOINT": "0 0 0 1"}, "has VIEWPOINT '0 0 0 1' in its header, expected tx"),
        (ASCII, (), {"VIEWPOINT": "0 0 a 1 0 0 0"}, "has VIEWPOINT '0 0 a 1 0 0 0'"),
        (ASCII, (), {"POINTS": "5"}, "holds 3 of the 5 declared points: it is cut short"),
        ("", (), {}, "holds 0 of the 3 declared points: it is cut short"),
        (BINARY[:-5], (), {"DATA": "binary"}, "holds 2 of the 3 declared points: it is cut short"),
        (b"\1", (), {"DATA": "binary_compressed"}, "holds 0 of the 3 declared points"),
        (
            struct.pack("<II", 48, 48),
            (),
            {"DATA": "binary_compressed"},
            "0 of the 48 declared compressed bytes",
        ),
        (
            struct.pack("<II", 9, 48) + b"\xff" * 9,
            (),
            {"DATA": "binary_compressed"},
            "compressed points that cannot be unpacked",
        ),
        (
            struct.pack("<II", 9, 32) + bytes(9),
            (),
            {"DATA": "binary_compressed"},
            "declares 3 points, which do not fit 32 unpacked bytes",
        ),
    ],
)
def test_what_is_wrong_with_a_pcd_is_said_as_it_is(path, body, without, changes, said):
    pcd(path, body, without=without, **changes)
    with pytest.raises(FileError, match=said) as caught:
        read_cloud(path)
    assert caught.value.problem.path == path


@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_points_beyond_those_that_are_announced_are_counted(path, data):
    pcd(path, ASCII if data == "ascii" else BINARY, POINTS="1", DATA=data)
    with pytest.warns(UserWarning, match="holds 2 points more than the 1 declared"):
        np.testing.assert_array_equal(read_cloud(path), PLACES[:1])


def test_header_lines_may_end_in_a_carriage_return_alone(path):
    for body, data in ((ASCII.replace("\n", "\r").encode(), "ascii"), (BINARY, "binary")):
        lines = [f"{key} {value}\r" for key, value in {**HEADER, "DATA": data}.items()]
        path.write_bytes("".join(lines).encode() + body)
        np.testing.assert_array_equal(read_cloud(path), PLACES)


def test_a_viewpoint_is_not_applied_and_that_is_said(path):
    with pytest.warns(UserWarning, match="a VIEWPOINT other than .*, which is not applied"):
        points = read_cloud(pcd(path, VIEWPOINT="1 2 3 0.5 0.5 0.5 0.5"))
    np.testing.assert_array_equal(points, PLACES)


@pytest.mark.parametrize("names", ["x y z i X", "X y z i x", "x y z i x", "x y z i scalar_X"])
@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_of_fields_of_one_name_the_plain_or_first_one_is_taken_and_that_is_said(path, names, data):
    rows = np.hstack([PLACES, np.float32([[1], [2], [3]])])
    if names.startswith("X"):
        rows = rows[:, [4, 1, 2, 3, 0]]
    body = "".join(" ".join(map(str, row)) + "\n" for row in rows.tolist())
    changes = {"FIELDS": names, "SIZE": "4 4 4 4 4", "TYPE": "F F F F F", "COUNT": "1 1 1 1 1"}
    pcd(path, body if data == "ascii" else rows.tobytes(), DATA=data, **changes)
    with pytest.warns(UserWarning, match="several fields named x, ignoring case"):
        np.testing.assert_array_equal(read_cloud(path), PLACES)


def npy(header):
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(640)


HUGE = {
    "count.pcd": {"COUNT": "1 1 1 1000000000", "DATA": "binary"},
    "count_ascii.pcd": {"COUNT": "1 1 1 1000000000"},
    "points.pcd": {"POINTS": str(10**12), "DATA": "binary"},
    "points_ascii.pcd": {"POINTS": str(10**12)},
    "no_size.pcd": {"POINTS": str(10**12), "COUNT": "0 0 0 0", "DATA": "binary"},
    "packed.pcd": {"POINTS": str(2**27), "DATA": "binary_compressed"},
    "rows.npy": f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({10**12}, 4)}}",
    "empty_rows.npy": f"{{'descr': '|V0', 'fortran_order': False, 'shape': ({10**12}, 4)}}",
    "wide.npy": "{'descr': ('<f4', (500000000,)), 'fortran_order': False, 'shape': (9,)}",
    "negative.npy": f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({-(10**12)}, -4)}}",
    "objects.npy": "{'descr': '|O', 'fortran_order': False, 'shape': (9, 4)}",
    "vertices.ply": f"ascii 1.0\nelement vertex {10**12}\n",
    "binary.ply": f"binary_big_endian 1.0\nelement vertex {10**12}\n",
    "skipped.ply": f"ascii 1.0\nelement a {10**12}\nproperty int b\nelement vertex 9\n",
}


@pytest.mark.parametrize("name", HUGE)
def test_a_header_alone_allots_no_memory(tmp_path, name):
    path, said = tmp_path / name, HUGE[name]
    if isinstance(said, dict):
        packed = struct.pack("<II", 640, 2**31) + bytes(640)
        pcd(path, packed if "packed" in name else (BINARY if "DATA" in said else ASCII), **said)
    elif path.suffix == ".npy":
        path.write_bytes(npy(said))
    else:
        names = "".join(f"property float {field}\n" for field in "xyz")
        path.write_text(f"ply\nformat {said}{names}end_header\n1 2 3\n")
    tracemalloc.start()
    try:
        with pytest.raises(FileError):
            read_cloud(path)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_the_library_and_this_reader_agree_on_every_encoding(path):
    rng = np.random.default_rng(0)
    points = rng.uniform(1, 50, (500, 4)).astype(np.float32) * np.float32([1, 1, 1, 0.01])
    for encoding in list(Encoding)[:3]:
        PointCloud.from_xyzi_points(points).save(path, encoding)
        np.testing.assert_allclose(read_cloud(path), points, atol=1e-5)


PLY_FIELDS = "property float x\nproperty float y\nproperty float z\n"
FACES = "element face 1\nproperty list uchar int vertex_indices\n"


def ply(path, form, body, *, intensity="property float intensity\n", before="", after=""):
    header = f"ply\nformat {form} 1.0\ncomment by Åsa Łącka\n{before}element vertex 3\n"
    header += f"{PLY_FIELDS}{intensity}{after}end_header\n"
    path.write_bytes(header.encode() + (body.encode() if isinstance(body, str) else body))
    return path


@pytest.mark.parametrize(
    "name",
    [
        *("intensity", "scalar_Intensity", "reflectance", "remission", "Refl", "REF"),
        *("signal", "Amplitude", "scalar_Brightness"),
    ],
)
def test_vertices_of_a_ply_are_the_points_in_each_of_its_formats(tmp_path, name):
    path, field = tmp_path / "cloud.PLY", f"property float {name}\n"
    np.testing.assert_array_equal(read_cloud(ply(path, "ascii", ASCII, intensity=field)), PLACES)
    faces = ply(path, "ascii", ASCII + "3 0 1 2\n", intensity=field, after=FACES)
    np.testing.assert_array_equal(read_cloud(faces), PLACES)
    for form, order in (("binary_little_endian", "<f4"), ("binary_big_endian", ">f4")):
        body = PLACES.astype(order).tobytes() + b"\3"
        np.testing.assert_array_equal(
            read_cloud(ply(path, form, body, intensity=field, after=FACES)), PLACES
        )


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("after", ["", "element face 0\nproperty list uchar int i\n"])
def test_vertices_beyond_those_that_a_ply_announces_are_counted(tmp_path, form, after):
    more = ASCII + "1 2 3 0\n" if form == "ascii" else BINARY + bytes(16)
    path = ply(tmp_path / "cloud.ply", form, more, after=after)
    with pytest.warns(UserWarning, match="holds 1 points more than the 3 declared"):
        np.testing.assert_array_equal(read_cloud(path), PLACES)


def test_vertices_and_faces_beyond_those_that_are_announced_are_counted(tmp_path):
    path = ply(tmp_path / "cloud.ply", "ascii", ASCII + "1 2 3 0\n3 0 1 2\n", after=FACES)
    with pytest.warns(UserWarning, match="holds 1 points more than the 3 declared"):
        np.testing.assert_array_equal(read_cloud(path), PLACES)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_lines_of_a_ply_may_end_in_a_carriage_return_alone(tmp_path, form):
    path = ply(tmp_path / "cloud.ply", form, b"")
    body = ASCII.replace("\n", "\r").encode() if form == "ascii" else BINARY
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r") + body)
    np.testing.assert_array_equal(read_cloud(path), PLACES)


def test_elements_before_the_vertices_of_a_ply_are_passed_over(tmp_path):
    before = "element camera 2\nproperty double a\nproperty uchar b\n"
    path = ply(tmp_path / "a.ply", "ascii", "7 7\n7 7\n" + ASCII, before=before)
    np.testing.assert_array_equal(read_cloud(path), PLACES)
    path = ply(tmp_path / "a.ply", "binary_little_endian", bytes(18) + BINARY, before=before)
    np.testing.assert_array_equal(read_cloud(path), PLACES)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is no whole PLY file: its header has no end_header"),
        (b"ply\nformat ascii 1.0\nend_header\n", "has no element vertex"),
        (b"ply\nformat text 1.0\nelement vertex 1\nend_header\n", "has no format of ascii"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n1 1",
            "has a list of numbers",
        ),
        (
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n1",
            "has the property x of half",
        ),
        (b"ply\nwhat\nend_header\n", "has the header line 'what'"),
        (
            b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n"
            b"property float y\nproperty float z\nend_header\n" + bytes(40),
            "holds 3 of the 9 declared points",
        ),
    ],
)
def test_a_ply_that_is_not_read_is_refused_with_its_cause(tmp_path, content, said):
    path = tmp_path / "cloud.ply"
    path.write_bytes(content)
    with pytest.raises(FileError, match=said):
        read_cloud(path)


BRIGHT = np.zeros(
    4, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("reflectivity", "u2")]
)
BRIGHT["x"], BRIGHT["intensity"] = 5, 3000


def test_calibrated_reflectivity_goes_before_photon_counts_and_that_is_said(tmp_path):
    path, cloud = tmp_path / "cloud.npy", BRIGHT.copy()
    cloud["reflectivity"] = (51, 102, 153, 255)
    np.save(path, cloud)
    with pytest.warns(
        UserWarning, match="reflectivity is used, not intensity; remove reflectivity"
    ):
        points = read_cloud(path, 255.0)
    np.testing.assert_allclose(points[:, 3], [0.2, 0.4, 0.6, 1])


def test_a_reflectivity_of_zeros_alone_gives_way_to_intensity(tmp_path):
    np.save(tmp_path / "cloud.npy", BRIGHT)
    with pytest.warns(UserWarning, match="intensity is used, not reflectivity; remove intensity"):
        points = read_cloud(tmp_path / "cloud.npy", 6000.0)
    assert points[:, 3].tolist() == [0.5] * 4


def test_one_field_of_brightness_is_taken_without_a_word(tmp_path):
    np.save(tmp_path / "cloud.npy", BRIGHT[["x", "y", "z", "intensity"]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_cloud(tmp_path / "cloud.npy", 6000.0)[:, 3].tolist() == [0.5] * 4
