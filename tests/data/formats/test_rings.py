import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.formats.ring_elevations import rings_by_elevation
from sightline.data.formats.rings import (
    NUM_RINGS,
    beams_of_sensor,
    check_spacing,
    count_rings,
    in_kitti_order,
    is_firing_order,
    ring_numbers,
    rings_of_any_order,
    turned_in_order,
)
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from tests.reference import rings as reference

LOWEST_IN_VIEW = 45

azimuths_behind = st.lists(st.integers(61, 299), max_size=3)


def sweep(azimuths_by_ring, *, range_m=10.0):
    """A sweep in KITTI's order from the azimuths [degrees] of each ring, the top one first."""
    points = []
    for ring, azimuths in enumerate(azimuths_by_ring):
        elevation = np.radians(2 - 0.4 * ring)
        for azimuth in np.radians(np.asarray(azimuths, dtype=float)):
            ahead, left = range_m * np.cos(azimuth), range_m * np.sin(azimuth)
            points.append((ahead, left, range_m * np.tan(elevation), 0.5))
    return np.array(points, dtype=np.float32).reshape(-1, 4)


@given(st.lists(azimuths_behind, min_size=NUM_RINGS, max_size=NUM_RINGS))
def test_a_whole_sweep_is_numbered_by_laser(behind):
    azimuths = [[1, *sorted(set(one)), 180, 359] for one in behind]
    expected = [ring for ring, one in enumerate(azimuths) for _ in one]
    azimuths = [sorted(one) for one in azimuths]
    assert ring_numbers(sweep(azimuths)).tolist() == expected


@given(st.lists(st.lists(st.integers(-40, 40), max_size=5), max_size=20))
def test_a_sweep_cut_to_the_camera_is_numbered_where_the_azimuth_jumps_back(rings):
    # from straight ahead to the left edge, then from the right edge to straight ahead
    ordered = [sorted(set(one), key=lambda azimuth: (azimuth < 0, azimuth)) for one in rings]
    points = sweep(ordered)
    assert ring_numbers(points).tolist() == reference.ring_numbers(points.tolist())


def test_a_number_of_a_cut_sweep_holds_one_laser_on_the_right_and_the_next_on_the_left():
    left_then_right = [5, 35, -35, -5]
    assert ring_numbers(sweep([left_then_right] * 3)).tolist() == [
        0,
        0,
        1,
        1,
        1,
        1,
        2,
        2,
        2,
        2,
        3,
        3,
    ]


def test_a_sweep_that_starts_each_ring_at_the_right_edge_is_numbered_by_laser():
    assert ring_numbers(sweep([[-35, 0, 35]] * 3)).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_a_step_back_of_less_than_30_degrees_does_not_end_a_ring():
    assert ring_numbers(sweep([[10, -19, 0]])).tolist() == [0, 0, 0]
    assert ring_numbers(sweep([[10, -21, 0]])).tolist() == [0, 1, 1]


def test_a_sweep_of_no_points_has_no_rings():
    assert ring_numbers(np.zeros((0, 4), np.float32)).tolist() == []


@pytest.mark.parametrize("num_rings", [1, 7, 136])
def test_a_whole_sweep_of_too_few_or_too_many_rings_is_refused(num_rings):
    azimuths = [[1, 180, 359]] * num_rings
    with pytest.raises(ValueError, match=rf"restarts {num_rings - 1} times, expected 7 to 134"):
        ring_numbers(sweep(azimuths))


@pytest.mark.parametrize(
    ("num_rings", "beams"),
    [(8, 16), (15, 16), (16, 16), (24, 32), (33, 32), (60, 64), (64, 64), (65, 64), (128, 128)],
)
def test_a_whole_sweep_tells_the_beams_of_its_sensor_even_where_rings_see_the_sky(num_rings, beams):
    whole = sweep([[1, 180, 359]] * num_rings)
    assert count_rings(whole) == num_rings
    assert beams_of_sensor(num_rings) == beams


