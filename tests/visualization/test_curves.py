import numpy as np
import pytest

from sightline.visualization.colors import CURVE_COLORS
from sightline.visualization.curves import Curve, _labels, _round_up, draw_curves


def curve(name, values):
    return Curve(name=name, steps=np.arange(len(values)), values=np.asarray(values, np.float64))


def rows_of(picture, color):
    return np.flatnonzero((np.abs(picture.astype(int) - color).max(axis=2) <= 12).any(axis=1))


def test_higher_values_stand_higher_and_each_curve_has_its_colour():
    picture = draw_curves("Loss", [curve("a", [4.0] * 9), curve("b", [1.0] * 9)])
    high, low = (rows_of(picture[:340], color) for color in CURVE_COLORS[:2])
    assert len(high) > 0
    assert high.max() < low.min()


def test_many_values_are_smoothed_and_few_are_dots():
    noisy = np.tile([0.0, 10.0], 400)
    picture = draw_curves("Loss", [curve("a", noisy)], highest=10.0)
    strong = rows_of(picture[:340], CURVE_COLORS[0])
    assert np.ptp(strong) < 20  # the mean, 5, alone is strong


def test_an_empty_chart_says_so_and_too_many_curves_are_refused():
    empty = draw_curves("Loss", [])
    assert empty.shape == draw_curves("Loss", [curve("a", [1.0, 2.0])]).shape
    assert np.array_equal(empty, draw_curves("Loss", [curve("a", [])]))
    with pytest.raises(ValueError, match="shows up to 4 curves, got 5; draw several charts"):
        draw_curves("Loss", [curve("a", [1.0])] * 5)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.0, 1.0), (0.9, 1.0), (1.1, 2.0), (2.2, 2.5), (30.0, 50.0), (51.0, 100.0)],
)
def test_the_upper_end_is_a_round_number(value, expected):
    assert _round_up(value) == pytest.approx(expected)


def test_grid_lines_are_at_round_numbers_up_to_the_end():
    assert _labels(100.0) == [(share / 5, f"{20 * share}") for share in range(6)]
    assert [text for _, text in _labels(7875.0)] == ["0", "2,000", "4,000", "6,000"]
