import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from sightline.data.formats.velodyne import (
    doubtful_reflectances,
    hollow_sweep,
    read_sweep,
    sweep_doubt,
    sweep_rows,
    write_sweep,
)
from sightline.files.problem import FileError
from sightline.geometry.cloud_layouts import other_layout

finite = st.floats(width=32, allow_nan=False, allow_infinity=False)
sweeps = arrays.arrays(np.float32, st.tuples(st.integers(0, 9), st.just(4)), elements=finite)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep") / "0.bin"


@given(points=sweeps)
def test_sweeps_survive_reading_and_writing_bit_by_bit(path, points):
    points = points[(np.abs(points[:, :3]) > 0.001).any(axis=1)]
    write_sweep(path, points)
    assert path.stat().st_size == 16 * len(points)
    assert read_sweep(path).tobytes() == points.tobytes()
    assert read_sweep(path).flags.writeable


def test_points_at_the_origin_are_left_out_and_more_than_half_are_told(tmp_path):
    points = np.ones((9, 4), np.float32)
    points[[0, 4, 8], :3] = ((0, 0, 0), (0, -3e-4, 0), (1e-3, 0, 0))
    write_sweep(tmp_path / "0.bin", points)
    assert np.array_equal(read_sweep(tmp_path / "0.bin"), np.ones((6, 4), np.float32))
    points[1:6, :3] = 0
    write_sweep(tmp_path / "0.bin", points)
    with pytest.warns(UserWarning, match=r"0\.bin: 7 of 9 points are left out, .* 7 at 0, 0, 0: 2"):
        read_sweep(tmp_path / "0.bin")


def test_no_sweep_of_kitti_has_points_at_the_origin(kitti_root):
    for path in kitti_root.rglob("velodyne*/*.bin"):
        assert len(read_sweep(path)) == len(sweep_rows(path)), path


def test_an_empty_file_is_a_sweep_of_zero_points(tmp_path):
    (tmp_path / "0.bin").touch()
    assert read_sweep(tmp_path / "0.bin").shape == (0, 4)


@pytest.mark.parametrize("num_bytes", [1, 4, 15, 17, 33])
def test_a_sweep_cut_short_is_refused_with_its_length(tmp_path, num_bytes):
    (tmp_path / "0.bin").write_bytes(bytes(num_bytes))
    with pytest.raises(ValueError, match=rf"0\.bin: holds {num_bytes} bytes.* multiple of 16.*cut"):
        read_sweep(tmp_path / "0.bin")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", range(4))
def test_non_finite_points_are_refused_with_their_number_and_the_first(tmp_path, value, column):
    points = np.ones((9, 4), np.float32)
    points[[3, 7], column] = value
    points.tofile(tmp_path / "0.bin")
    with pytest.raises(
        ValueError, match=r"0\.bin: holds 2 points with .* the first is point 3 of 9"
    ):
        read_sweep(tmp_path / "0.bin")
    if column == 3:
        with pytest.warns(
            UserWarning, match=r"0\.bin: 2 of 9 points have a non-finite reflectance"
        ):
            kept = read_sweep(tmp_path / "0.bin", drop_non_finite=True)
        assert kept[:, 3].tolist() == [1, 1, 1, 0, 1, 1, 1, 0, 1]
    else:
        with pytest.warns(
            UserWarning,
            match=r"0\.bin: 2 of 9 points with non-finite x, y, z are left out: 7 are left",
        ):
            kept = read_sweep(tmp_path / "0.bin", drop_non_finite=True)
        assert np.array_equal(kept, np.ones((7, 4), np.float32))
    with pytest.raises(ValueError, match=r"2 points hold NaN or infinite .* first is point 3"):
        write_sweep(tmp_path / "1.bin", points)
    assert not (tmp_path / "1.bin").exists()


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.ones((4, 20), np.float32), r"\(4, 20\), expected numbers of shape \(N, 4\); give rows"),
        (np.ones((20, 3)), r"float64 of shape \(20, 3\), expected numbers"),
        (np.full((20, 4), "1"), "expected numbers"),
        (np.ma.masked_greater(np.full((20, 4), 81.0), 80), "80 of 80 values masked"),
    ],
)
def test_sweeps_of_other_shapes_and_types_are_not_written(tmp_path, points, said):
    with pytest.raises(ValueError, match=rf"0\.bin .*{said}"):
        write_sweep(tmp_path / "0.bin", points)
    assert not (tmp_path / "0.bin").exists()


