"""Motions: wheeled vehicles tilt with the ground, a body on springs leans."""

from dataclasses import replace

import numpy as np
import pytest

from sightline.simulation.scene import Pose, world_from_footprint
from sightline.simulation.streets.ground import surface_height
from sightline.simulation.streets.layout import Terrain, straight_line
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.traffic.motion import (
    STANDING,
    AlongRoad,
    Rocking,
    Still,
    Travel,
    draw_rocking,
    on_wheels,
)

# Rises by 0.1 per metre along x and by 0.05 along y for as far as the tests look.
SLOPE = Terrain(
    wave_vectors=np.array([[1e-5, 0.0], [0.0, 1e-5]]),
    phases=np.zeros(2),
    amplitudes=np.array([0.1e5, 0.05e5]),
)


def _flat_road(yaw=0.0):
    road = draw_layout(np.random.default_rng(0)).main
    return replace(road, line=straight_line(np.zeros(2), yaw, -80.0, 80.0), crown_m=0.0)


def _track(**changes):
    track = AlongRoad(
        terrain=SLOPE, road=_flat_road(), station=5.0, offset=0.0, direction=1, travel=STANDING
    )
    return replace(track, **changes)


def test_without_wheels_one_stands_upright_on_a_slope():
    pose = _track().at(0.0)
    assert (pose.pitch, pose.roll) == (0.0, 0.0)
    assert pose.z == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("direction", "turn", "pitch", "roll"),
    [
        (1, 0.0, -0.1, 0.05),
        (-1, 0.0, 0.1, -0.05),
        (1, np.pi / 2, -0.05, -0.1),
    ],
)
def test_a_vehicle_tilts_with_the_ground_under_its_wheels(direction, turn, pitch, roll):
    pose = _track(direction=direction, turn=turn, wheels_lw=(2.6, 1.5)).at(0.0)
    assert np.tan(pose.pitch) == pytest.approx(pitch, abs=1e-6)
    assert np.tan(pose.roll) == pytest.approx(roll, abs=1e-6)
    assert pose.z == pytest.approx(0.5, abs=1e-6)


def test_a_bicycle_tilts_along_but_not_across():
    pose = _track(wheels_lw=(1.0, 0.0)).at(0.0)
    assert np.tan(pose.pitch) == pytest.approx(-0.1, abs=1e-6)
    assert pose.roll == 0.0


def test_the_wheels_of_a_tilted_vehicle_are_on_the_ground():
    layout = draw_layout(np.random.default_rng(7))
    track = AlongRoad(
        terrain=layout.terrain, road=layout.main, station=3.0, offset=layout.ego_lane.offset,
        direction=1, travel=Travel(speed_mps=9.0), wheels_lw=(2.6, 1.5),
    )  # fmt: skip
    for time_s in (0.0, 1.0, 2.5):
        world_from_vehicle = world_from_footprint(track.at(time_s), 0.0)
        for ahead in (-1.3, 1.3):
            for aside in (-0.75, 0.75):
                wheel = world_from_vehicle @ np.array([ahead, aside, 0.0, 1.0])
                station, offset = _nearest(layout.main.line, wheel[:2])
                ground = surface_height(layout.terrain, layout.main, station, offset)
                assert wheel[2] == pytest.approx(float(ground[0]), abs=0.02)


def _nearest(line, place):
    """Station and offset of a place, by a search along the line."""
    stations = np.arange(-20.0, 60.0, 0.01)
    points = line.place(stations, np.zeros(len(stations)))
    row = int(np.argmin(np.hypot(*(points - place).T)))
    yaw = float(line.yaw(stations[row : row + 1])[0])
    away = place - points[row]
    return stations[row : row + 1], np.array([away[1] * np.cos(yaw) - away[0] * np.sin(yaw)])


def test_what_stands_still_off_the_road_tilts_with_the_terrain():
    place = np.array([2.0, 3.0])
    height = float(SLOPE.height(place)) + 0.12
    still = Still(pose=Pose(x=2.0, y=3.0, z=height, yaw=np.pi / 2))
    pose = on_wheels(still, SLOPE, (2.6, 1.5)).at(0.0)
    assert (pose.x, pose.y, pose.yaw) == (2.0, 3.0, pytest.approx(np.pi / 2))
    assert pose.z == pytest.approx(height, abs=1e-6)
    assert np.tan(pose.pitch) == pytest.approx(-0.05, abs=1e-6)
    assert np.tan(pose.roll) == pytest.approx(-0.1, abs=1e-6)


def test_a_body_on_springs_swings_around_its_lean_and_stays_where_its_wheels_are():
    rocking = Rocking(
        track=_track(), lean=(0.01, -0.02), swing=(0.003, 0.002), period_s=(1.0, 2.0),
        phases=(0.0, 0.0),
    )  # fmt: skip
    poses = [rocking.at(time) for time in np.linspace(0.0, 4.0, 401)]
    pitches, rolls = (np.array([getattr(p, name) for p in poses]) for name in ("pitch", "roll"))
    assert (pitches.min(), pitches.max()) == pytest.approx((0.007, 0.013), abs=1e-6)
    assert (rolls.min(), rolls.max()) == pytest.approx((-0.022, -0.018), abs=1e-6)
    assert {(p.x, p.y, p.z) for p in poses} == {(poses[0].x, poses[0].y, poses[0].z)}


def test_most_egos_lean_by_less_than_a_degree_and_a_few_by_more():
    still = Still(pose=Pose(x=0.0, y=0.0, z=0.0, yaw=0.0))
    drawn = [draw_rocking(np.random.default_rng(seed), still).at(0.0) for seed in range(400)]
    pitches = np.degrees([abs(pose.pitch) for pose in drawn])
    assert 0.05 < np.median(pitches) < 0.4
    assert 0.005 < np.mean(pitches > 1.0) < 0.15
