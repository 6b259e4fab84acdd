"""Whole streets: sound meshes on the ground, the same for the same seed."""

from dataclasses import fields

import numpy as np
import pytest

from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch, stamped
from sightline.simulation.shapes.primitives import Finish, box
from sightline.simulation.street import make_street
from sightline.simulation.streets.dressing import dress
from sightline.simulation.streets.free_ground import Occupancy
from sightline.simulation.streets.layout import StreetKind
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.surroundings.furniture import _MAKERS, _PARTS, Item, item_model
from sightline.simulation.surroundings.trees import Detail, Species, tree_model

MAX_TRIANGLES = 250_000
GROUND = (
    Material.ASPHALT, Material.PAVEMENT, Material.GRASS, Material.SOIL, Material.KERB,
    Material.COBBLES, Material.GRAVEL, Material.CONCRETE, Material.METAL,
)  # fmt: skip


@pytest.fixture(scope="module")
def streets():
    return {
        (kind, seed): make_street(np.random.default_rng([5, seed]), kind=kind)
        for kind in StreetKind
        for seed in range(3)
    }


def _assert_sound(mesh: Mesh) -> None:
    assert np.isfinite(mesh.vertices).all()
    assert np.isfinite(mesh.uvs).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-4)
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert mesh.colors.min() >= 0.0
    assert mesh.colors.max() <= 1.0
    assert set(np.unique(mesh.materials)) <= set(Material)
    assert {len(mesh.materials), len(mesh.colors)} == {len(mesh.faces)}


def test_the_same_seed_gives_the_same_street_to_the_last_bit():
    first, second = (make_street(np.random.default_rng(11)).snapshot() for _ in range(2))
    for field in fields(Mesh):
        expected, repeated = (
            getattr(first.mesh, field.name),
            getattr(second.mesh, field.name),
        )
        assert expected.tobytes() == repeated.tobytes()
    assert first.poses == second.poses
    assert first.light == second.light
    other = make_street(np.random.default_rng(12)).snapshot()
    assert other.mesh.vertices.shape != first.mesh.vertices.shape


def test_meshes_of_all_kinds_of_street_are_sound_and_small_enough(streets):
    for street in streets.values():
        _assert_sound(street.ground_and_buildings)
        assert len(street.ground_and_buildings.faces) <= MAX_TRIANGLES


def test_all_actors_stand_on_the_surface_below_them(streets):
    num_actors = 0
    for street in streets.values():
        if not street.actors:
            continue
        poses = [actor.motion.at(0.0) for actor in street.actors]
        caster = Raycaster(street.ground_and_buildings)
        origins = np.array([[pose.x, pose.y, pose.z + 0.6] for pose in poses], np.float32)
        down = np.tile(np.array([0, 0, -1], np.float32), (len(poses), 1))
        hits = caster.cast(origins, down)
        assert (hits.faces >= 0).all()
        on_ground = np.isin(
            street.ground_and_buildings.materials[hits.faces], np.array(GROUND, np.int32)
        )
        assert on_ground.mean() > 0.97
        # Who steps off a kerb is half-way down for a moment.
        steps = np.array([(x, y, 0) for x in (-0.2, 0, 0.2) for y in (-0.2, 0, 0.2)], np.float32)
        around = np.array([caster.cast(origins + step, down).distances - 0.6 for step in steps])
        off = np.where(np.sign(around.min(axis=0)) == np.sign(around.max(axis=0)), around[4], 0)
        walks = np.array([actor.class_name == "Pedestrian" for actor in street.actors])
        # The wheels of a long vehicle bridge the ground between them.
        assert np.abs(np.where(walks, off, around[4]))[on_ground].max() < 0.05
        num_actors += len(poses)
    assert num_actors > 50


def test_the_ego_stands_on_the_road_with_nothing_close_ahead(streets):
    for street in streets.values():
        scene = street.snapshot()
        caster = Raycaster(scene.mesh)
        start = np.array([[scene.ego.x, scene.ego.y, scene.ego.z + 1.0]], np.float32)
        down = caster.cast(start, np.array([[0, 0, -1]], np.float32))
        assert down.distances[0] == pytest.approx(1.0, abs=0.02)
        ahead = caster.cast(start, np.array([[1, 0, 0]], np.float32))
        assert ahead.distances[0] > 3.5


def test_ground_reaches_to_the_horizon_without_holes(streets):
    rng = np.random.default_rng(0)
    for street in streets.values():
        caster = Raycaster(street.ground_and_buildings)
        places = rng.uniform(-1, 1, (4000, 2)) * rng.choice([60.0, 150.0, 900.0], (4000, 1))
        origins = np.column_stack((places, np.full(4000, 120.0))).astype(np.float32)
        hits = caster.cast(origins, np.tile(np.array([0, 0, -1], np.float32), (4000, 1)))
        assert (hits.faces >= 0).all()


