"""Videos, read frame by frame by OpenCV."""

import cv2
import numpy as np
import pytest

from sightline.visualization import video
from sightline.visualization.video import write_video


def pictures(count, size=(64, 96)):
    """Pictures of a bright bar that moves to the right."""
    for number in range(count):
        picture = np.full((*size, 3), (40, 60, 90), np.uint8)
        picture[:, 8 * number : 8 * number + 16] = (250, 180, 20)
        yield picture


def read(path):
    reader = cv2.VideoCapture(str(path))
    codec = int(reader.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode()
    frames = []
    while (got := reader.read())[0]:
        frames.append(cv2.cvtColor(got[1], cv2.COLOR_BGR2RGB))
    return codec, reader.get(cv2.CAP_PROP_FPS), frames


def assert_shows(frames, expected):
    assert len(frames) == len(expected)
    for frame, picture in zip(frames, expected, strict=True):
        assert frame.shape == picture.shape
        assert np.abs(frame.astype(int) - picture).mean() < 6


def test_every_frame_can_be_read_back_and_browsers_know_the_codec(tmp_path):
    pytest.importorskip("av")
    path = tmp_path / "bar.mp4"
    assert write_video(path, pictures(9), fps=12.5) == 9
    codec, fps, frames = read(path)
    assert (codec, fps) == ("h264", 12.5)
    assert_shows(frames, list(pictures(9)))
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # plays before all of it is there


def test_without_pyav_it_is_mpeg4_and_a_warning_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(video, "find_spec", lambda _: None)
    path = tmp_path / "bar.mp4"
    with pytest.warns(UserWarning, match=r"browsers do not play; for H.264: pip install"):
        write_video(path, pictures(5), fps=10.0)
    codec, _, frames = read(path)
    assert codec == "FMP4"
    assert_shows(frames, list(pictures(5)))


def test_a_video_that_is_broken_off_leaves_nothing(tmp_path):
    def breaking():
        yield from pictures(3)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / "bar.mp4", breaking(), fps=10.0)
    assert list(tmp_path.iterdir()) == []


def mixed():
    yield from pictures(1)
    yield from pictures(1, (64, 98))


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (pictures(0), "there are no frames"),
        (pictures(1, (63, 96)), r"frames of 96x63 px .*expected even numbers; pad or crop them"),
        (mixed(), "a frame of 98x64 px follows one of 96x64"),
    ],
)
def test_pictures_that_make_no_video_are_refused(tmp_path, frames, message):
    with pytest.raises(ValueError, match=message):
        write_video(tmp_path / "bar.mp4", frames)
    assert list(tmp_path.iterdir()) == []
