"""Sky detection for weather, and walls and roads of the sky's colour."""

import dataclasses

import numpy as np
import pytest
import torch

from sightline.corruptions.scene_depth import scene_ranges
from sightline.data.open import open_dataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.scenes import sample_of
from tests.geometry.cameras import kitti_like_calibration

SIZE = (375, 1242)
WALL = (slice(20, 100), slice(420, 800))  # pixels of the wall that no ring reaches


def grid(first, second):
    return (v.flatten() for v in torch.meshgrid(first, second, indexing="ij"))


def wall_points():
    """A wall 20 m before the camera, seen up to half a metre above the sensor."""
    y, z = grid(torch.linspace(-12, 12, 600), torch.linspace(-1.6, 0.6, 24))
    return torch.stack((torch.full_like(y, 20.27), y, z, torch.zeros_like(y)), dim=1)


def road_points():
    """A flat road to 60 m."""
    x, y = grid(torch.linspace(6, 60, 80), torch.linspace(-10, 10, 120))
    return torch.stack((x, y, torch.full_like(x, -1.7), torch.zeros_like(x)), dim=1)


def ranges_of(points, colors):
    """Ranges before an image of horizontal stripes: colours by the row where they begin."""
    image = torch.full((3, *SIZE), 60, dtype=torch.uint8)
    for row, color in colors.items():
        image[:, row:] = torch.tensor(color, dtype=torch.uint8)[:, None, None]
    sample = sample_of(
        points=points,
        depth=None,
        image=image,
        calibration=kitti_like_calibration(),
        image_size=SIZE,
    )
    return scene_ranges(sample).ranges_m


@pytest.mark.parametrize("color", [(250, 250, 250), (90, 150, 220), (20, 25, 40)])
def test_a_wall_of_the_colour_of_the_sky_is_no_sky(color):
    ranges = ranges_of(wall_points(), {0: color, 330: (60, 60, 60)})
    assert (ranges[WALL] < 25).all()


@pytest.mark.parametrize("color", [(250, 250, 250), (90, 150, 220)])
def test_the_sky_over_a_wall_or_a_tree_is_sky(color):
    ranges = ranges_of(wall_points(), {0: color, 110: (40, 60, 30)})
    assert (ranges[20:80, 420:800] > 1e5).all()
    assert (ranges[130:, 420:800] < 25).all()


def test_woods_at_the_end_of_the_road_are_far_but_no_sky():
    ranges = ranges_of(road_points(), {0: (250, 250, 250), 60: (30, 50, 20), 175: (90, 90, 90)})
    middle = slice(500, 700)
    assert (ranges[:40, middle] > 1e5).all()
    assert (ranges[80:150, middle] >= 99).all()
    assert (ranges[80:150, middle] < 200).all()


def test_grey_clouds_are_sky_where_no_echo_came_from():
    ranges = ranges_of(road_points(), {0: (170, 172, 175), 160: (90, 90, 90)})
    assert (ranges[:140, 500:700] > 1e5).all()


def test_on_simulated_streets_the_sky_is_found_and_little_else():
    dataset = open_dataset(PACKAGED_FRAMES, parts=("image", "points", "depth"))
    for sample in dataset:
        horizon = round(float(sample.calibration.image_from_camera[1, 2]))
        is_sky = sample.depth.numpy()[:horizon] == 0
        found = scene_ranges(dataclasses.replace(sample, depth=None)).ranges_m[:horizon] > 1000
        assert np.mean(found == is_sky) > 0.85
        assert np.mean(found & ~is_sky) < 0.02


@pytest.mark.parametrize("lidar_height_m", [1.73, 3.46])
def test_a_road_that_nothing_was_measured_of_lies_as_deep_as_the_sensors_stand_high(lidar_height_m):
    image = torch.zeros(3, *SIZE, dtype=torch.uint8)
    sample = sample_of(
        points=None, depth=None, image=image, calibration=kitti_like_calibration(), image_size=SIZE
    )
    ranges = scene_ranges(dataclasses.replace(sample, lidar_height_m=lidar_height_m))
    focal_px, center = kitti_like_calibration().image_from_camera[1, 1:3].tolist()
    column = round(float(kitti_like_calibration().image_from_camera[0, 2]))
    drop = (300 - int(center)) / focal_px
    assert ranges.source == "flat road"
    assert ranges.ranges_m[300, column] == pytest.approx(lidar_height_m / drop, rel=0.03)
