"""Geometry of the rendered camera image: depth, owners, edges."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.data.formats.pixels import image_from_lidar, resized_and_cropped
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.camera.camera import (
    SKY,
    STREET,
    CameraConfig,
    SensorConfig,
    render_camera,
)
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import Material, Pose
from tests.reference import shading as reference
from tests.simulation.camera.scenes import (
    DAY,
    DUSK,
    IMAGE_SIZE,
    QUIET,
    block,
    ground,
    rectangle,
    scene_of,
    small_calibration,
)

PIXELS = [(0, 0), (310, 0), (155, 47), (31, 90), (280, 60), (310, 93)]


def photograph(scene, *, seed=0, config=QUIET, calibration=None, size=IMAGE_SIZE):
    return render_camera(
        scene,
        calibration or small_calibration(),
        size,
        rng=np.random.default_rng(seed),
        config=config,
    )


def a_street():
    """Ground, a wall, two objects in front of it, one of them thin."""
    wall = rectangle((30, -20, 0), (0, 40, 0), (0, 0, 6), Material.BRICK, (0.5, 0.2, 0.15))
    car = block((9, -3, 0.2), (13, -1.2, 1.6), Material.CAR_PAINT, (0.1, 0.2, 0.6))
    pole = block((14, 2, 0), (14.1, 2.1, 4.0), Material.METAL, (0.4, 0.4, 0.4))
    return scene_of([ground(Material.ASPHALT, (0.15, 0.15, 0.15)), wall], [car, pole])


@settings(max_examples=20)
@given(
    slope=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    distance=st.floats(4.0, 60.0),
    offset=st.tuples(st.floats(-30, 30), st.floats(-10, 10)),
)
def test_depth_of_a_plane_is_where_the_pixels_meet_it_along_the_optical_axis(
    slope, distance, offset
):
    normal = np.array([1.0, slope[0], slope[1]])
    calibration = resized_and_cropped(small_calibration(), 1.0, int(offset[0]), int(offset[1]))
    middle = np.array([distance, 0.0, 0.0])
    sides = np.array([-slope[0], 1.0, 0.0]) * 300, np.array([-slope[1], 0.0, 1.0]) * 300
    in_world = middle - sides[0] / 2 - sides[1] / 2 + [0, 0, KITTI_LIDAR_HEIGHT_M]
    plane = rectangle(in_world, *sides, Material.PLASTIC)
    frame = photograph(scene_of([plane]), calibration=calibration)
    projection = image_from_lidar(calibration)
    for column, row in PIXELS:
        expected = reference.depth_of_plane(column, row, normal, distance, projection)
        assert frame.depth_m[row, column] == pytest.approx(expected, rel=2e-5)


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_pixel_belongs_to_what_its_ray_meets_first(seed):
    rng = np.random.default_rng(seed)
    objects = []
    for _ in range(4):
        low = rng.uniform((5, -6, 0), (20, 5, 1.5))
        objects.append(block(low, low + rng.uniform(0.3, 3.0, size=3)))
    scene = scene_of([ground(reach=60.0)], objects)
    frame = photograph(scene)
    calibration = astuple(small_calibration())
    raised = np.array([0, 0, KITTI_LIDAR_HEIGHT_M])
    for column, row in rng.integers((0, 0), (311, 94), size=(25, 2)):
        origin, way = reference.pixel_ray(column, row, *calibration)
        face, depth = reference.first_hit(
            scene.mesh.vertices, scene.mesh.faces, origin + raised, way
        )
        owner = scene.owners[face] if face >= 0 else SKY
        nearby = reference_owners_around(scene, column, row, calibration)
        assert frame.owners[row, column] == owner or len(nearby) > 1
        if face >= 0 and len(nearby) == 1:
            assert frame.depth_m[row, column] == pytest.approx(depth, rel=1e-4)


def reference_owners_around(scene, column, row, calibration):
    """Hits of rays a hundredth of a pixel away: float32 rays may pass an edge on either side."""
    owners = set()
    for x, y in ((-0.01, -0.01), (0.01, -0.01), (-0.01, 0.01), (0.01, 0.01)):
        origin, way = reference.pixel_ray(column + x, row + y, *calibration)
        raised = origin + np.array([0, 0, KITTI_LIDAR_HEIGHT_M])
        face, _ = reference.first_hit(scene.mesh.vertices, scene.mesh.faces, raised, way)
        owners.add(scene.owners[face] if face >= 0 else SKY)
    return owners


def test_convention_pixel_zero_zero_is_the_centre_of_the_top_left_pixel():
    calibration = small_calibration()
    whole = photograph(a_street(), calibration=calibration)
    cropped = resized_and_cropped(calibration, 1.0, 40, 20)
    part = photograph(a_street(), calibration=cropped, size=(50, 100))
    np.testing.assert_array_equal(part.owners, whole.owners[20:70, 40:140])
    np.testing.assert_allclose(part.depth_m, whole.depth_m[20:70, 40:140], rtol=1e-4)


@given(x=st.floats(-50, 50), y=st.floats(-50, 50), z=st.floats(-2, 2), yaw=st.floats(-3.1, 3.1))
@settings(max_examples=10)
def test_the_camera_goes_where_the_ego_goes(x, y, z, yaw):
    near = a_street()
    pose = Pose(x=x, y=y, z=z, yaw=yaw)
    far = replace(near, mesh=near.mesh.placed(pose), ego=pose)
    here, there = photograph(near), photograph(far)
    same = here.owners == there.owners
    assert same.mean() > 0.995
    both = same & (here.depth_m > 0)
    # A pixel on the edge of two faces of one object may see either.
    close = np.abs(here.depth_m[both] / there.depth_m[both] - 1) < 1e-3
    assert close.mean() > 0.995


def test_the_sky_has_no_depth_and_no_owner():
    frame = photograph(scene_of([]))
    assert frame.image.shape == (*IMAGE_SIZE, 3)
    assert frame.image.dtype == np.uint8
    assert (frame.owners == SKY).all()
    assert (frame.depth_m == 0).all()
    assert frame.image.std() > 0


def test_a_street_without_actors_has_owners_street_and_sky_only():
    frame = photograph(scene_of([ground()]))
    assert set(np.unique(frame.owners)) == {STREET, SKY}
    np.testing.assert_array_equal(frame.depth_m > 0, frame.owners == STREET)


@pytest.mark.parametrize("light", [DAY, DUSK])
def test_the_same_seed_gives_the_same_bytes_with_or_without_a_raycaster(light):
    scene = replace(a_street(), light=light)
    config = CameraConfig()
    first = photograph(scene, config=config)
    again = render_camera(
        scene,
        small_calibration(),
        IMAGE_SIZE,
        rng=np.random.default_rng(0),
        config=config,
        raycaster=Raycaster(scene.mesh),
    )
    assert first.image.tobytes() == again.image.tobytes()
    assert first.depth_m.tobytes() == again.depth_m.tobytes()
    assert first.owners.tobytes() == again.owners.tobytes()


def test_another_seed_changes_nothing_but_the_noise():
    scene = a_street()
    first, other = (photograph(scene, seed=seed, config=CameraConfig()) for seed in (0, 1))
    np.testing.assert_array_equal(first.depth_m, other.depth_m)
    np.testing.assert_array_equal(first.owners, other.owners)
    difference = first.image.astype(float) - other.image
    assert 0.3 < difference.std() < 8.0
    assert abs(difference.mean()) < 0.2
    quiet_first, quiet_other = (photograph(scene, seed=seed) for seed in (0, 1))
    np.testing.assert_array_equal(quiet_first.image, quiet_other.image)


def test_more_samples_change_little_and_neither_depth_nor_owners():
    scene = a_street()
    one = photograph(scene)
    four = photograph(scene, config=replace(QUIET, samples_per_pixel=4))
    np.testing.assert_array_equal(one.depth_m, four.depth_m)
    np.testing.assert_array_equal(one.owners, four.owners)
    difference = one.image.astype(float) - four.image
    assert abs(difference.mean()) < 1.0
    assert np.sqrt((difference**2).mean()) < 8.0


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"ambient_stride": 0}, "ambient_stride must be finite and at least 1, got 0"),
        ({"ambient_rays": 0}, "ambient_rays must be finite and at least 1, got 0"),
    ],
)
def test_a_choice_that_makes_no_picture_is_named(choice, message):
    with pytest.raises(ValueError, match=message):
        CameraConfig(**choice)


def test_the_default_camera_has_noise_blur_and_vignette():
    sensor = SensorConfig()
    assert min(sensor.photon_noise, sensor.read_noise, sensor.lens_blur_px, sensor.vignette) > 0
