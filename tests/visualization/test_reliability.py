import numpy as np

from sightline.structures.score_curves import Reliability
from sightline.visualization.reliability import draw_reliability, draw_reliability_sheet


def reliability(targets):
    counts = np.array([3, 0, 100, 7])
    scores = np.array([0.1, np.nan, 0.6, 0.9])
    return Reliability(counts=counts, mean_score=scores, mean_target=np.array(targets))


def test_bars_grow_with_the_mean_target():
    low = draw_reliability("low", reliability([0.0, np.nan, 0.2, 0.3]))
    high = draw_reliability("high", reliability([0.1, np.nan, 0.8, 0.9]))
    blue = [int((p[..., 2].astype(int) - p[..., 0] > 60).sum()) for p in (low, high)]
    assert blue[1] > 2 * blue[0] > 0


def test_a_sheet_has_all_diagrams():
    each = reliability([0.1, np.nan, 0.8, 0.9])
    one = draw_reliability("one", each)
    sheet = draw_reliability_sheet([[("one", each), ("two", each)]] * 3)
    assert sheet.shape == (3 * one.shape[0], 2 * one.shape[1], 3)
    assert np.array_equal(sheet[: one.shape[0], : one.shape[1]], one)


def test_an_empty_diagram_is_drawn():
    empty = Reliability(
        counts=np.zeros(2, np.int64), mean_score=np.full(2, np.nan), mean_target=np.full(2, np.nan)
    )
    assert draw_reliability("none", empty).std() > 0
