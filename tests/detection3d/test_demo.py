from pathlib import Path

import pytest

from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_labels import read_results
from sightline.detection3d import registration
from sightline.detection3d.registration import TASK
from sightline.inference.demo import run_demo
from tests.detection3d.frames import COMPACT, write_network


@pytest.fixture
def default_weights(tmp_path, monkeypatch):
    """Weights drawn at random, in the place of those that come with the package."""
    path = tmp_path / "small.safetensors"
    write_network(path, COMPACT)
    monkeypatch.setattr(registration.Detection3DTask, "default_weights", str(path))


@pytest.mark.usefixtures("default_weights")
def test_the_demo_draws_each_frame_s_boxes_in_the_image_and_from_above(tmp_path):
    out = tmp_path / "out"
    lines = run_demo(out, [TASK.demo]).splitlines()
    assert lines[0].startswith("3D objects by small: ")
    named = [Path(line[10:]) for line in lines[1:]]
    assert {out / "detections3d", out / "detections3d.png", out / "report.html"} <= set(named)
    assert read_rgb(out / "detections3d.png").shape[0] > 2 * 2 * 200
    for frame in ("000000", "000001"):
        assert len(read_results(out / "detections3d" / f"{frame}.txt")) > 0
    assert 'src="detections3d.png"' in (out / "report.html").read_text()


@pytest.mark.usefixtures("default_weights")
def test_the_default_weights_answer_where_none_are_named():
    assert TASK.predictor().name == "small"


def test_there_are_no_methods():
    with pytest.raises(ValueError, match="detection3d has no method 'adaptive'"):
        TASK.predictor(method="adaptive")