def test_a_cut_sweep_is_taken_for_kittis_unless_its_rings_lie_too_far_apart():
    close = sweep([[-35, 0, 35]] * 40)
    wide = sweep([[-35, 0, 35] if ring % 4 == 0 else [] for ring in range(40)])
    assert count_rings(close) == count_rings(wide) == NUM_RINGS
    numbers = ring_numbers(close)
    for kept in (numbers >= 0, numbers % 8 != 4, numbers % 8 == 4, numbers < 0):
        check_spacing(close[kept], numbers[kept])
    with pytest.raises(ValueError, match=r"lie 1\.6 degrees apart, too far for the 64"):
        check_spacing(wide, ring_numbers(wide))


def test_the_rings_of_each_cut_sweep_of_kitti_lie_as_close_as_64_beams_do(kitti_root):
    sweeps = real_sweeps(kitti_root, "training/velodyne/*.bin")
    assert len(sweeps) == 90
    for points in sweeps:
        check_spacing(points, ring_numbers(points))


def test_points_in_any_other_order_are_refused():
    points = sweep([[5, 20, 35, -35, -20, -5]] * 40)
    shuffled = np.random.default_rng(0).permutation(points)
    with pytest.raises(ValueError, match="order of KITTI's files"):
        ring_numbers(shuffled)


def test_rings_from_the_bottom_up_are_refused():
    from_the_top = sweep([[-35, 0, 35]] * 40).reshape(40, 3, 4)
    with pytest.raises(ValueError, match="KITTI's order has the highest ring first"):
        ring_numbers(from_the_top[::-1].reshape(-1, 4))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


SENSORS = {
    "16 beams": np.linspace(15, -15, 16),
    "32 beams": np.linspace(10.67, -30.67, 32),
    "64 beams": np.linspace(22.5, -22.5, 64),
    "128 beams, closer in the middle": np.r_[
        np.linspace(15, 2.2, 24), np.linspace(2, -8, 80), np.linspace(-8.6, -25, 24)
    ],
}


def turn(elevations_deg, *, noise_m=0.002, rng):
    """A whole sweep of lasers at one origin in KITTI's order, with lost returns; and its rings."""
    azimuth = np.arange(0.1, 360, 1.5)
    rings = np.repeat(np.arange(len(elevations_deg)), len(azimuth))
    turned, up = (
        np.radians(np.tile(azimuth, len(elevations_deg))),
        np.radians(elevations_deg)[rings],
    )
    ranges = rng.uniform(4, 60, len(rings))
    rays = [np.cos(up) * np.cos(turned), np.cos(up) * np.sin(turned), np.sin(up)]
    points = np.stack([*(ranges * ray for ray in rays), np.full(len(rings), 0.5)], axis=1)
    points[:, :3] += rng.normal(0, noise_m, (len(points), 3))
    found = rng.random(len(points)) < 0.8
    return points[found].astype(np.float32), rings[found]


@pytest.mark.parametrize("sensor", SENSORS)
def test_rings_by_elevation_are_those_of_the_nearest_laser_in_any_order(sensor, rng):
    points, rings = turn(SENSORS[sensor], rng=rng)
    order = rng.permutation(len(points))
    found = rings_by_elevation(points[order])
    by_hand = [
        reference.laser_by_elevation(point, 0, SENSORS[sensor]) for point in points[order][:500]
    ]
    assert np.mean(found[:500] == by_hand) >= 0.99
    assert np.mean(found == rings[order]) >= 0.999


def test_sweeps_shot_by_shot_are_told_from_those_ring_by_ring(rng):
    points, rings = turn(SENSORS["32 beams"], rng=rng)
    by_firing = np.lexsort((-rings, np.arctan2(points[:, 1], points[:, 0])))
    assert not is_firing_order(points)
    assert is_firing_order(points[by_firing])
    assert is_firing_order(points[rng.permutation(len(points))])
    assert rings_of_any_order(points)[1]
    found, is_ring_by_ring = rings_of_any_order(points[by_firing])
    assert not is_ring_by_ring
    assert (found == rings[by_firing]).all()
    cut = by_firing[points[by_firing, 0] > np.abs(points[by_firing, 1])]  # as a camera shows it
    assert (rings_of_any_order(points[cut])[0] == rings[cut]).all()


