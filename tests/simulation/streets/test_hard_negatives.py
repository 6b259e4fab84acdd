"""Streets with many hard negatives, and their road users."""

import numpy as np
import pytest

from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.street import make_street
from sightline.simulation.streets.dressing import dress, set_out_hard_negatives
from sightline.simulation.streets.free_ground import Occupancy, StreetObjects
from sightline.simulation.streets.layout import StreetKind
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.surroundings.furniture import _TABLES, Item, item_footprint
from tests.simulation.shapes.mesh_checks import assert_sound

KINDS = list(StreetKind)


@pytest.mark.parametrize("kind", KINDS)
def test_a_street_gets_more_things_and_its_traffic_stays(kind: StreetKind):
    usual, full = (
        make_street(np.random.default_rng([4, KINDS.index(kind)]), kind=kind, hard_negatives=given)
        for given in (False, True)
    )
    assert [actor.box_lwh for actor in full.actors] == [actor.box_lwh for actor in usual.actors]
    assert full.snapshot().poses == usual.snapshot().poses
    more = len(full.ground_and_buildings.faces) - len(usual.ground_and_buildings.faces)
    assert more > 500
    assert_sound(full.ground_and_buildings)


def test_nobody_meets_a_thing_along_a_drive():
    for seed in range(3):
        street = make_street(
            np.random.default_rng([6, seed]),
            duration_s=3.0,
            kind=StreetKind.AVENUE,
            hard_negatives=True,
        )
        caster = Raycaster(street.ground_and_buildings)
        for time_s in (0.0, 1.5, 3.0):
            pose = street.ego.at(time_s)
            yaw = np.array([pose.yaw], np.float32)
            way = np.stack((np.cos(yaw), np.sin(yaw), np.zeros(1)), axis=1).astype(np.float32)
            start = np.array([[pose.x, pose.y, pose.z + 0.7]], np.float32)
            assert caster.cast(start, way).distances[0] > 2.3
            assert caster.cast(start, -way).distances[0] > 2.3


def test_nothing_is_set_out_on_ground_that_is_taken():
    layout = draw_layout(np.random.default_rng(2), StreetKind.CITY)
    blocked = Occupancy(3)
    blocked.take(np.zeros((3, 4)), 1000.0, 1000.0)
    none = dress(np.random.default_rng(2), layout, blocked, hard_negatives=True)
    assert sum(len(part.faces) for part in none) == 0


@pytest.fixture(scope="module")
def set_out():
    """Objects of 60 streets without traffic: item, road, station, offset, reach."""
    stood = []

    class Recorder(StreetObjects):
        def put(self, item, road, stations, offset, level, turn, *, scale):
            kept = super().put(item, road, stations, offset, level, turn, scale=scale)
            reach = scale[0] * float(np.hypot(*item_footprint(item))) / 2
            stood.extend((item, road, float(station), offset, reach) for station in kept)
            return kept

    for seed in range(60):
        rng = np.random.default_rng(seed)
        layout = draw_layout(rng)
        set_out_hard_negatives(rng, layout, Recorder(rng, layout, Occupancy(1)), [])
    return stood


def test_all_kinds_of_decoys_stand_somewhere(set_out):
    decoys = {*_TABLES["decoys"], "STAKED_TREE"}
    assert decoys <= {item.name for item, *_ in set_out}


def test_lanes_are_free_but_for_beacons_and_what_parts_them(set_out):
    for item, road, _, offset, reach in set_out:
        side = road.left if offset > 0 else road.right
        if item in (Item.BEACON, Item.LIT_BEACON):
            continue
        if abs(offset) < side.lane_edge:
            assert not any(abs(lane.offset - offset) < lane.width / 2 - 1e-6 for lane in road.lanes)
        else:
            assert abs(offset) - reach >= side.lane_edge - 1e-6


def test_nothing_stands_in_the_opening_of_a_crossing_road(set_out):
    between = 0
    for _, road, station, offset, _ in set_out:
        is_between = abs(offset) < min(road.left.lane_edge, road.right.lane_edge) - 0.6
        side = road.left if offset > 0 else road.right
        gaps = road.left.gaps + road.right.gaps if is_between else side.gaps
        assert not any(start < station < stop for start, stop in gaps)
        between += is_between
    assert between > 10
