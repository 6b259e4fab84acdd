from dataclasses import replace

import numpy as np
import pytest

from sightline.data.formats.rings import ring_numbers
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.lidar import take_sweep
from sightline.simulation.lidar_config import LIDARS, BlindSector, Laser, LidarConfig
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import SURFACES, Material, Mesh, Pose, Street
from sightline.simulation.shapes.primitives import Finish, quads
from tests.simulation.small_streets import GREY, Straight, Turning, block, courtyard, ground, street

UNBIASED = replace(
    LIDARS["hdl-64e"],
    lasers=tuple(
        replace(laser, range_bias_m=0.0, reading_bias=0.0) for laser in LIDARS["hdl-64e"].lasers
    ),
)
EXACT = replace(
    UNBIASED,
    range_noise_m=0.0,
    drop_out=0.0,
    detectable_echo=1e-9,
    azimuth_step_deg=1.0,
    blind_sectors=(),
)
SLOPED = LidarConfig(
    lasers=(Laser(elevation_deg=1.0), Laser(elevation_deg=-5.0), Laser(elevation_deg=-15.0)),
    azimuth_step_deg=1.0,
    range_noise_m=0.0,
    drop_out=0.0,
    detectable_echo=1e-9,
)


def sweep_of(scenery: Street, config: LidarConfig, seed: int = 0, **options) -> np.ndarray:
    scene = scenery.snapshot(0.0)
    rng = np.random.default_rng(seed)
    return take_sweep(scene, Raycaster(scene.mesh), rng=rng, config=config, **options)


def azimuths(points: np.ndarray) -> np.ndarray:
    return np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360


def test_every_return_from_a_plane_lies_on_it():
    points = sweep_of(street(), EXACT)
    assert len(points) > 10000
    assert np.abs(points[:, 2] + KITTI_LIDAR_HEIGHT_M).max() < 2e-3


def test_ranges_to_the_ground_are_those_of_the_beams_angles():
    points = sweep_of(street(), SLOPED)
    ranges = np.linalg.norm(points[:, :3], axis=1)
    expected = KITTI_LIDAR_HEIGHT_M / np.sin(np.radians([15.0, 5.0]))
    assert np.allclose(np.unique(ranges.round(2)), expected, atol=0.01)
    assert len(points) == 2 * 360  # the rising beam hits nothing


def test_a_beam_with_an_offset_starts_above_the_origin():
    laser = Laser(elevation_deg=-5.0, offset_m=0.5)
    points = sweep_of(street(), replace(SLOPED, lasers=(laser,)))
    distance = np.hypot(points[:, 0], points[:, 1])
    expected = (KITTI_LIDAR_HEIGHT_M + 0.5) / np.tan(np.radians(5.0))
    assert np.allclose(distance, expected, atol=0.01)
    assert np.allclose(points[:, 2], -KITTI_LIDAR_HEIGHT_M, atol=2e-3)


def test_a_sensor_that_leans_forward_meets_level_ground_nearer_ahead_and_farther_behind():
    points = sweep_of(street(), replace(SLOPED, lean_deg=2.0)).astype(np.float64)
    assert np.allclose(points[:, 2], -KITTI_LIDAR_HEIGHT_M, atol=2e-3)
    azimuth = (azimuths(points) + 180) % 360 - 180
    for angle, where in ((5.0 + 2.0, np.abs(azimuth) < 1), (5.0 - 2.0, np.abs(azimuth) > 179)):
        farthest = np.hypot(points[where, 0], points[where, 1]).max()
        assert farthest == pytest.approx(KITTI_LIDAR_HEIGHT_M / np.tan(np.radians(angle)), rel=0.01)


def test_points_are_in_the_frame_of_a_sensor_that_stands_askew_in_the_world():
    scenery = Mesh.joined([ground(), block((103.0, 54.0, 2.0), (0.5, 0.5, 2.0))])
    ego = Straight(Pose(x=100.0, y=50.0, z=0.0, yaw=np.arctan2(4, 3)))
    points = sweep_of(street(scenery=scenery, ego=ego), EXACT)
    on_block = points[points[:, 2] > -1.5]
    assert len(on_block) > 0
    assert np.abs(on_block[:, 1]).max() < 0.8  # the block stands straight ahead, 5 m away
    assert on_block[:, 0].min() == pytest.approx(4.4, abs=0.2)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_whole_sweep_has_64_rings_in_kittis_order(seed: int):
    points = sweep_of(street(scenery=courtyard()), LIDARS["hdl-64e"], seed)
    rings = ring_numbers(points)
    assert rings.max() == 63
    azimuth = azimuths(points)
    for ring in range(64):
        assert (np.diff(azimuth[rings == ring]) > 0).all()  # counter-clockwise from ahead