def test_a_drive_moves_the_ego_and_keeps_everybody_apart_from_it():
    street = make_street(np.random.default_rng(3), duration_s=4.0, kind=StreetKind.AVENUE)
    start, stop = street.ego.at(0.0), street.ego.at(4.0)
    assert np.hypot(start.x, start.y) < 1e-9
    assert np.hypot(stop.x - start.x, stop.y - start.y) <= 14.0 * 4.0
    for time_s in (0.0, 2.0, 4.0):
        ego = street.ego.at(time_s)
        for actor in street.actors:
            pose = actor.motion.at(time_s)
            assert np.hypot(pose.x - ego.x, pose.y - ego.y) > 0.9


def test_nothing_is_set_out_on_ground_that_is_taken():
    layout = draw_layout(np.random.default_rng(2), StreetKind.CITY)
    taken = Occupancy(3)
    free = dress(np.random.default_rng(2), layout, taken)
    assert sum(len(part.faces) for part in free) > 5000
    blocked = Occupancy(3)
    blocked.take(np.zeros((3, 4)), 1000.0, 1000.0)
    none = dress(np.random.default_rng(2), layout, blocked)
    assert sum(len(part.faces) for part in none) == 0


def test_each_item_has_one_maker_or_one_row_of_the_table():
    made = {item.name for item in _MAKERS}
    assert made | _PARTS.keys() == {item.name for item in Item}
    assert not made & _PARTS.keys()


def test_a_negative_duration_is_refused():
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        make_street(np.random.default_rng(0), duration_s=-1.0)


@pytest.mark.parametrize("item", list(Item))
def test_street_furniture_stands_on_the_ground_and_is_sound(item):
    mesh = item_model(item)
    _assert_sound(mesh)
    assert -0.35 <= mesh.vertices[:, 2].min() <= 0.06
    assert len(mesh.faces) < 800


@pytest.mark.parametrize("species", list(Species))
def test_trees_have_their_height_at_every_detail_and_fewer_faces_farther_off(species):
    sizes = []
    for detail in Detail:
        mesh = tree_model(species, detail, 0)
        _assert_sound(mesh)
        sizes.append(len(mesh.faces))
        assert 0 < np.quantile(mesh.vertices[:, 2], 0.99) < 22.0
    assert sizes == sorted(sizes, reverse=True)


def test_copies_of_a_mesh_are_turned_stretched_moved_and_tinted():
    leaf = box((1.0, 0.0, 0.5), (0.5, 0.25, 0.5), Finish(Material.LEAF, (0.2, 0.2, 0.2)))
    copies = stamped(
        leaf,
        np.array([[10.0, 0.0, 0.0], [0.0, 5.0, 1.0]]),
        np.array([np.pi / 2, 0.0]),
        scales=np.array([[2.0, 1.0, 1.0], [1.0, 1.0, 3.0]]),
        tints=np.array([[0.5, 1.0, 1.0], [1.0, 1.0, 1.0]]),
        tinted=(Material.LEAF,),
    )
    _assert_sound(copies)
    first, second = np.split(copies.vertices, 2)
    np.testing.assert_allclose(first.min(axis=0), [9.75, 1.0, 0.0], atol=1e-5)
    np.testing.assert_allclose(first.max(axis=0), [10.25, 3.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(second.max(axis=0), [1.5, 5.25, 4.0], atol=1e-5)
    np.testing.assert_allclose(copies.colors[0], [0.1, 0.2, 0.2], atol=1e-6)


def test_rectangles_are_placed_by_the_frame_they_were_added_in():
    batch = QuadBatch()
    square = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]], np.float64)
    finish = Finish(Material.PLASTER, (0.5, 0.5, 0.5))
    batch.add(square, finish)
    batch.use_frame(2.0, 3.0, 4.0, np.pi / 2)
    batch.add(square, finish)
    batch.use_world()
    batch.add(square, finish, uvs=np.full((1, 4, 2), 7.0))
    mesh = batch.mesh()
    _assert_sound(mesh)
    np.testing.assert_allclose(mesh.vertices[4:8].max(axis=0), [2.0, 4.0, 5.0], atol=1e-6)
    np.testing.assert_allclose(mesh.normals[0], [0, -1, 0], atol=1e-6)
    np.testing.assert_allclose(mesh.normals[4], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(mesh.uvs[:4], [[0, 0], [1, 0], [1, 1], [0, 1]])
    np.testing.assert_allclose(mesh.uvs[8:], 7.0)
