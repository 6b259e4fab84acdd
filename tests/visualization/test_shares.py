import numpy as np

from sightline.visualization.shares import ShareSeries, draw_histogram, lay_shares


def bars(picture, color):
    """Pixels in which a series' own colour prevails."""
    return np.abs(picture.astype(int) - np.array(color)).sum(axis=2) < 10


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


def test_a_histograms_bars_stand_where_the_shares_are():
    color = (250, 20, 20)
    series = ShareSeries(name="a", values=np.array([0.9, 0.91]), color=color)
    picture = draw_histogram("title", [series], size=(200, 500))
    columns = np.nonzero(bars(picture, color)[30:170].any(axis=0))[0]
    # of 440 px between the margins, the class from 0.88 to 0.92; the outline runs along the axis
    tall = [column for column in columns if bars(picture, color)[40:140, column].any()]
    assert min(tall) >= 46 + 0.87 * 440
    assert max(tall) <= 46 + 0.93 * 440


def test_an_empty_series_and_several_are_drawn():
    empty = ShareSeries(name="none", values=np.zeros(0), color=(0, 255, 0))
    some = ShareSeries(name="some", values=np.linspace(-0.2, 1.2, 50), color=(0, 0, 255))
    assert draw_histogram("t", [empty, some], size=(120, 300)).shape == (120, 300, 3)
