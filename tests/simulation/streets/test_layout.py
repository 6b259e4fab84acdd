"""Layouts, their lines and the ground under them."""

from dataclasses import replace

import numpy as np
import pytest

from sightline.simulation.streets.ground import (
    band_level,
    crown_level,
    ramp_stations,
    surface_level,
)
from sightline.simulation.streets.layout import (
    Parking,
    Plots,
    StreetKind,
    curved_line,
    draw_terrain,
    station_grid,
)
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.streets.lots import (
    bays_of,
    draw_lots,
    footprint_corners,
    footprint_of,
    with_lowered_kerbs,
)

LAYOUTS = [draw_layout(np.random.default_rng([3, seed])) for seed in range(120)]


def test_every_kind_of_street_crossing_and_parking_occurs():
    assert {layout.kind for layout in LAYOUTS} == set(StreetKind)
    crossings = {
        (layout.junction.opens_left, layout.junction.opens_right)
        for layout in LAYOUTS
        if layout.junction
    }
    assert crossings == {(True, True), (True, False), (False, True)}
    assert any(layout.junction is None for layout in LAYOUTS)
    parked = {side.parking for layout in LAYOUTS for side in layout.main.sides}
    assert parked == set(Parking)
    assert {len(layout.main.lanes) for layout in LAYOUTS} >= {1, 2, 3, 4}
    bends = [np.ptp(layout.main.line.yaws) for layout in LAYOUTS]
    assert min(bends) == 0.0
    assert max(bends) > 0.5


@pytest.mark.parametrize("kind", list(StreetKind))
def test_a_kind_that_is_asked_for_is_drawn(kind):
    assert draw_layout(np.random.default_rng(0), kind).kind is kind


def test_the_ego_starts_at_the_origin_on_its_lane_heading_along_x():
    for layout in LAYOUTS:
        line = layout.main.line
        place = line.place(np.array(0.0), np.array(layout.ego_lane.offset))
        np.testing.assert_allclose(place, 0.0, atol=1e-9)
        assert float(line.yaw(np.array(0.0))) == pytest.approx(0.0)
        assert layout.ego_lane.direction == 1


def test_traffic_drives_on_the_right():
    for layout in LAYOUTS:
        for road in layout.roads:
            ahead = [lane.offset for lane in road.lanes if lane.direction > 0]
            back = [lane.offset for lane in road.lanes if lane.direction < 0]
            assert not back or max(ahead) < min(back)


def test_lanes_lie_side_by_side_within_the_carriageway():
    for layout in LAYOUTS:
        for road in layout.roads:
            for right, left in zip(road.lanes[:-1], road.lanes[1:], strict=True):
                gap = (left.offset - left.width / 2) - (right.offset + right.width / 2)
                assert gap == pytest.approx(0.0, abs=1e-9)
            assert road.lanes[-1].offset + road.lanes[-1].width / 2 <= road.left.edge + 1e-9
            assert -road.lanes[0].offset + road.lanes[0].width / 2 <= road.right.edge + 1e-9


def test_a_line_keeps_its_length_and_offsets_keep_their_distance():
    stations = station_grid(-20.0, 80.0)
    line = curved_line(stations, np.full(len(stations), 0.008), 0.0)
    along = np.linspace(-10.0, 70.0, 400)
    middle = line.place(along, np.zeros(400))
    length = np.hypot(*np.diff(middle, axis=0).T).sum()
    assert length == pytest.approx(80.0, abs=0.01)
    # A circle of 125 m radius, whose middle is to the left of the origin.
    assert np.hypot(*(middle - [0.0, 125.0]).T) == pytest.approx(125.0, abs=0.01)
    aside = line.place(along, np.full(400, 5.0))
    assert np.hypot(*(aside - [0.0, 125.0]).T) == pytest.approx(120.0, abs=0.01)


def test_terrain_is_0_at_the_origin_and_flat_enough_for_pieces_of_two_and_a_half_metres():
    heights_at_50_m = []
    for seed in range(60):
        terrain = draw_terrain(np.random.default_rng(seed))
        assert float(terrain.height(np.zeros(2))) == 0.0
        x = np.linspace(-100, 150, 101)
        heights = terrain.height(np.stack((x, np.zeros(101)), axis=1))
        between = terrain.height(np.stack((x[1:] - 1.25, np.zeros(100)), axis=1))
        assert np.abs(between - (heights[1:] + heights[:-1]) / 2).max() < 4e-3
        assert np.abs(np.diff(heights) / 2.5).max() < 0.13
        heights_at_50_m.append(float(terrain.height(np.array([50.0, 0.0]))))
    assert np.std(heights_at_50_m) > 0.3


def test_hard_terrain_is_hillier():
    usual, hard = (
        np.std(
            [
                draw_terrain(np.random.default_rng(seed), hard=hard).height(np.array([50.0, 0.0]))
                for seed in range(200)
            ]
        )
        for hard in (False, True)
    )
    assert hard > 1.5 * usual