def test_azimuths_are_reported_at_the_encoders_steps_and_ranges_as_measured():
    """KITTI's rings have steps of 0.18 degrees and, one in seven, of 0.09."""
    encoder = LIDARS["hdl-64e"]
    exact = sweep_of(street(scenery=courtyard()), replace(encoder, azimuth_resolution_deg=0.0))
    points = sweep_of(street(scenery=courtyard()), encoder)
    assert len(points) == len(exact)
    assert np.abs(np.linalg.norm(points[:, :3] - exact[:, :3], axis=1)).max() < 0.1
    assert np.allclose(
        np.linalg.norm(points[:, :2], axis=1), np.linalg.norm(exact[:, :2], axis=1), atol=0.1
    )
    rings = ring_numbers(points)
    far = np.linalg.norm(points[:, :2], axis=1) > 5  # files hold millimetres
    steps = np.concatenate([np.diff(azimuths(points[(rings == ring) & far])) for ring in range(64)])
    steps = steps[(steps > 0) & (steps < 0.2)]  # no gaps of lost returns
    is_short = np.abs(steps - 0.09) < 0.03
    assert len(steps) > 10_000
    assert (is_short | (np.abs(steps - 0.18) < 0.03)).all()
    assert is_short.mean() == pytest.approx((0.18 - 360 / 2150) / 0.09, abs=0.02)


def test_the_part_that_the_camera_sees_is_numbered_too():
    points = sweep_of(street(scenery=courtyard()), LIDARS["hdl-64e"])
    ahead = points[np.abs(points[:, 1]) < 0.8 * points[:, 0]]
    ahead = ahead[ahead[:, 2] > -0.26 * ahead[:, 0]]  # the image's lower edge
    assert 30 < ring_numbers(ahead).max() < 64


@pytest.mark.parametrize(("model", "beams"), [("hdl-64e", 64), ("hdl-32e", 32), ("vlp-16", 16)])
def test_models_have_their_number_of_beams(model: str, beams: int):
    config = replace(LIDARS[model], range_noise_m=0.0, blind_sectors=(), lean_deg=0.0)
    points = sweep_of(street(scenery=courtyard(10.0)), config).astype(np.float64)
    lasers = config.lasers
    assert len(lasers) == beams
    distance = np.hypot(points[:, 0], points[:, 1])[:, None]
    heights = points[:, 2:3] - np.array([laser.offset_m for laser in lasers])
    elevations = np.degrees(np.arctan2(heights, distance))
    errors = np.abs(elevations - np.array([laser.elevation_deg for laser in lasers]))
    assert errors.min(axis=1).max() < 0.05
    assert len(np.unique(errors.argmin(axis=1))) == beams


def test_range_noise_has_the_spread_that_the_sensor_says():
    wall = street(scenery=block((10.0, 0.0, 0.0), (0.5, 40.0, 40.0)))
    points = sweep_of(wall, replace(UNBIASED, range_noise_m=0.03)).astype(np.float64)
    points = points[np.abs(points[:, 1]) < 1]
    ranges = np.linalg.norm(points[:, :3], axis=1)
    errors = ranges - ranges * 9.5 / points[:, 0]
    assert errors.std() == pytest.approx(0.03, rel=0.1)
    assert abs(errors.mean()) < 0.005


def test_fewer_returns_come_from_afar_and_at_a_slant():
    config = replace(LIDARS["hdl-64e"], drop_out=0.0)

    def found_share(distance_m: float, scenery: Mesh) -> float:
        found = sweep_of(street(scenery=scenery), config)
        ideal = sweep_of(street(scenery=scenery), replace(config, detectable_echo=1e-9))
        assert len(ideal) > 100, distance_m
        return len(found) / len(ideal)

    dark = (0.02, 0.02, 0.02)
    walls = [
        block((d, 0.0, 3.0), (0.2, 8.0, 3.0), Material.RUBBER, dark) for d in (8.0, 60.0, 75.0)
    ]
    near, middle, far = (found_share(w.vertices[0, 0], w) for w in walls)
    assert near > 0.98
    assert near > middle > far
    facing = block((30.0, 0.0, 3.0), (0.2, 4.0, 3.0), Material.RUBBER, dark)
    along = block((30.0, 4.0, 3.0), (20.0, 0.2, 3.0), Material.RUBBER, dark)
    assert found_share(30.0, facing) > found_share(30.0, along)


