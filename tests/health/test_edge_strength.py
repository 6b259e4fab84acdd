import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from sightline.health.edge_strength import edge_strength
from tests.reference import health as reference

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (97, 130, 3), dtype=np.uint8)


@pytest.mark.parametrize("gradient", ["horizontal", "vertical"])
def test_it_is_what_the_reference_says(gradient):
    grey = cv2.cvtColor(IMAGE, cv2.COLOR_RGB2GRAY)
    expected = reference.edge_strength(grey, axis=1 if gradient == "horizontal" else 0)
    assert_allclose(edge_strength(IMAGE, gradient), expected, atol=0.01)


def test_either_direction_is_the_other_of_the_image_on_its_side():
    on_its_side = np.ascontiguousarray(IMAGE.swapaxes(0, 1))
    assert_allclose(
        edge_strength(IMAGE, "vertical").T, edge_strength(on_its_side, "horizontal"), atol=1e-4
    )


def test_an_edge_is_seen_across_it_alone():
    image = np.zeros((60, 120, 3), np.uint8)
    image[:, 60:] = 40
    assert edge_strength(image, "vertical").max() == 0
    strength = edge_strength(image, "horizontal")
    assert set(strength.argmax(axis=1)) <= {59, 60}


def test_a_faint_edge_far_from_others_counts_for_more_than_its_share():
    image = np.zeros((90, 400, 3), np.uint8)
    image[:, 100:] = 10
    image[:, 300:] = 250  # 24 times as strong
    strength = edge_strength(image, "horizontal")[45]
    assert strength[100] > 0.3 * strength[300]
