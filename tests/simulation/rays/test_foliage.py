"""Gaps of foliage, through which rays pass."""

import numpy as np
import pytest

from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rays.surfaces import Rays, cast_through_foliage, mesh_tables
from sightline.simulation.scene import Material
from tests.simulation.camera.scenes import rectangle, scene_of


def cast_ahead(meshes, *, start=(0.0, 0.0, 0.0), reach=1.0):
    """Hits of a fan of rays that cover 2 m x 2 m at x = 10 evenly, from a place near x = 0."""
    scene = scene_of(meshes)
    side = (np.arange(60) + 0.5) / 30 - 1
    y, z = (axis.ravel() for axis in np.meshgrid(side, side))
    targets = np.stack((np.full_like(y, 10.0), y, z), axis=1)
    directions = ((targets - start) * reach).astype(np.float32)
    origins = np.broadcast_to(np.float32(start), directions.shape).copy()
    hits = cast_through_foliage(
        Raycaster(scene.mesh), mesh_tables(scene.mesh), Rays(origins, directions)
    )
    return hits, directions


def card(x, size=2.4):
    return rectangle((x, -size / 2, -size / 2), (0, size, 0), (0, 0, size), Material.LEAF)


def wall(x, size=40.0):
    return rectangle((x, -size / 2, -size / 2), (0, size, 0), (0, 0, size), Material.PLASTIC)


def test_a_card_is_partly_open_and_what_lies_behind_shows_at_its_own_distance():
    hits, directions = cast_ahead([card(10.0), wall(20.0)])
    on_card, on_wall = hits.faces < 2, hits.faces >= 2
    assert 0.2 < on_wall.mean() < 0.6
    reached = hits.distances * directions[:, 0]
    np.testing.assert_allclose(reached[on_card], 10.0, rtol=1e-5)
    np.testing.assert_allclose(reached[on_wall], 20.0, rtol=1e-5)


def test_several_cards_hide_more_than_one():
    one, _ = cast_ahead([card(10.0), wall(20.0)])
    three, _ = cast_ahead([card(10.0), card(10.4), card(10.8), wall(20.0)])
    assert (three.faces >= 6).mean() < 0.5 * (one.faces >= 2).mean()


def test_gaps_stay_where_they_are_when_the_camera_moves():
    here, _ = cast_ahead([card(10.0), wall(20.0)])
    there, _ = cast_ahead([card(10.0), wall(20.0)], start=(2.0, 0.7, -0.4))
    same = (here.faces < 2) == (there.faces < 2)
    assert same.mean() > 0.99


@pytest.mark.parametrize("reach", [0.1, 7.0])
def test_distances_are_in_lengths_of_the_direction(reach):
    unit, _ = cast_ahead([card(10.0), wall(20.0)])
    scaled, _ = cast_ahead([card(10.0), wall(20.0)], reach=reach)
    same = unit.faces == scaled.faces
    assert same.mean() > 0.99
    np.testing.assert_allclose(scaled.distances[same] * reach, unit.distances[same], rtol=1e-4)


def test_a_ray_through_all_cards_meets_nothing():
    hits, _ = cast_ahead([card(10.0)])
    passed = hits.faces < 0
    assert passed.any()
    assert np.isinf(hits.distances[passed]).all()


def test_woods_on_the_horizon_and_other_surfaces_are_closed():
    for closed in (wall(10.0), card(10.0, size=30.0)):
        hits, _ = cast_ahead([closed, wall(20.0)])
        assert (hits.faces < 2).all()
