import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.simulation.scene import Material
from sightline.simulation.shapes.edits import (
    both_sides,
    fitted,
    mirrored,
    painted,
    stretched,
    turned,
)
from sightline.simulation.shapes.primitives import (
    Finish,
    box,
    boxes,
    disc,
    grid,
    lathe,
    loft,
    moved,
    polygon,
    quads,
    repainted,
    rods,
    superellipsoid,
    torus,
    tube,
)

GREY = Finish(Material.METAL, (0.4, 0.4, 0.4))
RED = Finish(Material.PLASTIC, (0.5, 0.0, 0.0))

sizes = st.floats(0.05, 5.0)


def volume(mesh):
    """Signed volume enclosed by a closed mesh: positive only where faces wind outwards."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    return np.einsum("fi,fi->f", a, np.cross(b, c)).sum() / 6


def open_edges(mesh):
    """Number of triangle edges without a partner of opposite direction (by position)."""
    keys = np.unique(np.round(mesh.vertices, 4) + 0.0, axis=0, return_inverse=True)[1].ravel()
    balance = {}
    for a, b, c in keys[mesh.faces].tolist():
        for start, end in ((a, b), (b, c), (c, a)):
            if start != end:
                edge, sign = ((start, end), 1) if start < end else ((end, start), -1)
                balance[edge] = balance.get(edge, 0) + sign
    return sum(count != 0 for count in balance.values())


def face_normals(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


SOLIDS = {
    "box": (box((1, 2, 3), (0.5, 0.25, 0.125), GREY), 8 * 0.5 * 0.25 * 0.125),
    "tube": (tube([(0, 0, 0), (0, 0, 2)], 0.5, GREY, num_sides=96), np.pi * 0.25 * 2),
    "bent tube": (tube([(0, 0, 0), (0.5, 0, 1), (0.2, 0.3, 2)], 0.1, GREY), None),
    "cone": (tube([(1, 0, 0), (3, 0, 0)], (0.5, 0.001), GREY, num_sides=96), np.pi * 0.25 * 2 / 3),
    "ellipsoid": (
        superellipsoid((1, 1, 1), (1, 2, 0.5), GREY, num_rings=60, num_sides=90),
        4 / 3 * np.pi,
    ),
    "torus": (
        torus((0, 1, 0), 1.0, 0.2, GREY, num_sides=120, num_tube_sides=60),
        2 * np.pi**2 * 0.04,
    ),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_are_watertight_wind_outwards_and_have_their_volume(name):
    mesh, expected = SOLIDS[name]
    assert open_edges(mesh) == 0
    assert volume(mesh) > 0
    if expected is not None:
        assert volume(mesh) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", SOLIDS)
def test_normals_are_unit_vectors_on_the_outer_side_of_their_faces(name):
    mesh, _ = SOLIDS[name]
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
    corner_normals = mesh.normals[mesh.faces]
    agreement = np.einsum("fci,fi->fc", corner_normals, face_normals(mesh))
    assert agreement.min() > 0.2


def test_flat_faces_have_the_normal_of_their_plane():
    mesh = box((0, 0, 0), (1, 2, 3), GREY)
    corner_normals = mesh.normals[mesh.faces]
    agreement = np.einsum("fci,fi->fc", corner_normals, face_normals(mesh))
    assert agreement == pytest.approx(1.0, abs=1e-6)


def test_the_normals_of_a_sphere_point_away_from_its_middle():
    mesh = superellipsoid((0, 0, 0), (1, 1, 1), GREY, num_rings=40, num_sides=60)
    outward = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    used = np.unique(mesh.faces)
    assert np.einsum("vi,vi->v", outward, mesh.normals)[used].min() > 0.99


def test_a_tube_has_sharp_rims():
    mesh = tube([(0, 0, 0), (0, 0, 1)], 0.3, GREY)
    used = mesh.normals[np.unique(mesh.faces)]
    vertical = np.abs(used[:, 2])
    assert ((vertical < 1e-5) | (vertical > 1 - 1e-5)).all()


def test_texture_coordinates_of_a_grid_are_metres_along_rows_and_columns():
    x, y = np.meshgrid([0.0, 0.5, 2.0], [0.0, 3.0, 4.0])
    mesh = grid(np.stack((x, y, 0 * x), axis=-1), GREY)
    assert mesh.uvs == pytest.approx(mesh.vertices[:, :2])
    assert face_normals(mesh) == pytest.approx(np.tile((0, 0, 1.0), (8, 1)))


def test_texture_coordinates_of_a_closed_ring_go_once_around_without_a_jump():
    mesh = tube([(0, 0, 0), (0, 0, 1)], 0.5, GREY, num_sides=64, capped=False)
    spread = np.ptp(mesh.uvs[mesh.faces][:, :, 0], axis=1)
    assert mesh.uvs[:, 0].max() == pytest.approx(np.pi, rel=0.01)
    assert spread.max() < 0.06


def test_texture_coordinates_of_a_box_are_metres():
    mesh = box((5, 5, 5), (1, 2, 3), GREY)
    corners = mesh.vertices[mesh.faces]
    lengths = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    uv_corners = mesh.uvs[mesh.faces]
    assert np.linalg.norm(uv_corners[:, 1] - uv_corners[:, 0], axis=1) == pytest.approx(lengths)


def test_rods_are_tubes_without_caps():
    ends = np.array([(1.0, 0, 0), (0, 0, 2.0)]), np.array([(1.0, 1, 0), (0, 0, 5.0)])
    mesh = rods(*ends, (0.1, 0.3), GREY, num_sides=8)
    second = mesh.vertices[18:]
    assert np.linalg.norm(second[:, :2], axis=1) == pytest.approx(0.3)
    assert (second[:, 2].min(), second[:, 2].max()) == (2, 5)
    agreement = np.einsum("fci,fi->fc", mesh.normals[mesh.faces], face_normals(mesh))
    assert agreement.min() > 0.9


def test_a_disc_and_a_polygon_face_where_they_are_told_to():
    mesh = disc((0, 0, 1), (0, -2, 0), 0.5, GREY, num_sides=48)
    assert face_normals(mesh) == pytest.approx(np.tile((0, -1, 0), (48, 1)), abs=1e-5)
    assert np.linalg.norm(mesh.vertices[:-1] - (0, 0, 1), axis=1) == pytest.approx(0.5)
    square = polygon(np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float), GREY)
    assert square.normals == pytest.approx(np.tile((0, 0, 1), (5, 1)))


def test_quads_and_strips_face_the_side_from_which_they_run_counter_clockwise():
    corners = np.array([[(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1.0)]])
    mesh = quads(corners, GREY)
    assert mesh.normals == pytest.approx(np.tile((0, -1, 0), (4, 1)))
    assert mesh.uvs.max(axis=0).tolist() == [2, 1]


def test_a_lathe_profile_that_runs_to_the_left_has_its_outside_away_from_the_axis():
    mesh = lathe(np.array([(0.5, -1.0), (0.5, 1.0)]), GREY, num_sides=16)
    outward = mesh.vertices * (1, 0, 1)
    assert np.einsum("vi,vi->v", mesh.normals, outward).min() > 0.4


def test_a_capped_loft_is_a_solid():
    angles = np.arange(12) * np.pi / 6
    circle = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)
    rings = np.stack([circle * scale + (0, 0, z) for scale, z in ((1, 0), (2, 1), (0.5, 3))])
    mesh = loft(rings, GREY)
    assert open_edges(mesh) == 0
    assert volume(mesh) > 0


@settings(max_examples=30)
@given(lengths=st.tuples(sizes, sizes, sizes), target=st.tuples(sizes, sizes, sizes))
def test_fitting_fills_the_box_over_the_origin_and_keeps_normals_on_their_faces(lengths, target):
    mesh = fitted(superellipsoid((3, -2, 7), lengths, GREY), target)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert high - low == pytest.approx(np.array(target), rel=1e-4)
    assert low + high == pytest.approx((0, 0, target[2]), abs=1e-4)
    assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)


def test_stretching_moves_knots_to_their_places_and_keeps_normals_on_the_surface():
    knots, places = np.array([-1.0, 0.0, 0.5, 1.0]), np.array([-1.5, 0.0, 1.0, 1.25])
    ball = superellipsoid((0, 0, 0), (1, 1, 1), GREY, num_rings=60, num_sides=90)
    mesh = stretched(ball, knots, places, (2.0, 0.5))
    for knot, place in zip(knots, places, strict=True):
        near = np.abs(ball.vertices[:, 0] - knot) < 0.01
        assert near.any()
        assert np.abs(mesh.vertices[near, 0] - place).max() < 0.021
    assert mesh.vertices[:, 1:] == pytest.approx(ball.vertices[:, 1:] * (2.0, 0.5))
    outward = np.einsum("fci,fi->fc", mesh.normals[mesh.faces], face_normals(mesh))
    assert np.median(outward) > 0.99
    assert outward.min() > 0.3
    beyond = stretched(moved(ball, (3.0, 0, 0)), knots, places, (1.0, 1.0))
    assert beyond.vertices[:, 0] == pytest.approx(ball.vertices[:, 0] + 3.25, abs=1e-5)


def test_both_sides_are_the_parts_and_their_mirror_images():
    part = box((0, 2, 0), (1, 0.5, 1), GREY)
    pair = both_sides(part, moved(part, (4, 0, 0)))
    assert volume(pair) == pytest.approx(4 * volume(part))
    assert pair.vertices[:, 1].min() == -pair.vertices[:, 1].max()


def test_mirroring_keeps_the_outside_outside():
    mesh = superellipsoid((0, 1, 0), (1, 0.5, 0.7), GREY)
    mirror = mirrored(mesh)
    assert volume(mirror) == pytest.approx(volume(mesh), rel=1e-5)
    agreement = np.einsum("fci,fi->fc", mirror.normals[mirror.faces], face_normals(mirror))
    assert agreement.min() > 0.2
    assert mirror.vertices[:, 1].mean() == pytest.approx(-mesh.vertices[:, 1].mean())


def test_turning_and_moving_keep_the_shape():
    mesh = box((0, 0, 0), (1, 2, 3), GREY)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    placed = moved(turned(mesh, quarter), (10, 0, 0))
    assert placed.vertices.max(axis=0) == pytest.approx((12, 1, 3))
    assert volume(placed) == pytest.approx(48, rel=1e-5)


def test_painting_picks_finishes_by_cell_and_by_face():
    x, y = np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0])
    mesh = grid(np.stack((x, y, 0 * x), axis=-1), GREY)
    by_cell = painted(mesh, np.array([[0, 1]]), (GREY, RED))
    assert by_cell.materials.tolist() == [Material.METAL] * 2 + [Material.PLASTIC] * 2
    assert mesh.vertices[mesh.faces[2:]][:, :, 0].min() == 1
    by_face = repainted(mesh, np.array([False, True, False, False]), RED)
    assert by_face.colors[1] == pytest.approx(RED.color)
    assert by_face.materials.tolist().count(Material.PLASTIC) == 1


def test_several_boxes_are_the_boxes_one_by_one():
    centers, halves = np.array([(0, 0, 0), (5, 1, 2.0)]), np.array([(1, 1, 1), (0.5, 2, 1.0)])
    together = boxes(centers, halves, GREY)
    single = box(centers[1], halves[1], GREY)
    assert together.vertices[24:] == pytest.approx(single.vertices)
    assert (together.faces[12:] - 24 == single.faces).all()