def test_nothing_returns_from_beyond_the_sensors_range_or_from_too_near():
    config = replace(EXACT, min_range_m=6.0, max_range_m=20.0)
    ranges = np.linalg.norm(sweep_of(street(), config)[:, :3], axis=1)
    assert ranges.min() >= 5.7  # the beams' offsets
    assert ranges.max() <= 20.3


def test_reflectances_are_hundredths_from_0_to_99():
    points = sweep_of(street(scenery=courtyard()), LIDARS["hdl-64e"])
    hundredths = points[:, 3].astype(np.float64) * 100
    assert np.abs(hundredths - hundredths.round()).max() < 1e-4
    assert hundredths.min() >= 0
    assert hundredths.max() <= 99.0001


def test_a_retro_reflector_outshines_a_wall_and_a_wall_a_tyre():
    def reading(material: Material, distance_m: float = 12.0) -> float:
        wall = block((distance_m, 0.0, 0.0), (0.2, 3.0, 3.0), material)
        return float(np.median(sweep_of(street(scenery=wall), LIDARS["hdl-64e"])[:, 3]))

    assert reading(Material.RETRO_REFLECTOR) == pytest.approx(0.99)
    assert reading(Material.PLASTER) > 2 * reading(Material.RUBBER)
    assert reading(Material.PLASTER, 12.0) > reading(Material.PLASTER, 60.0)


def test_most_beams_pass_one_pane_and_return_from_what_stands_behind():
    pane = block((10.0, 0.0, 2.0), (0.01, 3.0, 3.0), Material.GLASS)
    front = Mesh.joined([pane, block((20.0, 0.0, 4.0), (0.5, 20.0, 8.0))])
    # Only the pane's front face: a real pane is thinner than the resolution of the LiDAR.
    first = front.faces[:12]
    facing = front.vertices[first].mean(axis=1)[:, 0] < 9.995
    keep = np.concatenate((facing, np.ones(len(front.faces) - 12, dtype=bool)))
    scenery = replace(
        front,
        faces=front.faces[keep],
        materials=front.materials[keep],
        colors=front.colors[keep],
    )
    points = sweep_of(street(scenery=scenery), EXACT)
    across, up = np.abs(points[:, 1:3].T) / points[:, 0]
    through = points[(across < 0.2) & (up < 0.15)]
    passed = (through[:, 0] > 15).mean()
    assert passed == pytest.approx(SURFACES[Material.GLASS].lidar_transmission, abs=0.04)
    assert np.allclose(through[through[:, 0] > 15, 0], 19.5, atol=0.01)
    assert np.allclose(through[through[:, 0] <= 15, 0], 9.99, atol=0.01)


def test_what_stands_behind_a_pane_reads_darker():
    wall = block((20.0, 0.0, 4.0), (0.5, 20.0, 8.0))
    pane = quads(
        np.array([[[10.0, -9.0, -9.0], [10.0, 9.0, -9.0], [10.0, 9.0, 9.0], [10.0, -9.0, 9.0]]]),
        Finish(Material.GLASS, GREY),
    )

    def reading(*parts: Mesh) -> float:
        points = sweep_of(street(scenery=Mesh.joined([wall, *parts])), EXACT)
        return float(np.median(points[points[:, 0] > 15, 3]))

    assert 0 < reading(pane) < reading() - 0.2


def tiles_of_paint(colors: np.ndarray, distance_m: float) -> Mesh:
    """A wall of upright strips, 0.4 m wide each, from the right to the left."""
    lefts = 0.4 * (np.arange(len(colors)) - len(colors) / 2)
    return Mesh.joined(
        [
            block(
                (distance_m, left + 0.2, 0.0),
                (0.1, 0.2, 2.0),
                Material.CAR_PAINT,
                tuple(color.tolist()),
            )
            for left, color in zip(lefts, colors, strict=True)
        ]
    )


