"""Additional rays at image edges, and the pixels that lend them radiance."""

import numpy as np

from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.camera.radiance import pixel_radiance
from sightline.simulation.camera.samples import add_edge_samples, camera_view, pixel_samples
from sightline.simulation.camera.shading import lit_world
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import Material
from tests.simulation.camera.scenes import (
    DAY,
    EVEN,
    IMAGE_SIZE,
    block,
    ground,
    rectangle,
    scene_of,
    small_calibration,
)


def prepared(scene):
    world = lit_world(scene, Raycaster(scene.mesh))
    return world, camera_view(small_calibration(), scene.ego, KITTI_LIDAR_HEIGHT_M)


def radiance_of(world, view, samples):
    return pixel_radiance(
        world, samples, view.pixel_angle, ambient_stride=2, ambient_rays=8, brightest=10.0
    )


def test_edges_come_close_to_the_mean_of_many_samples():
    """A bright slanted strip before a dark wall, under light that is even everywhere."""
    wall = rectangle((30, 40, -9), (0, -80, 0), (0, 0, 60), Material.RUBBER, (0.02, 0.02, 0.02))
    strip = rectangle((10, 2, 0), (0, -4, 1.1), (0, 0.2, 0.7), Material.PLASTIC, (0.8, 0.8, 0.8))
    scene = scene_of([wall, strip], light=EVEN)
    world, view = prepared(scene)
    places = (np.arange(6) + 0.5) / 6 - 0.5
    many = np.mean(
        [
            radiance_of(world, view, pixel_samples(world, view, IMAGE_SIZE, (x, y)))
            for x in places
            for y in places
        ],
        axis=0,
    )
    plain = pixel_samples(world, view, IMAGE_SIZE, (0.0, 0.0))
    smooth = add_edge_samples(world, view, plain, scene.owners)
    assert 0 < len(smooth.edges) < 0.1 * plain.columns.size
    error = np.abs(radiance_of(world, view, plain) - many).mean()
    assert np.abs(radiance_of(world, view, smooth) - many).mean() < 0.6 * error


def test_every_pixel_next_to_another_owner_is_an_edge():
    objects = [block((8, -2, 0), (10, 0, 1.5)), block((14, 0.5, 0), (15, 3, 2.5))]
    scene = scene_of([ground()], objects, light=DAY)
    world, view = prepared(scene)
    samples = add_edge_samples(
        world, view, pixel_samples(world, view, IMAGE_SIZE, (0.0, 0.0)), scene.owners
    )
    faces = samples.hits.faces[: IMAGE_SIZE[0] * IMAGE_SIZE[1]].reshape(IMAGE_SIZE)
    owners = np.where(faces >= 0, scene.owners[faces], -2)
    is_edge = np.zeros(IMAGE_SIZE, bool)
    is_edge.ravel()[samples.edges] = True
    assert is_edge[:, :-1][owners[:, :-1] != owners[:, 1:]].all()
    assert is_edge[1:][owners[:-1] != owners[1:]].all()
    assert is_edge.mean() < 0.15


def test_level_ground_has_no_edges_inside_however_many_faces_it_has():
    tiles = [
        rectangle((x, y, 0), (2, 0, 0), (0, 2, 0), Material.CONCRETE, (0.3, 0.3, 0.3))
        for x in range(2, 60, 2)
        for y in range(-20, 20, 2)
    ]
    scene = scene_of(tiles)
    world, view = prepared(scene)
    samples = add_edge_samples(
        world, view, pixel_samples(world, view, (40, 100), (100.0, 54.0)), scene.owners
    )
    assert len(np.unique(samples.hits.faces)) > 50
    assert len(samples.edges) == 0


def test_further_rays_show_a_pixel_that_sees_the_same_thing_or_are_shaded_themselves():
    objects = [
        block((8, -2, 0), (10, 0, 1.5), color=(0.8, 0.1, 0.1)),
        block((14, 1, 0), (15, 3, 2)),
    ]
    scene = scene_of([ground()], objects)
    world, view = prepared(scene)
    samples = add_edge_samples(
        world, view, pixel_samples(world, view, IMAGE_SIZE, (0.0, 0.0)), scene.owners
    )
    num_pixels = IMAGE_SIZE[0] * IMAGE_SIZE[1]
    rows, columns = np.divmod(samples.edges, IMAGE_SIZE[1])
    borrowed = samples.sample_rows < num_pixels
    assert 0.8 < borrowed.mean() <= 1.0
    lender_rows, lender_columns = np.divmod(samples.sample_rows, IMAGE_SIZE[1])
    assert np.abs(lender_rows - rows)[borrowed].max() <= 1
    assert np.abs(lender_columns - columns)[borrowed].max() <= 1
    own = samples.sample_rows[~borrowed]
    np.testing.assert_array_equal(np.sort(own), num_pixels + np.arange(own.size))


def test_something_thinner_than_a_pixel_gets_light_of_its_own():
    """A red wire that no pixel sees at its centre, before the line where two walls meet."""
    view = camera_view(small_calibration(), scene_of([]).ego, KITTI_LIDAR_HEIGHT_M)

    def band(depth, first_row, last_row, color):
        corner = view.center + depth * (view.corner + 20 * view.right + last_row * view.down)
        along, up = depth * 250 * view.right, -depth * (last_row - first_row) * view.down
        return rectangle(corner, along, up, Material.RETRO_REFLECTOR, color)

    upper, lower = band(20, 0, 39.5, (0.1, 0.1, 0.1)), band(20, 39.5, 90, (0.1, 0.1, 0.3))
    wire = band(10, 39.70, 39.78, (0.9, 0.1, 0.1))
    scene = scene_of([upper, lower, wire], light=EVEN)
    world, view = prepared(scene)
    plain = pixel_samples(world, view, IMAGE_SIZE, (0.0, 0.0))
    assert plain.hits.faces.max() < 4
    smooth = add_edge_samples(world, view, plain, scene.owners)
    redder = radiance_of(world, view, smooth) - radiance_of(world, view, plain)
    assert redder[40, 60:200, 0].min() > 0.05
    np.testing.assert_allclose(redder[45:80, 60:200], 0.0, atol=1e-5)