@pytest.mark.parametrize("lidar", ["vlp-16", "hdl-32e", "hdl-64e"])  # the last leans forward
def test_rings_of_a_simulated_street_are_those_of_its_order(lidar, rng):
    config = SimulationConfig(lidar=lidar, camera=False, image_size=(32, 32))
    points = simulate_frame(config, 0).points
    rings = ring_numbers(points)
    for order in (
        np.lexsort((-rings, np.arctan2(points[:, 1], points[:, 0]))),
        rng.permutation(len(rings)),
    ):
        found, is_ring_by_ring = rings_of_any_order(points[order])
        assert not is_ring_by_ring
        assert np.mean(found == rings[order]) >= 0.999


@pytest.mark.parametrize(("pitch_deg", "roll_deg"), [(0.6, 0.0), (-1.2, 0.4), (0.3, -1.4)])
def test_rings_of_a_sweep_that_was_levelled_are_found_by_elevation(pitch_deg, roll_deg, rng):
    points, rings = turn(SENSORS["32 beams"], rng=rng)
    for axis, lean_deg in ((0, pitch_deg), (1, roll_deg)):
        sine, cosine = np.sin(np.radians(lean_deg)), np.cos(np.radians(lean_deg))
        points[:, [axis, 2]] = points[:, [axis, 2]] @ np.array([[cosine, -sine], [sine, cosine]])
    order = rng.permutation(len(points))
    assert np.mean(rings_by_elevation(points[order]) == rings[order]) >= 0.999
    with pytest.raises(ValueError, match="do not separate into rings"):
        rings_by_elevation(points[order], try_leaning=False)


@pytest.mark.parametrize("tilt_deg", [2, 5])
def test_rings_of_a_tilted_sweep_in_another_order_are_refused(tilt_deg, rng):
    points, _ = turn(SENSORS["32 beams"], rng=rng)
    sine, cosine = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    points[:, [0, 2]] = points[:, [0, 2]] @ np.array([[cosine, -sine], [sine, cosine]])
    with pytest.raises(ValueError, match=r"elevations do not separate into rings .* tilted by"):
        rings_of_any_order(rng.permutation(points))


def test_sweeps_of_kitti_are_numbered_by_their_order_alone(kitti_root):
    for points in real_sweeps(kitti_root, "training/velodyne/*.bin")[::6]:
        rings, is_ring_by_ring = rings_of_any_order(points)
        assert is_ring_by_ring
        assert (rings == ring_numbers(points)).all()


# Where the two blocks of an HDL-64E start above the origin [m], and the elevations of their lasers.
HDL_64E = ((0.203, np.linspace(1.9, -8.7, 32)), (0.121, np.linspace(-9.0, -25.0, 32)))


def two_blocks(heights_and_lasers=HDL_64E, *, rng):
    """A whole sweep of lasers that start above the origin, in two blocks; and its rings."""
    points, rings = [], []
    for height_m, lasers in heights_and_lasers:
        block, numbers = turn(lasers, rng=rng)
        block[:, 2] += np.float32(height_m)
        points.append(block)
        rings.append(numbers + 32 * len(rings))
    return np.concatenate(points), np.concatenate(rings)


@pytest.mark.parametrize("move_m", [(0, 0), (0.01, 0.03), (-0.02, 0.01)])
def test_rings_of_two_blocks_of_lasers_above_the_origin_are_found_by_elevation(move_m, rng):
    blocks = [
        (height + move, lasers) for (height, lasers), move in zip(HDL_64E, move_m, strict=True)
    ]
    points, rings = two_blocks(blocks, rng=rng)
    order = rng.permutation(len(points))
    found, is_ring_by_ring = rings_of_any_order(points[order])
    assert not is_ring_by_ring
    assert np.mean(found == rings[order]) >= 0.999


def test_rings_of_lasers_that_start_above_the_origin_are_found_by_elevation(rng):
    points, rings = turn(SENSORS["128 beams, closer in the middle"], rng=rng)
    points[:, 2] += 0.15
    order = rng.permutation(len(points))
    assert np.mean(rings_by_elevation(points[order]) == rings[order]) >= 0.999


def by_firing(points):
    """The same points in the order of a sensor that turns."""
    return np.argsort(np.arctan2(points[:, 1], points[:, 0]), kind="stable")