def on_tiles(points: np.ndarray, count: int, distance_m: float) -> list[np.ndarray]:
    points = points[np.abs(points[:, 0] - distance_m) < 0.3]
    tile = np.floor(points[:, 1] / 0.4 + count / 2).astype(int)
    return [points[tile == index] for index in range(count)]


def test_paints_alike_to_the_eye_differ_for_the_laser_and_the_dull_ones_swallow_it():
    colors = np.random.default_rng(0).uniform(0.2, 0.3, (40, 3))
    near, far = (
        on_tiles(sweep_of(street(scenery=tiles_of_paint(colors, x)), UNBIASED), 40, x)
        for x in (10.0, 30.0)
    )
    readings = np.array([np.median(tile[:, 3]) if len(tile) > 50 else 0.0 for tile in near])
    assert 0.2 < (readings == 0).mean() < 0.7
    assert 0.2 < (readings > 0.25).mean() < 0.7
    counts = np.array([len(tile) for tile in far])
    bright, dull = counts[readings > 0.25], counts[readings == 0]
    assert bright.min() > 0.7 * counts.max()
    assert dull.min() < 0.2 * counts.max()


def test_one_paint_reads_the_same_wherever_it_is_and_in_any_sweep():
    colors = np.repeat(np.random.default_rng(3).uniform(0.2, 0.3, (1, 3)), 40, axis=0)
    config = replace(UNBIASED, drop_out=0.0)
    sweeps = [
        sweep_of(street(scenery=tiles_of_paint(colors, 10.0)), config, seed) for seed in (0, 1)
    ]
    medians = [
        np.median(tile[:, 3]) for sweep in sweeps for tile in on_tiles(sweep, 40, 10.0)[15:25]
    ]
    assert np.ptp(medians) < 0.06


def test_paint_that_is_met_at_a_slant_reads_as_nothing_where_plaster_does_not():
    def reading(material: Material) -> float:
        along = block((30.0, 4.0, 1.0), (20.0, 0.2, 3.0), material)
        points = sweep_of(street(scenery=along), UNBIASED)
        far = (np.abs(points[:, 1] - 3.8) < 0.1) & (points[:, 0] > 20) & (points[:, 0] < 30)
        return float(np.median(points[far, 3])) if far.any() else 0.0

    assert reading(Material.CAR_PAINT) == 0 < reading(Material.PLASTER)


def test_faint_readings_are_reported_as_0():
    wall = block((45.0, 0.0, 5.0), (0.2, 30.0, 5.0), Material.BARK)
    readings = sweep_of(street(scenery=wall), UNBIASED)[:, 3]
    assert 0.1 < (readings == 0).mean() < 0.95
    assert readings[readings > 0].min() > 0.055


def test_each_laser_adds_its_own_bias_to_ranges_and_readings():
    lasers = (
        Laser(elevation_deg=2.0, range_bias_m=0.05, reading_bias=-0.1),
        Laser(elevation_deg=0.0),
        Laser(elevation_deg=-2.0, range_bias_m=-0.03, reading_bias=0.1),
    )
    wall = street(scenery=block((10.0, 0.0, 0.0), (0.5, 4.0, 4.0)))
    points = sweep_of(wall, replace(SLOPED, lasers=lasers, azimuth_step_deg=0.1)).astype(np.float64)
    ranges = np.linalg.norm(points[:, :3], axis=1)
    errors = ranges - ranges * 9.5 / (points[:, 0] - 0.0)
    elevation = np.degrees(np.arcsin(points[:, 2] / ranges)).round().astype(int)
    for laser in lasers:
        is_laser = elevation == laser.elevation_deg
        assert np.median(errors[is_laser]) == pytest.approx(laser.range_bias_m, abs=2e-3)
    middle = np.median(points[elevation == 0, 3])
    assert np.median(points[elevation == 2, 3]) == pytest.approx(middle - 0.1, abs=0.02)
    assert np.median(points[elevation == -2, 3]) == pytest.approx(middle + 0.1, abs=0.02)


def test_two_panes_swallow_most_beams():
    panes = [block((x, 0.0, 0.0), (0.01, 3.0, 9.0), Material.GLASS) for x in (10.0, 11.0)]
    wall = block((20.0, 0.0, 0.0), (0.5, 3.0, 9.0))
    with_panes = sweep_of(street(scenery=Mesh.joined([*panes, wall])), EXACT)
    without = sweep_of(street(scenery=wall), EXACT)
    assert (with_panes[:, 0] > 15).sum() < 0.1 * len(without)


