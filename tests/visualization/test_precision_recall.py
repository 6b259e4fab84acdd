from dataclasses import replace

import numpy as np
import pytest

from sightline.structures.score_curves import PrecisionRecall
from sightline.visualization.precision_recall import draw_precision_recall

EASY, MODERATE = (86, 180, 233), (240, 150, 20)


def curve(precision, reached):
    slots = np.zeros(41)
    slots[:reached] = precision
    recall = np.arange(reached) / 40
    return PrecisionRecall(
        recall=recall,
        precision=np.full(reached, precision),
        slots=slots,
        ap_r40=100 * float(slots[1:].mean()),
        ap_r11=100 * float(slots[::4].mean()),
        num_objects=40,
    )


def rows_and_columns(picture, color):
    """Positions of the pixels of a colour above the legend."""
    return np.nonzero((picture[:360] == color).all(axis=-1))


def test_a_curve_lies_as_high_as_its_precision_and_ends_where_its_slots_do():
    low, high = (draw_precision_recall("Car, 3d", {"easy": curve(p, 41)}) for p in (0.25, 0.75))
    rows = [np.median(rows_and_columns(each, EASY)[0]) for each in (low, high)]
    assert rows[0] - rows[1] == pytest.approx((368 - 44) / 2, abs=2)
    short = draw_precision_recall("Car, 3d", {"easy": curve(0.75, 21)})
    ends = [rows_and_columns(each, EASY)[1].max() - 64 for each in (short, high)]
    assert ends[0] == pytest.approx(ends[1] / 2, abs=5)


def test_all_curves_are_drawn_and_listed_below():
    one = draw_precision_recall("Car, 3d", {"easy": curve(0.75, 41)})
    both = draw_precision_recall("Car, 3d", {"easy": curve(0.75, 41), "moderate": curve(0.5, 41)})
    assert both.shape[0] > one.shape[0]
    for color in (EASY, MODERATE):
        assert (both[:360] == color).all(axis=-1).any()
        assert (both[400:] == color).all(axis=-1).any()


def test_what_was_measured_is_drawn_beyond_the_slots():
    slots_only = curve(0.5, 4)
    measured = replace(slots_only, recall=np.array([0.25, 0.5, 0.75, 1.0]))
    pictures = [draw_precision_recall("", {"easy": each}) for each in (slots_only, measured)]
    differs = np.nonzero((pictures[0] != pictures[1]).any(axis=(0, 2)))[0]
    assert differs.min() < 64 + 672 * 0.3
    assert differs.max() == pytest.approx(64 + 672, abs=2)


@pytest.mark.parametrize("reached", [0, 1])
def test_a_curve_of_a_point_or_none_is_drawn(reached):
    assert draw_precision_recall("", {"easy": curve(1.0, reached)}).std() > 0


def test_more_curves_than_colours_are_refused():
    curves = {str(number): curve(0.5, 41) for number in range(5)}
    with pytest.raises(ValueError, match="up to 4 curves, got 5"):
        draw_precision_recall("Car, 3d", curves)
