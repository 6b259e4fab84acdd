"""Layouts, their lines and the ground under them."""

import numpy as np
import pytest

from sightline.simulation.layout import Parking, StreetKind, surface_level
from sightline.simulation.layout_drawing import draw_layout
from sightline.simulation.layout_line import curved_line, draw_terrain, station_grid
from sightline.simulation.lots import draw_lots, footprint_corners, footprint_of

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


def test_terrain_is_level_at_the_origin_and_flat_enough_for_pieces_of_two_metres():
    for seed in range(20):
        terrain = draw_terrain(np.random.default_rng(seed))
        assert float(terrain.height(np.zeros(2))) == 0.0
        step = 1e-3
        for axis in np.eye(2):
            rise = terrain.height(step * axis) - terrain.height(-step * axis)
            assert abs(float(rise)) / (2 * step) < 1e-5
        x = np.linspace(-100, 150, 126)
        heights = terrain.height(np.stack((x, np.zeros(126)), axis=1))
        between = terrain.height(np.stack((x[1:] - 1, np.zeros(125)), axis=1))
        assert np.abs(between - (heights[1:] + heights[:-1]) / 2).max() < 1e-3
        assert np.abs(np.diff(heights) / 2).max() < 0.04


def test_the_surface_steps_up_at_the_kerb_and_is_level_in_the_junction():
    layout = next(
        layout for layout in LAYOUTS if layout.junction is not None and layout.main.has_kerbs
    )
    junction = layout.junction
    side = layout.main.left if junction.opens_left else layout.main.right
    outside = side.sign * (side.edge + 0.5)
    assert surface_level(layout.main, -30.0, 0.0) == 0.0
    assert surface_level(layout.main, -30.0, outside) == side.level
    assert surface_level(layout.main, junction.station, outside) == 0.0


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
                assert apart > max(lane.width / 2 + abs(lane.offset) for lane in road.lanes)


def test_a_longer_drive_gets_a_longer_street():
    short = draw_layout(np.random.default_rng(1))
    long = draw_layout(np.random.default_rng(1), extra_length_m=100.0)
    assert long.main.last == short.main.last + 100.0