def test_the_cars_own_roof_hides_what_is_low_in_its_sector():
    sector = BlindSector(azimuth_deg=(160.0, 200.0), below_deg=-10.0)
    points = sweep_of(street(), replace(SLOPED, blind_sectors=(sector,)))
    low = points[np.hypot(points[:, 0], points[:, 1]) < 10]
    high = points[np.hypot(points[:, 0], points[:, 1]) > 10]
    assert len(low) == 320
    assert len(high) == 360
    assert not ((azimuths(low) > 160) & (azimuths(low) < 200)).any()


def test_a_rolling_shutter_skews_a_wall_by_the_way_driven():
    ego = Straight(Pose(x=0.0, y=0.0, z=0.0, yaw=0.0), speed_mps=20.0)
    scenery = street(scenery=courtyard(20.0), ego=ego)
    still = sweep_of(scenery, EXACT, ego=ego)
    moving = sweep_of(scenery, replace(EXACT, rolling_shutter=True), ego=ego)

    def distance_to_walls(points: np.ndarray, azimuth_deg: float) -> float:
        near = np.abs((azimuths(points) - azimuth_deg + 180) % 360 - 180) < 1
        high = points[:, 2] > -1.2
        return float(np.abs(points[near & high, 0]).mean())

    # The turn starts and ends behind, so straight ahead is met after half of its 0.1 s.
    assert distance_to_walls(still, 0.0) == pytest.approx(19.8, abs=0.01)
    assert distance_to_walls(moving, 0.0) == pytest.approx(19.8 - 1.0, abs=0.03)
    assert distance_to_walls(moving, 178.5) == pytest.approx(19.8 + 2.0, abs=0.05)
    assert distance_to_walls(moving, 181.5) == pytest.approx(19.8 + 0.0, abs=0.05)


def test_a_rolling_shutter_on_a_standing_car_changes_nothing():
    ego = Turning(0.0)
    scenery = street(scenery=courtyard(20.0), ego=ego)
    still = sweep_of(scenery, EXACT, ego=ego)
    rolling = sweep_of(scenery, replace(EXACT, rolling_shutter=True), ego=ego)
    assert np.allclose(still, rolling, atol=1.1e-3)


def test_the_same_seed_gives_the_same_sweep_and_another_does_not():
    scenery = street(scenery=courtyard())
    first, again, other = (sweep_of(scenery, LIDARS["hdl-64e"], seed) for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert len(first) != len(other) or not np.array_equal(first, other)


def test_lasers_that_do_not_fall_from_the_top_are_refused():
    with pytest.raises(ValueError, match="fall from the top"):
        LidarConfig(lasers=(Laser(elevation_deg=0.0), Laser(elevation_deg=1.0)))
    with pytest.raises(ValueError, match="fall from the top"):
        LidarConfig(lasers=())
    with pytest.raises(ValueError, match="min_range_m below max_range_m"):
        replace(EXACT, min_range_m=90.0)


@pytest.mark.parametrize(
    "azimuth_deg", [(340.0, 16.0), (10.0, 10.0), (-20.0, 16.0), (350.0, 370.0)]
)
def test_a_blind_sector_that_would_hide_nothing_is_refused(azimuth_deg: tuple[float, float]):
    with pytest.raises(ValueError, match="must rise within 0 to 360"):
        BlindSector(azimuth_deg=azimuth_deg, below_deg=-20.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"azimuth_step_deg": float("nan")}, "azimuth_step_deg above 0"),
        ({"drop_out": 1.5}, "drop_out must be finite and from 0 to 1, got 1.5"),
        ({"range_noise_m": -0.1}, "range_noise_m must be finite and at least 0, got -0.1"),
        ({"detectable_echo": 0.0}, "detectable_echo must be above 0, got 0"),
    ],
)
def test_a_lidar_that_cannot_be_is_refused(wrong: dict[str, float], message: str):
    with pytest.raises(ValueError, match=message):
        replace(EXACT, **wrong)


def test_a_rolling_shutter_without_the_way_of_the_car_is_refused():
    with pytest.raises(ValueError, match="give its way, ego"):
        sweep_of(street(scenery=courtyard(20.0)), replace(EXACT, rolling_shutter=True))
