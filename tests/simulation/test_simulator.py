from dataclasses import replace

import numpy as np

from sightline.simulation.scene import Street
from sightline.simulation.simulator import simulate_street
from tests.simulation.data_sets import TINY
from tests.simulation.small_streets import make_tiny_street


def test_other_makers_of_streets_are_asked_for_special_ones_only_where_that_is_set():
    calls = []

    def maker(rng: np.random.Generator, **arguments: object) -> Street:
        calls.append(arguments)
        return make_tiny_street(rng, duration_s=0.0)

    simulate_street(TINY, 0, maker)
    simulate_street(replace(TINY, hard=True), 0, maker)
    simulate_street(replace(TINY, hard_negatives=True), 0, maker)
    assert calls == [
        {"duration_s": 0.0},
        {"duration_s": 0.0, "hard": True},
        {"duration_s": 0.0, "hard_negatives": True},
    ]
