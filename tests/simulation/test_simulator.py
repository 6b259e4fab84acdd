from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sightline.data.formats.kitti_calibration import check_matrices
from sightline.simulation.scene import Street
from sightline.simulation.settings import KITTI_FOCAL_PX, SimulationConfig
from sightline.simulation.simulator import calibration_of, simulate_street
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


@pytest.mark.parametrize("focal_px", [180.0, KITTI_FOCAL_PX, 1100.0, 2000.0])
@pytest.mark.parametrize(
    "size",
    [(375, 1242), (192, 640), (1080, 1920), (720, 1280), (480, 640), (640, 480), (2160, 3840)],
)
def test_the_calibration_of_any_usual_image_is_not_doubted(size, focal_px):
    matrices = calibration_of(SimulationConfig(image_size=size, focal_px=focal_px))
    assert check_matrices(matrices, size, Path("calib.txt")) == []
