import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.cloud_checks import cloud_fault, hollow_doubt, shape_doubt
from sightline.geometry.echoes import echoes, losses
from sightline.geometry.intensity_checks import intensity_doubt, warn_of_intensities
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import POINTS

VALUES = st.sampled_from(
    [0.0, 3e-6, -1e-3, 2e-3, 1.0, -2.5, 1e300, -1e300, np.nan, np.inf, -np.inf]
)
ROWS = st.lists(st.tuples(VALUES, VALUES, VALUES, VALUES), max_size=12)


def is_usable(value):
    """Finite in float32, too."""
    return -3.5e38 < value < 3.5e38


@given(ROWS)
def test_a_point_counts_by_x_y_z_alone_and_bad_intensities_are_0(rows):
    found = echoes(np.array(rows, np.float64).reshape(-1, 4))
    expected = [
        (*place, intensity if is_usable(intensity) else 0.0)
        for *place, intensity in rows
        if all(map(is_usable, place)) and any(abs(value) > 1e-3 for value in place)
    ]
    assert found.tolist() == [list(row) for row in expected]


def cloud(num_points=10):
    return np.tile([3.0, 1.0, -1.7, 0.5], (num_points, 1))


def test_a_usual_share_of_points_without_an_echo_is_no_loss():
    points = cloud()
    points[:5, :3] = 0
    assert losses(points) == ()
    assert losses(points[:0]) == ()


def test_losses_beyond_the_usual_are_counted_by_their_cause():
    points = cloud()
    points[:4, :3], points[4:6, 1] = 0, np.nan
    (lost,) = losses(points)
    assert "6 of 10 points are left out, 2 with x, y, z not finite and 4 at 0, 0, 0" in lost
    assert "4 are left" in lost
    points[:, 0] = np.inf
    assert "none is left" in losses(points)[0]


def test_bad_intensities_are_counted_among_the_points_that_are_left():
    points = cloud()
    points[0, :3], points[:3, 3] = 0, np.nan
    assert losses(points) == ("2 of 9 points have an intensity that is not finite: it is set to 0",)


def test_numbers_in_the_wrong_byte_order_are_told_as_such():
    points = np.random.default_rng(0).uniform(-20, 20, (500, 4)).astype(np.float32)
    swapped = points.byteswap()
    problem, remedy = cloud_fault(swapped[np.isfinite(swapped).all(axis=1)], 1.0)
    assert "these are no coordinates, but bytes in the wrong order or of other fields" in problem
    assert remedy.startswith("correct the byte order (is_bigendian of PointCloud2)")


@pytest.mark.parametrize("offset", [(5e5, 4e6, 0), (0, 0, 800), (-2000, 0, 0)])
def test_points_that_lie_together_far_away_are_in_a_maps_frame(offset):
    rng = np.random.default_rng(0)
    points = np.hstack([rng.normal(0, 20, (500, 3)) + offset, np.zeros((500, 1))])
    problem, remedy = cloud_fault(points, 1.0)
    assert "map's or world's frame" in problem
    assert "subtract" in remedy
    assert "millimetres" not in problem + remedy


@pytest.mark.parametrize("rows", [slice(None), slice(1, None, 2)])  # some without an echo
def test_a_first_column_that_counts_the_rows_is_named(rows):
    points = np.hstack(
        [np.arange(500)[:, None], np.random.default_rng(0).uniform(-20, 20, (500, 3))]
    )
    problem, remedy = cloud_fault(points[rows], 1.0)
    assert problem.endswith(".. that counts its rows")
    assert remedy.startswith("leave it out: ")


def test_a_first_column_of_absurd_values_is_told_without_overflow():
    points = np.ones((30, 4), np.float32)
    points[::2, 0], points[1::2, 0] = 3e38, -3e38
    assert "farther away than" in cloud_fault(points, 1.0)[0]


def test_points_spread_far_around_the_lidar_are_in_millimetres():
    points = np.random.default_rng(0).normal(0, 20_000, (500, 4))
    assert "millimetres" in cloud_fault(points, 1.0)[0]


