import numpy as np

from sightline.visualization.shares import ShareSeries, draw_histogram, lay_shares


def is_red(picture):
    return (picture[..., 0] > 120) & (picture[..., 1] < 60)


def test_what_is_open_is_brighter_than_what_is_closed_on_any_picture():
    shares = np.array([[0.0, 1.0]], dtype=np.float32)
    for grey in (0, 90, 255):
        laid = lay_shares(np.full((20, 40, 3), grey, np.uint8), shares).astype(int)
        assert laid.shape == (20, 40, 3)
        closed, opened = laid[:, :8].mean(axis=(0, 1)), laid[:, -8:].mean(axis=(0, 1))
        assert opened.sum() > closed.sum() + 60
        assert closed[2] > closed[1]  # violet
        assert opened[1] > 2 * opened[2]  # yellow


def test_the_picture_shows_through_and_stays_as_it_is():
    picture = np.zeros((20, 40, 3), np.uint8)
    picture[:, 20:] = 255
    before = picture.copy()
    laid = lay_shares(picture, np.full((2, 2), 0.5, np.float32))
    assert (laid[:, 25:] > laid[:, :15].max()).any(axis=2).all()
    np.testing.assert_array_equal(picture, before)


def test_shares_beyond_the_ends_take_the_ends_colours():
    picture = np.full((4, 4, 3), 100, np.uint8)
    for beyond, end in ((-3.0, 0.0), (7.0, 1.0)):
        np.testing.assert_array_equal(
            lay_shares(picture, np.full((1, 1), beyond)), lay_shares(picture, np.full((1, 1), end))
        )


def test_a_histograms_bars_stand_where_the_shares_are_and_as_high():
    values = np.array([0.9, 0.91, 0.9, 0.3])
    series = ShareSeries(name="", values=values, color=(250, 20, 20))
    picture = draw_histogram("title", [series], size=(200, 500))
    # 440 x 152 px between the margins: a quarter in one class, three in another
    for share, low, high in ((0.2, 0.28, 0.32), (0.5, 0.88, 0.92)):
        columns = is_red(picture)[round(178 - share * 152)].nonzero()[0]
        near = columns[abs(columns - (46 + 0.5 * (low + high) * 440)) < 40]
        assert abs(near.min() - (46 + low * 440)) <= 2
        assert abs(near.max() - (46 + high * 440)) <= 2
    assert not is_red(picture)[30 : 178 - round(0.77 * 152)].any()
    assert not is_red(picture)[: 178 - round(0.27 * 152), : 46 + 200].any()


def test_an_empty_series_and_several_are_drawn():
    empty = ShareSeries(name="none", values=np.zeros(0), color=(0, 255, 0))
    some = ShareSeries(name="some", values=np.linspace(-0.2, 1.2, 50), color=(0, 0, 255))
    assert draw_histogram("t", [empty, some], size=(120, 300)).shape == (120, 300, 3)
