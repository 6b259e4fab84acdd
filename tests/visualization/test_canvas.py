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