def test_whole_sweeps_of_kitti_shot_by_shot_have_the_rings_of_their_own_order(kitti_root):
    for points in real_sweeps(kitti_root, "full_sweeps/*.bin"):
        order = by_firing(points)
        found, is_ring_by_ring = rings_of_any_order(points[order])
        assert not is_ring_by_ring
        assert np.mean(found == ring_numbers(points)[order]) >= 0.9999


def test_cut_sweeps_of_kitti_shot_by_shot_have_the_rings_of_their_own_order(kitti_root):
    for points in real_sweeps(kitti_root, "training/velodyne/*.bin")[::9]:
        laser = ring_numbers(points) - (points[:, 1] < 0)
        order = by_firing(points)
        found, _ = rings_of_any_order(points[order])
        is_sure = laser[order] < LOWEST_IN_VIEW - 1
        assert np.mean((found == laser[order])[is_sure]) >= 0.999


def azimuth_deg(points):
    return np.degrees(np.arctan2(points[:, 1], points[:, 0]))


# Sort keys of the azimuth inside each ring.
BEGINS = {
    "from behind": lambda azimuth: azimuth,
    "from behind, clockwise": lambda azimuth: -azimuth,
    "from ahead, clockwise": lambda azimuth: -azimuth % 360,
    "from the left": lambda azimuth: (azimuth - 90) % 360,
    "from the left, clockwise": lambda azimuth: (90 - azimuth) % 360,
}


@pytest.mark.parametrize("begin", BEGINS)
@pytest.mark.parametrize("tilt_deg", [0, 3])
def test_rings_one_after_the_other_are_found_wherever_they_begin(begin, tilt_deg, rng):
    points, rings = turn(SENSORS["64 beams"], rng=rng)
    order = np.lexsort((BEGINS[begin](azimuth_deg(points)), rings))
    sine, cosine = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    points[:, [0, 2]] = points[:, [0, 2]] @ np.array([[cosine, -sine], [sine, cosine]])
    found, is_kittis = rings_of_any_order(points[order])
    assert not is_kittis
    assert np.mean(found == rings[order]) >= 0.99


@pytest.mark.parametrize("begin", BEGINS)
def test_rings_of_kitti_are_found_wherever_they_begin(kitti_root, begin):
    for points in real_sweeps(kitti_root, "full_sweeps/*.bin")[:2]:
        rings = ring_numbers(points)
        order = np.lexsort((BEGINS[begin](azimuth_deg(points)), rings))
        found, is_kittis = rings_of_any_order(points[order])
        assert not is_kittis
        assert np.mean(found == rings[order]) >= 0.999


@pytest.mark.parametrize("turn_deg", [5, 77, -137, 271])
@pytest.mark.parametrize("mirror", [1, -1])
def test_rings_of_kitti_are_found_in_a_lidar_that_is_mounted_turned(kitti_root, turn_deg, mirror):
    cosine, sine = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    for points in real_sweeps(kitti_root, "full_sweeps/*.bin"):
        turned = points.copy()
        turned[:, :2] = points[:, :2] @ np.array(
            [[cosine, sine * mirror], [-sine, cosine * mirror]]
        )
        found, _ = rings_of_any_order(turned)
        assert np.mean(found == ring_numbers(points)) >= 0.999


def test_whole_sweeps_of_kitti_are_numbered_by_their_own_order(kitti_root):
    for points in real_sweeps(kitti_root, "full_sweeps/*.bin"):
        rings, is_kittis = rings_of_any_order(points)
        assert is_kittis
        assert (rings == ring_numbers(points)).all()


NUMBERINGS = {
    "from the top": lambda rings: rings,
    "from the bottom": lambda rings: 63 - rings,
    "as wired": lambda rings: np.random.default_rng(1).permutation(64)[rings],
    "floats": lambda rings: rings.astype(np.float32),
}


@pytest.mark.parametrize("numbering", NUMBERINGS)
def test_ring_numbers_of_a_driver_bring_a_sweep_into_kittis_order(numbering, rng):
    points, rings = turn(SENSORS["64 beams"], rng=rng)
    points[5, 0] = np.nan
    order = rng.permutation(len(points))
    found = in_kitti_order(points[order], NUMBERINGS[numbering](rings)[order])
    assert np.isnan(found[-1, 0])
    assert np.array_equal(found[:-1], np.delete(points, 5, axis=0))


