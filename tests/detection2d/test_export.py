import pytest
import torch

from sightline.detection2d.export_graph import MAX_DIFFERENCE
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.registration import TASK
from sightline.export.engines import open_engine
from sightline.export.write import export_graphs
from sightline.inference.network import load_network
from tests.detection2d.frames import painted_frame, write_network


@pytest.fixture(autouse=True, scope="module")
def _extra():
    for library in ("onnxscript", "onnxruntime", "openvino"):
        pytest.importorskip(library, reason="the extra `export` is not installed")


@pytest.mark.slow
def test_the_papers_network_is_one_file_that_gives_what_pytorch_gives(tmp_path):
    path = tmp_path / "tiny.safetensors"
    network = write_network(path)
    out = tmp_path / "tiny.onnx"
    reports = export_graphs(TASK.graphs(load_network(TASK, path)), out, "onnx")
    report = reports[out]
    assert report.is_within(MAX_DIFFERENCE)
    assert {each.output for each in report.differences} == {
        "scores", "boxes", "camera_gate", "lidar_gate",
    }  # fmt: skip
    cases = {each.case for each in report.differences}
    assert {"320x448", "320x448, no camera", "288x640, no LiDAR"} <= cases
    engine = open_engine(out)
    images = torch.rand(2, 1, 3, 375, 500, generator=torch.Generator().manual_seed(0))
    found = engine({"image": images[0], "lidar": images[1]})
    with torch.inference_mode():
        expected = network(images[0], images[1])
    torch.testing.assert_close(found["boxes"], expected.boxes, rtol=0, atol=MAX_DIFFERENCE)
    torch.testing.assert_close(found["scores"], expected.scores, rtol=0, atol=1e-4)


@pytest.mark.slow
def test_its_detections_do_not_depend_on_the_engine(tmp_path):
    path = tmp_path / "tiny.safetensors"
    write_network(path)
    sample = painted_frame(0)
    expected = DetectionPredictor.load(path)(sample).detections
    found = DetectionPredictor.load(path, engine="onnxruntime")(sample).detections
    torch.testing.assert_close(found.scores, expected.scores, rtol=0, atol=1e-4)
    torch.testing.assert_close(found.boxes.tensor, expected.boxes.tensor, rtol=0, atol=0.1)
