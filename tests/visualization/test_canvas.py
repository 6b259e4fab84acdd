import numpy as np

from sightline.visualization import canvas


def test_points_drawn_some_at_a_time_cover_each_other_as_when_drawn_at_once(monkeypatch):
    rng = np.random.default_rng(0)
    pixels = rng.uniform(-3, 33, (200, 2))
    colors = rng.integers(0, 256, (200, 3), dtype=np.uint8)
    pictures = []
    for at_a_time in (1000, 7):
        monkeypatch.setattr(canvas, "_POINTS_PER_BATCH", at_a_time)
        picture = np.full((30, 30, 3), 40, np.uint8)
        canvas.put_points(picture, pixels, colors, diameter_px=3.0)
        pictures.append(picture)
    assert np.array_equal(*pictures)
    assert (pictures[0] != 40).any()


def test_dashes_are_as_long_as_their_gaps_and_reach_both_ends():
    segment = np.array([[[2.0, 5.0], [52.0, 5.0]]])
    row = np.zeros((11, 60, 3), np.uint8)
    canvas.put_lines(row, segment, (255, 255, 255), dash_px=10.0)
    inked = (row[5, :, 0] > 127).tolist()
    assert [column for column in (3, 13, 17, 20, 23, 30, 33, 40, 43, 51) if inked[column]] == [
        *(3, 23, 30),
        *(43, 51),
    ]


def test_a_segment_shorter_than_a_dash_is_whole_and_none_are_none():
    drawn = []
    for dash_px in (None, 10.0):
        row = np.zeros((11, 60, 3), np.uint8)
        canvas.put_lines(
            row, np.array([[[2.0, 5.0], [9.0, 6.0]]]), (255, 255, 255), dash_px=dash_px
        )
        canvas.put_lines(row, np.zeros((0, 2, 2)), (255, 255, 255), dash_px=dash_px)
        drawn.append(row)
    assert np.array_equal(*drawn)