def test_tensors_and_lists_are_written_as_sweeps(tmp_path):
    for points in (torch.ones(2, 4), [[1, 1, 1, 1], [1, 1, 1, 1]]):
        write_sweep(tmp_path / "0.bin", points)
        assert np.array_equal(read_sweep(tmp_path / "0.bin"), np.ones((2, 4)))


def a_cloud(num_points=200, order=1):
    """A ring on the road and a wall, one point after the other along it."""
    azimuth = np.linspace(-0.7, 0.7, num_points)
    ranges = 10 + 5 * np.sin(azimuth)
    places = [ranges * np.cos(azimuth), ranges * np.sin(azimuth), -1.7 + 0.2 * azimuth**2]
    cloud = np.stack([*places, 0.3 + 0.2 * np.cos(azimuth)], axis=1).astype(np.float32)
    if order == "mixed":
        return np.random.default_rng(1).permutation(cloud)
    return cloud[::order]


EXTRA = np.arange(200, dtype=np.float32)[:, None]
FEATURES = np.random.default_rng(6).normal(size=(200, 12)).astype(np.float32)
NONE = np.zeros((200, 4), np.float32)


def as_pcl_dumps(cloud):
    """Rows of x, y, z, 1, intensity, 0, 0, 0."""
    return np.hstack([cloud[:, :3], NONE[:, :1] + 1, cloud[:, 3:], NONE[:, :3]])


