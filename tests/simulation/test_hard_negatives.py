"""Streets full of what is easily taken for people and cars, and their people and cars."""

import numpy as np
import pytest

from sightline.simulation.dressing import dress
from sightline.simulation.hard_negatives import set_out_hard_negatives
from sightline.simulation.layout import StreetKind
from sightline.simulation.layout_drawing import draw_layout
from sightline.simulation.meshes.look_alikes import LOOK_ALIKES
from sightline.simulation.occupancy import Occupancy
from sightline.simulation.raycast import Raycaster
from sightline.simulation.setting_out import Things
from sightline.simulation.street import make_street
from tests.simulation.mesh_checks import assert_sound

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


def test_all_kinds_of_look_alikes_stand_somewhere(monkeypatch):
    seen = set()

    def record(self, item, *others, **named):
        seen.add(item.value)
        return put(self, item, *others, **named)

    put = Things.put
    monkeypatch.setattr(Things, "put", record)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        layout = draw_layout(rng)
        set_out_hard_negatives(rng, layout, Things(rng, layout, Occupancy(1)), [])
    assert set(LOOK_ALIKES) <= seen
