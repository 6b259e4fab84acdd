from dataclasses import asdict

import pytest
import torch
from torch import nn

from sightline.depth_completion import export_graph
from sightline.depth_completion.config import (
    DepthCompletionConfig,
    ShiftConvConfig,
    TrunkConfig,
)
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.registration import TASK
from sightline.export import write as module
from sightline.export.engines import open_engine
from sightline.export.write import export_graphs
from sightline.files.weights import write_weights
from sightline.inference.network import load_network

FILLED = DepthCompletionConfig(
    shift_conv=None,
    trunk=TrunkConfig(channels=(4, 4), modules=1, blocks=1, lowest_blocks=1),
    stem_channels=4,
    filled_input=True,
    residual=True,
    uncertainty=True,
)
SHIFTED = DepthCompletionConfig(
    shift_conv=ShiftConvConfig(channels=9, layers=1),
    trunk=TrunkConfig(channels=(4,), modules=1, blocks=1, lowest_blocks=1),
    stem_channels=4,
)


def random_network(config):
    generator = torch.Generator().manual_seed(0)
    network = DepthCompletionNet(config)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.5 * torch.randn(parameter.shape, generator=generator))
        for part in network.modules():
            if isinstance(part, nn.BatchNorm2d):
                part.running_mean.uniform_(-0.2, 0.2, generator=generator)
                part.running_var.uniform_(0.5, 2, generator=generator)
    return network.eval()


def export_weights(weights, out, file_format):
    """Export weights; returns the report of the only file."""
    reports = export_graphs(TASK.graphs(load_network(TASK, weights)), out, file_format)
    assert list(reports) == [out]
    return reports[out]


def write_network(path, network):
    write_weights(
        path,
        network.state_dict(),
        task="depth-completion",
        config=asdict(network.config),
        provenance={"seed": "0"},
    )
    return path


@pytest.fixture(autouse=True, scope="module")
def _extra():
    for library in ("onnxscript", "onnxruntime", "openvino"):
        pytest.importorskip(library, reason="the extra `export` is not installed")


def test_an_openvino_file_alone_gives_what_the_network_gives_at_a_third_size(tmp_path):
    network = random_network(FILLED)
    weights = write_network(tmp_path / "tiny.safetensors", network)
    out = tmp_path / "out" / "tiny.xml"
    report = export_weights(weights, out, "openvino")
    assert report.unit == "mm"
    assert report.is_within(export_graph.MAX_DIFFERENCE_MM)
    assert {entry.output for entry in report.differences} == {"depth_m", "uncertainty_m"}
    assert {entry.case for entry in report.differences} == {
        f"{size}{sensors}"
        for size in ("10x14", "16x26")
        for sensors in ("", ", no camera", ", no LiDAR")
    }
    assert sorted(path.name for path in out.parent.iterdir()) == ["tiny.bin", "tiny.xml"]

    weights.unlink()
    engine = open_engine(out)
    generator = torch.Generator().manual_seed(1)
    inputs = {
        "image": torch.rand(1, 3, 32, 18, generator=generator),
        "sparse_depth_m": 80 * torch.rand(1, 1, 32, 18, generator=generator),
        "filled_depth_m": 80 * torch.rand(1, 1, 32, 18, generator=generator),
    }
    assert engine.input_names == tuple(inputs)
    torch.testing.assert_close(
        engine(inputs)["depth_m"], network(**inputs).depth_m.detach(), rtol=0, atol=1e-3
    )
    metadata = engine.metadata
    assert (metadata.task, metadata.stride) == ("depth-completion", 2)
    assert metadata.config["residual"] is True
    assert metadata.provenance["seed"] == "0"
    assert metadata.provenance["weights"] == "tiny"


def test_an_onnx_file_is_kept_or_not_by_its_parity(tmp_path, monkeypatch):
    weights = write_network(tmp_path / "tiny.safetensors", random_network(SHIFTED))
    out = tmp_path / "out" / "tiny.onnx"
    check_parity = module.check_parity
    reports = []

    def keep_report(*args, **kwargs):
        reports.append(check_parity(*args, **kwargs))
        return reports[-1]

    monkeypatch.setattr(module, "check_parity", keep_report)
    monkeypatch.setattr(export_graph, "MAX_DIFFERENCE_MM", -1.0)
    with pytest.raises(
        ValueError, match=r"was not kept: onnxruntime differs from PyTorch by .* mm"
    ):
        export_weights(weights, out, "onnx")
    assert not any(out.parent.iterdir())

    monkeypatch.setattr(export_graph, "MAX_DIFFERENCE_MM", 1.0)
    report = export_weights(weights, out, "onnx")
    assert report.differences == reports[0].differences  # the same inputs again
    assert "; within the 1 mm allowed" in report.table().caption
    assert {entry.output for entry in reports[0].differences} == {"depth_m", "e_point_m"}
    assert open_engine(out).input_names == ("image", "sparse_depth_m")


@pytest.mark.parametrize(
    ("name", "file_format", "suffix"),
    [
        ("net.xml", "onnx", r"\.onnx"),
        ("net.onnx", "openvino", r"\.xml"),
        ("net", "onnx", r"\.onnx"),
    ],
)
def test_a_file_with_another_suffix_than_its_format_is_refused(tmp_path, name, file_format, suffix):
    with pytest.raises(ValueError, match=f"format {file_format} ends in {suffix}, got .*{name}"):
        export_weights("depth-best", tmp_path / name, file_format)


def test_weights_that_are_not_there_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match="there are no weights 'absent'"):
        export_weights("absent", tmp_path / "out" / "net.onnx", "onnx")
    assert not any(tmp_path.iterdir())
