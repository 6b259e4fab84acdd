from dataclasses import replace
from pathlib import Path

import pytest

from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_labels import read_results
from sightline.detection2d import registration
from sightline.detection2d.config import PostprocessConfig
from sightline.detection2d.registration import TASK
from sightline.inference.demo import run_demo
from tests.detection2d.frames import TINY, write_network


@pytest.fixture
def default_weights(tmp_path, monkeypatch):
    """Weights drawn at random, in the place of those that come with the package."""
    config = replace(
        TINY,
        postprocess=PostprocessConfig(min_score=0.3, max_detections=7),
    )
    write_network(tmp_path / "small.safetensors", config)
    monkeypatch.setattr(
        registration.Detection2DTask, "default_weights", str(tmp_path / "small.safetensors")
    )


@pytest.mark.usefixtures("default_weights")
def test_the_demo_shows_a_frame_with_both_sensors_and_with_either_dead(tmp_path):
    out = tmp_path / "out"
    lines = run_demo(out, [TASK.demo]).splitlines()
    assert lines[0].startswith("objects by small: ")
    assert lines[0].endswith("with the LiDAR dead")
    named = [Path(line.split(maxsplit=1)[1]) for line in lines[1:]]
    assert {out / "detections", out / "detections.png", out / "report.html"} <= set(named)
    assert read_rgb(out / "detections.png").shape[0] > 3 * 180
    for frame in ("000000", "000001"):
        assert len(read_results(out / "detections" / f"{frame}.txt")) <= 7
    page = (out / "report.html").read_text()
    assert 'src="detections.png"' in page
    assert "the camera dead" in page


@pytest.mark.usefixtures("default_weights")
def test_the_default_weights_answer_where_none_are_named():
    assert TASK.predictor().name == "small"
