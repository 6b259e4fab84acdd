import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.simulation.bodies.cars import CARS, UNSEEN_M, VehicleDesign
from sightline.simulation.labels import labelled_ends
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.primitives import Finish, grid
from tests.simulation.small_streets import block

SIZE = (4.0, 1.6, 1.5)


def round_ended(roundness: float) -> Mesh:
    """Upright walls along a superellipse."""
    angles = np.linspace(0, 2 * np.pi, 721)[:-1]
    cos, sin = np.cos(angles), np.sin(angles)
    reach = (np.abs(cos) ** roundness + np.abs(sin) ** roundness) ** (-1 / roundness)
    x, y = SIZE[0] / 2 * reach * cos, SIZE[1] / 2 * reach * sin
    rows = [np.stack((x, y, np.full_like(x, z)), axis=1) for z in (0.2, 1.3)]
    return grid(np.array(rows, np.float64), Finish(Material.CAR_PAINT, (0.5,) * 3), closed=True)


def last_struck(mesh: Mesh, angle: float) -> float:
    """x [m] of the last contact of level rays, straight ahead and turned left by an angle [rad]."""
    way = np.array((np.cos(angle), np.sin(angle), 0.0))
    to_near_flank = np.sign(angle) * np.array((way[1], -way[0], 0.0))
    origins = np.array((0.0, 0.0, 0.6)) - 10.0 * way
    origins = origins + np.linspace(0.0, 3.0, 4001)[:, None] * to_near_flank
    rays = np.tile(way, (len(origins), 1))
    hits = Raycaster(mesh).cast(origins.astype(np.float32), rays.astype(np.float32))
    last = np.flatnonzero(hits.faces >= 0)[-1]
    return float(origins[last, 0] + hits.distances[last] * way[0])


@given(
    roundness=st.floats(3.0, 9.0),
    degrees=st.floats(-80.0, 80.0).filter(lambda angle: abs(angle) > 47.0),
)
def test_a_round_end_is_where_the_last_ray_strikes_from_25_degrees_flatter(roundness, degrees):
    mesh = round_ended(roundness)
    angle, flatter = np.radians((degrees, degrees - np.copysign(25.0, degrees)))
    last = last_struck(mesh, flatter)
    behind = -4000.0 * np.array((np.cos(angle), np.sin(angle)))
    assert labelled_ends(mesh.vertices, SIZE, behind) == pytest.approx((-2.0, last), abs=0.06)
    assert labelled_ends(mesh.vertices, SIZE, -behind) == pytest.approx((-last, 2.0), abs=0.06)


@given(x=st.floats(-40.0, 40.0), y=st.floats(-40.0, 40.0))
def test_a_box_ends_where_it_ends(x, y):
    mesh = block((0.0, 0.0, 0.75), (2.0, 0.8, 0.75))
    assert labelled_ends(mesh.vertices, SIZE, np.array((x, y))) == pytest.approx((-2.0, 2.0))


def test_from_behind_an_end_is_where_it_was_in_the_best_view_of_the_drive():
    mesh = round_ended(5.0)
    one, other = (
        labelled_ends(mesh.vertices, SIZE, np.array(place))
        for place in ((-20.0, 0.0), (-30.0, 4.0))
    )
    assert one == other
    assert 1.6 < one[1] < 1.8


def test_from_the_side_both_ends_are_seen():
    ends = labelled_ends(round_ended(5.0).vertices, SIZE, np.array((0.0, 20.0)))
    assert ends == pytest.approx((-2.0, 2.0), abs=0.07)


def test_what_stands_out_above_or_beyond_the_far_end_does_not_count():
    mesh = round_ended(5.0)
    mirror = block((0.5, 0.9, 1.0), (0.05, 0.15, 0.05))
    bar = block((2.05, 0.0, 0.4), (0.1, 0.05, 0.05))
    for place in ((-20.0, 3.0), (0.0, 20.0), (-20.0, -3.0)):
        bare = labelled_ends(mesh.vertices, SIZE, np.array(place))
        full = Mesh.joined([mesh, mirror, bar])
        ends = labelled_ends(full.vertices, SIZE, np.array(place))
        assert ends == pytest.approx(bare, abs=0.02)


def test_labels_leave_out_of_cars_as_much_as_bodies_are_longer_than_kittis_labels():
    left_out = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        car = VehicleDesign(rng, CARS).model(rng)
        place = np.array((rng.choice((-1, 1)) * rng.uniform(8.0, 40.0), rng.uniform(-6.0, 6.0)))
        rear, front = labelled_ends(car.shape.at(0.0).vertices, car.size_lwh, place)
        left_out.append(car.size_lwh[0] - (front - rear))
    assert np.mean(left_out) == pytest.approx(UNSEEN_M, abs=0.08)
    assert min(left_out) > 0.05