def normals():
    """Unit vectors."""
    vectors = np.random.default_rng(2).normal(size=(200, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("scale", [1, 255])
@pytest.mark.parametrize("order", [1, -1, "mixed"])
@pytest.mark.parametrize(
    ("columns", "width", "meaning"),
    [
        (lambda cloud: cloud[:, :3], 12, "three columns"),
        (lambda cloud: np.hstack([cloud, EXTRA % 64]), 20, "five columns (ring or time)"),
        (lambda cloud: np.hstack([cloud, -EXTRA / 1e4]), 20, "five columns"),
        (lambda cloud: np.hstack([cloud, EXTRA % 64, EXTRA / 1e4]), 24, "six columns"),
        (lambda cloud: cloud.astype(np.float64), 32, "four columns of float64"),
        (lambda cloud: cloud.astype(np.float16), 8, "four columns of float16"),
        (as_pcl_dumps, 32, "eight columns"),
        (lambda cloud: np.hstack([cloud, EXTRA % 64, NONE[:, :3]]), 32, "eight columns"),
        (lambda cloud: np.hstack([cloud, normals(), EXTRA / 1e4, NONE]), 48, "twelve"),
        (lambda cloud: np.hstack([cloud, FEATURES[:, :8]]), 48, "twelve"),
        (lambda cloud: np.hstack([cloud, FEATURES]), 64, "sixteen"),
        (
            lambda cloud: np.hstack([as_pcl_dumps(cloud), EXTRA % 9, NONE, NONE[:, :3]]),
            64,
            "sixteen",
        ),
    ],
)
@pytest.mark.parametrize("num_points", [200, 197])  # so that 16 bytes a point fit, or do not
def test_files_of_other_columns_are_refused_with_what_fits(
    tmp_path, columns, width, meaning, scale, order, num_points
):
    cloud = columns(a_cloud(order=order) * np.float32([1, 1, 1, scale]))[:num_points]
    cloud.tofile(tmp_path / "0.bin")
    for drop_non_finite in (False, True):
        with pytest.raises(FileError) as caught:
            read_sweep(tmp_path / "0.bin", drop_non_finite=drop_non_finite)
        assert caught.value.problem.path == tmp_path / "0.bin"
        assert f"{width} for each point instead of 16: probably" in str(caught.value)
        assert meaning in str(caught.value)


def interleaved(cloud, parts):
    """Rows from each of several equal parts of a cloud in turn."""
    kept = cloud[: len(cloud) // parts * parts]
    return kept.reshape(parts, -1, 4).swapaxes(0, 1).reshape(-1, 4)


@pytest.mark.parametrize("parts", [2, 3, 4])
@pytest.mark.parametrize("key", [lambda p: p[:, 0], lambda p: p[:, 1], lambda p: p[:, 2] / p[:, 0]])
def test_sweeps_whose_rows_come_from_several_lasers_in_turn_have_four_columns(parts, key):
    cloud = np.random.default_rng(3).uniform((-40, -40, -2, 0), (40, 40, 2, 1), (600, 4))
    rows = interleaved(cloud[np.argsort(key(cloud))].astype(np.float32), parts)
    assert other_layout(rows.tobytes()) is None
    assert other_layout((rows + np.float32([0, 0, 2, 0])).tobytes()) is None
    second = np.repeat(rows, 2, axis=0)
    second[1::2] = (0.27, 0, 1.9, 0)  # no second echo, in the vehicle's frame
    assert other_layout(second.tobytes()) is None


def test_no_sweep_of_kitti_has_other_columns(kitti_root):
    for path in kitti_root.rglob("*.bin"):
        points = np.fromfile(path, "<f4").reshape(-1, 4)
        mixed = np.random.default_rng(4).permutation(points)
        for rows in (points, points[:150], mixed, points.astype("f2").astype("<f4")):
            assert other_layout(rows.tobytes()) is None


@pytest.mark.parametrize("order", [1, -1, "mixed"])
@pytest.mark.parametrize("cut", [4, 8, 12, 20, 24])
def test_a_file_of_four_columns_that_is_cut_short_is_not_taken_for_another(tmp_path, order, cut):
    content = a_cloud(order=order).tobytes()[:-cut]
    (tmp_path / "0.bin").write_bytes(content)
    if len(content) % 16:
        with pytest.raises(FileError, match="cut short"):
            read_sweep(tmp_path / "0.bin")
    else:
        assert len(read_sweep(tmp_path / "0.bin")) == len(content) // 16


def test_four_columns_with_intensities_below_zero_are_four_columns(tmp_path):
    cloud = a_cloud(180) - np.float32([0, 0, 0, 0.4])
    cloud.tofile(tmp_path / "0.bin")
    assert (read_sweep(tmp_path / "0.bin") == cloud).all()


@pytest.mark.parametrize("beginning", ["# .PCD v0.7", "VERSION .7", "ply\nformat", "\x93NUMPY"])
def test_a_file_of_another_format_is_named_by_it(tmp_path, beginning):
    (tmp_path / "0.bin").write_bytes(beginning.encode("latin-1") + bytes(640))
    with pytest.raises(FileError, match=r"is a (PCD|PLY|NPY) file by its first bytes"):
        read_sweep(tmp_path / "0.bin")


def test_sweeps_that_no_kitti_sensor_gives_are_doubted(tmp_path):
    path, cloud = tmp_path / "0.bin", a_cloud()
    assert sweep_doubt(path, cloud) is None
    assert sweep_doubt(path, cloud[:0]) is None
    bright = sweep_doubt(path, cloud * np.float32([1, 1, 1, 255]))
    assert bright.path == path
    assert "expected 0 to 1" in bright.problem
    assert "divide them" in bright.remedy
    assert "millimetres" in sweep_doubt(path, cloud * 1000).problem
    assert (
        "map's or world's frame" in sweep_doubt(path, cloud + np.float32([5e5, 4e6, 0, 0])).problem
    )


def test_a_file_in_the_other_byte_order_is_named_as_such(tmp_path):
    cloud = np.random.default_rng(0).uniform((-40, -40, -2, 0), (40, 40, 2, 1), (500, 4))
    cloud.astype(">f4").tofile(tmp_path / "0.bin")
    with pytest.raises(FileError, match="holds big-endian numbers, expected little-endian float32"):
        read_sweep(tmp_path / "0.bin")
    cloud.astype("<f4").tofile(tmp_path / "0.bin")
    assert np.array_equal(read_sweep(tmp_path / "0.bin"), cloud.astype(np.float32))


@pytest.mark.parametrize("share", [0.6, 1.0])
def test_points_without_a_value_are_no_other_byte_order(tmp_path, share):
    cloud = np.random.default_rng(0).uniform((-40, -40, -2, 0), (40, 40, 2, 1), (500, 4))
    cloud[: int(500 * share)] = np.nan
    cloud.astype("<f4").tofile(tmp_path / "0.bin")
    with pytest.raises(FileError, match=f"holds {int(500 * share)} points with NaN"):
        read_sweep(tmp_path / "0.bin")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"<!DOCTYPE html><html>404 not found</html>   \r\n" * 16, "<!DOCTYPE html>"),
        (b"12.5 -3.25 -1.70 0.31\n" * 800, "12.5 -3.25 -1.70 0.31"),
    ],
)
def test_text_is_named_as_text(tmp_path, text, said):
    (tmp_path / "0.bin").write_bytes(text)
    with pytest.raises(FileError, match=f"is text, '{said}.*expected raw float32.*web page"):
        read_sweep(tmp_path / "0.bin")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda cloud: cloud[:5], "holds only 5 points, expected thousands"),
        (lambda cloud: np.repeat(cloud[:1], 20_000, axis=0), "20000 points at only one place"),
        (lambda cloud: np.repeat(cloud[:9], 200, axis=0), "1800 points at only 9 places"),
    ],
)
def test_a_sweep_with_hardly_anything_in_it_is_doubted(tmp_path, change, said):
    cloud = a_cloud()
    (doubt,) = hollow_sweep(tmp_path, change(cloud))
    assert said in doubt.problem
    assert hollow_sweep(tmp_path, cloud) == []
    (tmp_path / "0.bin").touch()
    assert hollow_sweep(tmp_path / "0.bin", cloud[:0]) == []
    assert hollow_sweep(tmp_path, np.repeat(cloud, 2, axis=0)) == []  # two echoes a ray


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda cloud: cloud * np.float32([1, 1, 1, 0]), "all intensities are 0, so reflectances"),
        (lambda cloud: cloud * np.float32([1, 1, 1, 0]) + np.float32([0, 0, 0, 1]), "are 1, so"),
        (lambda cloud: cloud / np.float32([1, 1, 1, 255]), "are below a hundredth of max_inten"),
        (
            lambda cloud: np.column_stack((cloud[:, :3], np.linspace(0, 0.1, len(cloud)))).astype(
                "f4"
            ),
            "intensities only rise along the cloud",
        ),
    ],
)
def test_reflectances_that_are_of_no_use_are_doubted(tmp_path, change, said):
    cloud = a_cloud()
    (doubt,) = doubtful_reflectances(tmp_path, change(cloud))
    assert said in doubt.problem
    assert doubtful_reflectances(tmp_path, cloud) == []
    assert doubtful_reflectances(tmp_path, cloud[:0]) == []


def test_no_sweep_of_kitti_is_hollow(kitti_root):
    for path in [*kitti_root.glob("training/velodyne/*.bin"), *kitti_root.glob("full_sweeps/*")]:
        sweep = read_sweep(path)
        assert hollow_sweep(path, sweep) == doubtful_reflectances(path, sweep) == []


def test_the_remedy_of_a_sweeps_intensities_is_that_of_their_fault(tmp_path):
    cloud = a_cloud(2000)
    bright = sweep_doubt(tmp_path, cloud * np.float32([1, 1, 1, 255]))
    assert "divide them by their full scale, probably 255, or make the data" in bright.remedy
    negative = sweep_doubt(tmp_path, cloud * np.float32([1, 1, 1, -1]))
    assert "columns in the order x, y, z, intensity" in negative.remedy
    cloud[:, 3] = np.arange(len(cloud)) % 64
    rings = sweep_doubt(tmp_path, cloud)
    assert "look like ring numbers" in rings.problem
    assert "columns in the order x, y, z, intensity" in rings.remedy