def test_numbers_that_do_not_go_by_elevation_leave_a_sweep_in_its_order(rng):
    points, rings = turn(SENSORS["64 beams"], rng=rng)
    for numbers in (rng.permutation(rings), np.zeros(len(rings)), rings + 0.5, rings * np.nan):
        assert in_kitti_order(points, numbers) is points


def test_a_sweep_that_is_turned_stays_in_kittis_order_if_it_was_in_it(rng):
    points, rings = turn(SENSORS["32 beams"], rng=rng)
    turned = points[:, [1, 0, 2, 3]] * np.float32([-1, 1, 1, 1])
    again = turned_in_order(points, turned)
    assert (ring_numbers(again) == rings).all()
    assert sorted(map(tuple, again)) == sorted(map(tuple, turned))
    order = rng.permutation(len(points))
    assert np.array_equal(turned_in_order(points[order], turned[order]), turned[order])


def real_sweeps(kitti_root, folder):
    return [np.fromfile(path, "<f4").reshape(-1, 4) for path in sorted(kitti_root.glob(folder))]


def test_each_whole_sweep_of_kitti_has_64_rings(kitti_root):
    sweeps = real_sweeps(kitti_root, "full_sweeps/*.bin")
    assert len(sweeps) == 6
    for points in sweeps:
        assert np.unique(ring_numbers(points)).tolist() == list(range(NUM_RINGS))


def test_numbers_of_cut_sweeps_are_the_lasers_left_of_ahead_and_one_more_right_of_it(kitti_root):
    for path in sorted(kitti_root.glob("full_sweeps/*.bin")):
        whole = np.fromfile(path, "<f4").reshape(-1, 4)
        cut_path = kitti_root / "training/velodyne" / path.name
        cut = np.fromfile(cut_path, "<f4").reshape(-1, 4)
        lasers = dict(zip(map(bytes, whole), ring_numbers(whole), strict=True))
        laser = np.array([lasers[bytes(point)] for point in cut])
        expected = laser + (cut[:, 1] < 0)
        differ = ring_numbers(cut) != expected
        # the lowest in view show only a few degrees around straight ahead, without a jump back
        assert np.count_nonzero(differ & (laser < LOWEST_IN_VIEW)) <= 2


def test_the_first_ring_in_view_of_the_camera_is_the_top_one_in_every_frame(kitti_root):
    sweeps = real_sweeps(kitti_root, "training/velodyne/*.bin")
    assert len(sweeps) == 90
    # the lasers of the upper block leave 0.21 m above the origin, the topmost at +1.9 degrees
    upper_block = [1.94 - 0.34 * laser for laser in range(32)]
    for points in sweeps:
        numbers = ring_numbers(points)
        assert 44 <= numbers.max() + 1 <= 48
        first = reference.laser_by_elevation(np.median(points[:9], axis=0), 0.21, upper_block)
        assert first == 0


def test_zigzag_scans_are_no_single_ring():
    rows = sweep([np.linspace(-40, 40, 60)] * 12).reshape(12, 60, 4)
    rows[1::2] = rows[1::2, ::-1].copy()
    zigzag = rows.reshape(-1, 4)
    with pytest.raises(ValueError, match="the azimuth never restarts, but elevations spread over"):
        ring_numbers(zigzag)
    assert (np.bincount(rings_of_any_order(zigzag)[0]) == 60).all()
    assert ring_numbers(zigzag[:60]).max() == 0


def test_sweeps_of_several_lidars_one_after_the_other_are_named_as_such():
    one = sweep([np.arange(1, 360, 5)] * 32)
    with pytest.raises(ValueError, match=r"ring 32 .* points are of several LiDARs, give those of"):
        ring_numbers(np.concatenate((one, one)))
    bottom_up = one.reshape(32, -1, 4)[::-1].reshape(-1, 4)
    with pytest.raises(ValueError, match=r"in the order of KITTI's files$"):
        ring_numbers(bottom_up)
