"""Closed walls of buildings, from all directions."""

import numpy as np
import pytest

from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.shapes.edits import QuadBatch
from sightline.simulation.surroundings.buildings import draw_look
from sightline.simulation.surroundings.facades import Facade, Front, build_front

LENGTH, STOREYS, STOREY, PLINTH = 14.0, 3, 3.0, 0.4
DEEPEST_RECESS_M = 0.2  # that `draw_look` draws


def front(**options):
    return Front(
        start=(0.0, 0.0),
        yaw=0.0,
        ground=0.0,
        length=LENGTH,
        plinth=PLINTH,
        storeys=STOREYS,
        storey_height=STOREY,
        foundation=1.0,
        **options,
    )


def hit_depths(rng, wall):
    """y of the hits, into the building, of rays that would cross the wall at y = 0."""
    batch = QuadBatch()
    build_front(rng, batch, wall, draw_look(rng, 0.3))
    count = 3000
    angle, side = rng.uniform(np.deg2rad(3), np.deg2rad(89), count), rng.choice((1, -1), count)
    rise = rng.uniform(-0.3, 0.3, count)
    directions = np.column_stack((side * np.cos(angle), np.sin(angle), rise * np.sin(angle)))
    # Rays along the wall cross it well before its ends, where nothing stands behind it.
    across = rng.uniform(LENGTH / 2 - 2, LENGTH / 2 + 2, count)
    up = rng.uniform(0.1, PLINTH + STOREYS * STOREY - 0.5, count)
    targets = np.column_stack((across, np.zeros(count), up))
    origins = targets - 30.0 * directions
    hits = Raycaster(batch.mesh()).cast(origins.astype(np.float32), directions.astype(np.float32))
    assert (hits.faces >= 0).all()
    return origins[:, 1] + hits.distances * directions[:, 1]


@pytest.mark.parametrize("facade", list(Facade))
@pytest.mark.parametrize("is_far", [False, True])
@pytest.mark.parametrize("has_shop", [False, True])
def test_no_ray_gets_past_panes_into_a_building(facade, is_far, has_shop):
    rng = np.random.default_rng(4)
    for _ in range(4):
        wall = front(facade=facade, is_far=is_far, has_shop=has_shop)
        assert hit_depths(rng, wall).max() < (0.0 if is_far else DEEPEST_RECESS_M) + 0.001