@pytest.mark.parametrize(
    ("factor", "unit"), [(100, "centimetres"), (1000, "millimetres"), (1e5, "another unit")]
)
def test_the_unit_is_the_one_that_fits(factor, unit):
    points = np.random.default_rng(0).normal(0, 10, (500, 4))
    problem, remedy = cloud_fault(points * factor, 1.0)
    assert f"in {unit}" in problem
    assert (f"divided by {factor}" in remedy) == (factor < 1e5)


def test_intensities_that_are_all_alike_are_doubted_but_zeros_are_none():
    with pytest.warns(UserWarning, match="all intensities are 7, so reflectances carry no inf"):
        warn_of_intensities(with_intensities(np.full(200, 7.0)), 255.0)
    zeros = with_intensities(np.zeros(200))
    warn_of_intensities(zeros, 255.0)  # an error if it warned
    warn_of_intensities(with_intensities(np.full(20, 7.0)), 255.0)  # too few points for a warning
    assert intensity_doubt(zeros, 255.0) is not None


def test_intensities_that_are_dark_but_for_one_point_in_a_hundred_are_doubted():
    intensities = np.random.default_rng(0).uniform(0, 1, 1000)
    intensities[:10] = 12
    assert "for 99 of 100 measured" in intensity_doubt(with_intensities(intensities), 255.0)[0]
    intensities[10] = 12
    assert intensity_doubt(with_intensities(intensities), 255.0) is None
    intensities[12:] = 0  # not measured
    assert intensity_doubt(with_intensities(intensities), 255.0) is None


def with_intensities(intensities):
    points = np.random.default_rng(0).normal(0, 10, (len(intensities), 4))
    points[:, 3] = intensities
    return points


PLACES = POINTS[:, :3].astype(np.float64)
DISTANCES_M = np.linalg.norm(PLACES, axis=1)


@pytest.mark.parametrize(
    "intensities",
    [
        DISTANCES_M,
        DISTANCES_M.astype(np.float32) / 100,
        DISTANCES_M.round(2),
        (2 * DISTANCES_M).astype(np.uint8),
        np.minimum(100 * DISTANCES_M, 65535).round(),
    ],
)
def test_distances_in_place_of_intensities_are_doubted(intensities):
    points = np.column_stack((PLACES, intensities))
    assert cloud_fault(points, 65535.0) is None
    with pytest.warns(UserWarning, match="^intensities are the points' distances from the LiDAR, "):
        warn_of_intensities(points, float(intensities.max()))
    points[-1, 3] = 0  # in doubt
    points[0, 3] = 0
    warn_of_intensities(points, float(intensities.max()))


