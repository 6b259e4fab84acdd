from dataclasses import asdict, replace

import pytest
import torch

from sightline.detection2d.export_graph import MAX_DIFFERENCE
from sightline.detection2d.registration import TASK
from sightline.export.engines import open_engine
from sightline.export.write import export_graphs
from sightline.files.weights import write_weights
from sightline.inference.network import load_network
from tests.detection2d.frames import TINY_COMPACT, write_network

SMALL = replace(TINY_COMPACT, compact=replace(TINY_COMPACT.compact, gate_groups=4))


@pytest.fixture(autouse=True, scope="module")
def _extra():
    for library in ("onnxscript", "onnxruntime", "openvino"):
        pytest.importorskip(library, reason="the extra `export` is not installed")


CASES = {
    f"{size}{what}" for size in ("320x448", "288x640") for what in ("", ", no camera", ", no LiDAR")
}
OUTPUTS = {"scores", "boxes", "camera_gate", "lidar_gate"}


def check_export(network, weights, out, file_format, size):
    """What a file gives, against PyTorch: by the report, and at a third size."""
    reports = export_graphs(TASK.graphs(load_network(TASK, weights)), out, file_format)
    report = reports[out]
    assert report.is_within(MAX_DIFFERENCE)
    assert {each.output for each in report.differences} == OUTPUTS
    assert {each.case for each in report.differences} == CASES
    engine = open_engine(out)
    assert engine.metadata.task == "detection2d"
    images = torch.rand(2, 1, 3, *size, generator=torch.Generator().manual_seed(0))
    found = engine({"image": images[0], "lidar": images[1]})
    with torch.inference_mode():
        expected = network(images[0], images[1])
    torch.testing.assert_close(found["boxes"], expected.boxes, rtol=0, atol=MAX_DIFFERENCE)
    torch.testing.assert_close(found["scores"], expected.scores, rtol=0, atol=1e-4)


def shaken(network, path, config):
    """Statistics of batch norms as after a training, too; written to the file."""
    generator = torch.Generator().manual_seed(0)
    for part in network.modules():
        if isinstance(part, torch.nn.BatchNorm2d):
            part.running_mean.uniform_(-0.2, 0.2, generator=generator)
            part.running_var.uniform_(0.5, 2, generator=generator)
    write_weights(path, network.state_dict(), task="detection2d", config=asdict(config),
                  provenance={})  # fmt: skip
    return network


@pytest.mark.parametrize("own_heads", [False, True])
def test_the_compact_network_is_one_file_that_gives_what_pytorch_gives(tmp_path, own_heads):
    path, out = tmp_path / "tiny.safetensors", tmp_path / "out.onnx"
    config = replace(SMALL, compact=replace(SMALL.compact, own_heads=own_heads))
    network = shaken(write_network(path, config), path, config)
    check_export(network, path, out, "onnx", (384, 1248))
    inputs = {"image": torch.rand(1, 3, 64, 96), "lidar": torch.rand(1, 3, 64, 96)}
    found = open_engine(out, "openvino")(inputs)
    with torch.inference_mode():
        expected = network(**inputs)
    for name in OUTPUTS:
        torch.testing.assert_close(
            found[name], getattr(expected, name), rtol=0, atol=MAX_DIFFERENCE
        )


@pytest.mark.slow
def test_an_openvino_file_gives_what_pytorch_gives(tmp_path):
    path = tmp_path / "tiny.safetensors"
    network = shaken(write_network(path, SMALL), path, SMALL)
    check_export(network, path, tmp_path / "out.xml", "openvino", (384, 1248))


@pytest.mark.slow
def test_a_network_of_one_sensor_is_a_file_that_takes_one_image(tmp_path):
    network = write_network(tmp_path / "tiny.safetensors", replace(SMALL, fusion="lidar"))
    loaded = load_network(TASK, tmp_path / "tiny.safetensors")
    export_graphs(TASK.graphs(loaded), tmp_path / "out.onnx", "onnx")
    engine = open_engine(tmp_path / "out.onnx")
    lidar = torch.rand(1, 3, 64, 96)
    assert engine.input_names == ("lidar",)
    with torch.inference_mode():
        expected = network(lidar=lidar).boxes
    torch.testing.assert_close(
        engine({"lidar": lidar})["boxes"], expected, rtol=0, atol=MAX_DIFFERENCE
    )


@pytest.mark.slow
def test_the_papers_network_is_one_file_that_gives_what_pytorch_gives(tmp_path):
    path = tmp_path / "tiny.safetensors"
    network = write_network(path)
    check_export(network, path, tmp_path / "out.onnx", "onnx", (375, 500))