def _crossed_layout():
    return next(
        layout for layout in LAYOUTS if layout.junction is not None and layout.main.has_kerbs
    )


def test_the_surface_steps_up_at_the_kerb_and_is_level_in_the_junction():
    layout = _crossed_layout()
    junction = layout.junction
    side = layout.main.left if junction.opens_left else layout.main.right
    outside = side.sign * (side.edge + 0.5)
    inside = side.sign * (side.edge - 0.5)
    assert surface_level(layout.main, np.array(-30.0), np.array(outside)) == side.level
    assert surface_level(layout.main, np.array(-30.0), np.array(inside)) < 0.3 * layout.main.crown_m
    assert surface_level(layout.main, np.array(junction.station), np.array(outside)) == 0.0


def test_the_carriageway_is_highest_in_its_middle_and_flat_where_another_road_crosses():
    layout = _crossed_layout()
    road = layout.main
    across = np.linspace(-road.right.edge, road.left.edge, 41)
    levels = crown_level(road, np.array(-40.0), across)
    assert levels[[0, -1]] == pytest.approx(0.0)
    assert crown_level(road, np.array(-40.0), np.array(0.0)) == road.crown_m
    assert 0.01 < levels.max() <= road.crown_m
    assert not crown_level(road, np.array(layout.junction.station), across).any()


def test_a_kerb_is_lowered_at_a_driveway_and_the_pavement_comes_up_behind_it():
    side = replace(LAYOUTS[0].main.left, level=0.12, edge=4.0, gaps=(), ramps=(20.0,))
    road = replace(LAYOUTS[0].main, left=side)
    along = np.array([10.0, 17.0, 18.5, 20.0, 21.5, 23.0])
    kerb = band_level(road, along, np.array(4.0))
    np.testing.assert_allclose(kerb, [0.12, 0.12, 0.0, 0.0, 0.0, 0.12])
    np.testing.assert_allclose(
        band_level(road, np.array(20.0), np.array([4.0, 4.5, 5.0])), [0, 0.06, 0.12]
    )
    assert set(ramp_stations(side)) == {17.5, 18.3, 21.7, 22.5}


def test_kerbs_are_lowered_at_all_driveways_and_nowhere_else():
    layout = next(layout for layout in LAYOUTS if layout.kind is StreetKind.RESIDENTIAL)
    lots = draw_lots(np.random.default_rng(2), layout)
    lowered = with_lowered_kerbs(layout, lots)
    ramps = [ramp for road in lowered.roads for side in road.sides for ramp in side.ramps]
    assert sorted(ramps) == sorted(lot.driveway for lot in lots if lot.driveway is not None)
    assert ramps


def test_no_building_reaches_into_a_carriageway():
    for seed in range(40):
        rng = np.random.default_rng([4, seed])
        layout = draw_layout(rng)
        for lot in draw_lots(rng, layout):
            footprint = footprint_of(lot)
            if footprint is None:
                continue
            corners = footprint_corners(footprint)
            share = np.linspace(0, 1, 9)[:, None]
            rim = np.concatenate(
                [corners[row] + share * (corners[(row + 1) % 4] - corners[row]) for row in range(4)]
            )
            for road in layout.roads:
                stations = np.arange(road.first, road.last, 0.5)
                line = road.line.place(stations, np.zeros(len(stations)))
                apart = np.linalg.norm(rim[:, None] - line[None], axis=-1).min()
                edges = [lot.side.edge] if road is lot.road else [side.edge for side in road.sides]
                assert apart > min(edges)


def test_places_of_car_parks_lie_apart_and_within_their_lots():
    found = 0
    for seed in range(300):
        rng = np.random.default_rng([6, seed])
        layout = draw_layout(rng)
        for lot in draw_lots(rng, layout):
            if lot.plots is not Plots.CAR_PARK:
                continue
            bays = bays_of(rng, (lot,))
            corners = lot.road.line.place(
                np.array([lot.start, lot.stop, lot.stop, lot.start]),
                lot.side.sign * np.array([lot.side.outer] * 2 + [lot.front] * 2),
            )
            reach = np.ptp(corners, axis=0).max()
            places = np.array([[bay.x, bay.y] for bay in bays]).reshape(-1, 2)
            assert (np.linalg.norm(places - corners.mean(axis=0), axis=1) < reach).all()
            apart = np.linalg.norm(places[:, None] - places, axis=-1)
            apart += 9.0 * np.eye(len(places))
            assert not len(places) or apart.min() > 2.0  # a bend brings the inner ones closer
            found += len(places)
    assert found > 50


def test_a_longer_drive_gets_a_longer_street():
    short = draw_layout(np.random.default_rng(1))
    long = draw_layout(np.random.default_rng(1), extra_length_m=100.0)
    assert long.main.last == short.main.last + 100.0