@pytest.mark.parametrize(
    "times",
    [
        np.linspace(0, 0.1, len(PLACES)),
        np.repeat(np.arange(100.0), 1 + len(PLACES) // 100),
        np.arange(len(PLACES)) % 300 * 1e-4,  # ring by ring
        np.where(np.arange(len(PLACES)) % 1000, np.linspace(0, 0.1, len(PLACES)), 0),  # stray zeros
        np.sort(np.random.default_rng(0).random(len(PLACES))),
    ],
)
def test_times_in_place_of_intensities_and_sorted_clouds_are_doubted(times):
    points = np.column_stack((PLACES, times[: len(PLACES)]))
    cause = "only rise along the cloud or its rings: times, or a cloud that was sorted by them; "
    with pytest.warns(UserWarning, match=cause):
        warn_of_intensities(points, times.max())
    points[::20, 3] = 0
    warn_of_intensities(points, times.max())  # an error if it warned


def test_the_sweeps_of_kitti_have_intensities(kitti_root):
    paths = sorted(kitti_root.glob("training/velodyne/*.bin"))
    assert len(paths) == 90
    for path in paths:
        assert intensity_doubt(np.fromfile(path, np.float32).reshape(-1, 4), 1.0) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_flat_cloud_is_doubted(axis):
    points = np.random.default_rng(0).normal(0, 10, (500, 4))
    assert shape_doubt(points[:, :3]) is None
    points[:, axis] = -1.5
    problem, remedy = shape_doubt(points[:, :3])
    assert problem == f"holds 500 points with {'xyz'[axis]} = -1.5: the cloud is flat"
    assert f"write the measured {'xyz'[axis]}" in remedy
    assert hollow_doubt(points) == (problem, remedy)
    assert shape_doubt(points[:99, :3]) is None


def test_a_cloud_within_a_metre_is_in_another_unit():
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    problem, remedy = hollow_doubt(0.08 * points)
    assert "m of the LiDAR: they are probably in kilometres, or scaled to 1" in problem
    assert remedy == "write x, y, z in metres"
    assert shape_doubt(2 * points) is None


@pytest.mark.parametrize(
    ("largest", "limit", "expected"),
    [
        (0.9, 0.5, "1"),
        (99, 1.0, "100"),
        (252, 1.0, "255"),
        (40_000, 255.0, "65535"),
        (1e5, 1.0, "99000"),
    ],
)
def test_the_likely_scale_is_named_and_never_the_one_that_was_refused(largest, limit, expected):
    points = np.random.default_rng(0).uniform(-20, 20, (500, 4))
    points[:, 3] = np.linspace(0, largest, 500)
    _, remedy = cloud_fault(points, limit)
    scale = remedy.rpartition("probably ")[2]
    assert scale == expected
    assert cloud_fault(points, float(scale)) is None


def test_dark_bytes_have_the_scale_of_bytes():
    rng = np.random.default_rng(0)
    points = rng.uniform(-20, 20, (5000, 4))
    points[:, 3] = np.rint(rng.exponential(12, 5000)).clip(0, 90)
    points[:9, 3] = 207
    assert "probably 255" in cloud_fault(points, 1.0)[1]
    points[:9, 3] += 0.5
    assert "probably 100" in cloud_fault(points, 1.0)[1]


def test_bytes_with_a_sign_are_told_as_such():
    rng = np.random.default_rng(0)
    points = rng.uniform(-40, 40, (500, 4))
    points[:, 3] = rng.integers(0, 256, 500).astype(np.uint8).astype(np.int8)
    problem, remedy = cloud_fault(points, 255.0)
    assert "probably bytes of 0 to 255 that are declared as signed (int8)" in problem
    assert "uint8" in remedy
    points[:, 3] = rng.integers(-1, 1, 500)  # -1 for unknown
    assert "int8" not in cloud_fault(points, 255.0)[0]


def test_negative_intensities_may_be_coordinates():
    points = np.random.default_rng(0).uniform(-20, 20, (500, 4))
    problem, remedy = cloud_fault(points, 1.0)
    assert problem.startswith("intensities from -")
    assert "columns in the order x, y, z, intensity" in remedy


def test_points_in_decimetres_or_in_whole_metres_are_doubted():
    points = np.random.default_rng(0).uniform((4, -20, -2), (60, 20, 3), (500, 3))
    assert shape_doubt(points) is None
    problem, remedy = shape_doubt(10 * points)
    assert "none nearer than " in problem
    assert "decimetres" in problem
    assert remedy == "write x, y, z in metres"
    problem, _ = shape_doubt(points.round())
    assert problem == "holds 500 points at whole metres: their coordinates were rounded"


def test_points_that_are_there_three_times_are_doubted_those_of_two_returns_are_not():
    points = np.random.default_rng(0).uniform((4, -20, -2), (60, 20, 3), (500, 3))
    assert hollow_doubt(np.concatenate((points, points))) is None
    problem, _ = hollow_doubt(np.concatenate((points, points, points)))
    assert problem == "holds 1500 points at only 500 places"


def test_points_beside_the_origin_are_in_a_maps_frame_those_far_around_it_in_another_unit():
    points = np.random.default_rng(0).normal(0, 10, (500, 3))
    problem, remedy = shape_doubt(points + np.array((80, 30, 0)))
    assert "half of them within" in problem
    assert problem.endswith("they are probably in a map's or world's frame")
    assert remedy.startswith("take clouds in the LiDAR's own frame, or move them there")
    far = 10 * points[np.linalg.norm(points, axis=1) > 4]
    assert "decimetres" in shape_doubt(far)[0]


def test_real_sweeps_in_decimetres_are_not_taken_for_those_of_a_map():
    (path, *_) = sorted((PACKAGED_FRAMES / "training" / "velodyne").glob("*.bin"))
    points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3]
    points = points[np.linalg.norm(points, axis=1) > 4]
    assert "decimetres" in shape_doubt(10 * points)[0]
    assert "map's" in shape_doubt(points + np.float32((80, 30, 0)))[0]
