"""Embree's hits against a slow reference, and refused arguments."""

import copy
import ctypes.util
import inspect
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.simulation.rays import raycast
from sightline.simulation.rays.raycast import EmbreeScene, Raycaster
from sightline.simulation.scene import Material
from tests.reference.raycast import crossing, first_hit, margin
from tests.simulation.camera.scenes import rectangle

SEEDS = st.integers(0, 2**32 - 1)


def random_triangles(rng, count):
    """Vertices shared among faces, about the origin."""
    vertices = rng.uniform(-3, 3, (count + 2, 3)).astype(np.float32)
    faces = np.stack([rng.choice(len(vertices), 3, replace=False) for _ in range(count)])
    return vertices, faces.astype(np.int32)


def random_rays(rng, count):
    """Draw rays, some far from unit length; distances are in units of their directions."""
    directions = rng.normal(size=(count, 3)) * rng.uniform(0.2, 5, (count, 1))
    return rng.uniform(-3, 3, (count, 3)).astype(np.float32), directions.astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 12), st.integers(1, 19), st.booleans())
def test_first_hits_are_those_of_the_reference(seed, num_faces, num_rays, coherent):
    rng = np.random.default_rng(seed)
    vertices, faces = random_triangles(rng, num_faces)
    origins, directions = random_rays(rng, num_rays)
    found, distances, barycentric = EmbreeScene(vertices, faces).intersect(
        origins, directions, coherent=coherent
    )
    triangles = vertices.astype(np.float64)[faces]
    for ray in range(num_rays):
        origin, direction = origins[ray].astype(np.float64), directions[ray].astype(np.float64)
        if margin(origin, direction, triangles) < 1e-3:
            continue  # single precision may decide otherwise
        expected = first_hit(origin, direction, triangles)
        if expected is None:
            assert found[ray] == -1
            assert distances[ray] == np.inf
            assert barycentric[ray].tolist() == [0.0, 0.0]
        else:  # of two faces at one place either may be found
            distance, u, v = crossing(origin, direction, triangles[found[ray]])
            assert distance == pytest.approx(expected[1], rel=1e-4)
            np.testing.assert_allclose(distances[ray], distance, rtol=1e-3)
            np.testing.assert_allclose(barycentric[ray], (u, v), atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.integers(1, 12), st.integers(1, 19), st.floats(0.1, 6), st.booleans())
def test_a_ray_is_occluded_where_its_first_hit_is_within_reach(
    seed, num_faces, num_rays, reach, coherent
):
    rng = np.random.default_rng(seed)
    scene = EmbreeScene(*random_triangles(rng, num_faces))
    rays = random_rays(rng, num_rays)
    _, distances, _ = scene.intersect(*rays, coherent=False)
    hidden = scene.occluded(*rays, reach, coherent=coherent)
    clear = np.abs(distances - reach) > 1e-3
    np.testing.assert_array_equal(hidden[clear], (distances < reach)[clear])


def wall():
    return rectangle((2.0, -1.0, -1.0), (0, 2, 0), (0, 0, 2), Material.PLASTIC)


def test_both_sides_of_a_face_are_met():
    raycaster = Raycaster(wall())
    origins = np.array([[0, 0, 0.5], [4, 0, 0.5]], np.float32)
    hits = raycaster.cast(origins, np.array([[1, 0, 0], [-1, 0, 0]], np.float32))
    assert hits.distances.tolist() == pytest.approx([2.0, 2.0])


def test_neither_a_mesh_without_faces_nor_a_cast_without_rays_is_an_error():
    nothing = np.zeros((0, 3), np.float32)
    ray = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
    empty = EmbreeScene(nothing, np.zeros((0, 3), np.int32))
    assert empty.intersect(*ray, coherent=True)[0].tolist() == [-1]
    assert empty.occluded(*ray, 10.0, coherent=True).tolist() == [False]
    raycaster = Raycaster(wall())
    assert len(raycaster.cast(nothing, nothing).faces) == 0
    assert len(raycaster.occluded(nothing, nothing)) == 0


def test_one_face_as_a_broadcast_view_is_a_face():
    corners = np.array([[2, -1, -1], [2, 1, -1], [2, 0, 1]], np.float32)
    face = np.broadcast_to(np.array([0, 1, 2], np.int32), (1, 3))
    ray = np.zeros((1, 3), np.float32), np.array([[1, 0, 0]], np.float32)
    assert EmbreeScene(corners, face).intersect(*ray, coherent=False)[0].tolist() == [0]


def test_rays_without_a_direction_each_are_refused():
    origins, one = np.zeros((16, 3), np.float32), np.ones((1, 3), np.float32)
    scene = Raycaster(wall())._scene
    # the shape checks of the tests would fail first
    intersect = inspect.unwrap(EmbreeScene.intersect)
    occluded = inspect.unwrap(EmbreeScene.occluded)
    with pytest.raises(ValueError, match=r"got arrays of \(16, 3\) and \(1, 3\)"):
        intersect(scene, origins, one, coherent=True)
    with pytest.raises(ValueError, match="an origin and a direction of 3 numbers each"):
        occluded(scene, origins, origins[:, :2], 10.0, coherent=True)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_scenes_are_not_copied(copied):
    with pytest.raises(TypeError, match="cannot be copied or pickled: build it from its mesh"):
        copied(Raycaster(wall())._scene)


@pytest.mark.parametrize("wrong", [-1, 3])
def test_faces_of_vertices_that_there_are_not_are_refused(wrong):
    with pytest.raises(ValueError, match="faces must name vertices 0 to 2, got"):
        EmbreeScene(np.eye(3, dtype=np.float32), np.array([[0, 1, wrong]], np.int32))


def test_an_embreex_without_the_library_is_named(monkeypatch):
    monkeypatch.setattr(raycast, "_library_file", lambda: ctypes.util.find_library("c"))
    with pytest.raises(ImportError, match=r"no Embree 4 library .* install embreex 4\.4"):
        raycast.embree_library.__wrapped__()
