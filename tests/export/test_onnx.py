import os
import tempfile
from pathlib import Path

import jaxtyping
import onnx
import pytest
import torch
from torch import nn

from sightline.export.engines import open_engine
from sightline.export.metadata import ExportMetadata, parse_metadata
from sightline.export.onnx import export_onnx, read_onnx_metadata
from tests.export.networks import METADATA, toy_inputs, toy_network


def test_inputs_and_outputs_have_the_modules_names_and_those_that_are_none_are_left_out(onnx_file):
    graph = onnx.load(onnx_file).graph
    assert [entry.name for entry in graph.input] == ["image", "sparse_depth_m"]
    assert [entry.name for entry in graph.output] == ["depth_m", "e_point_m"]


def test_height_and_width_are_free_and_batch_and_channels_are_not(onnx_file):
    shapes = [
        [axis.dim_param or axis.dim_value for axis in entry.type.tensor_type.shape.dim]
        for entry in onnx.load(onnx_file).graph.input
    ]
    assert shapes == [
        [1, 3, "8*height_blocks", "8*width_blocks"],
        [1, 1, "8*height_blocks", "8*width_blocks"],
    ]


def test_the_file_stands_alone_and_tells_what_it_is(onnx_file):
    assert [path.name for path in onnx_file.parent.iterdir()] == ["toy.onnx"]
    assert read_onnx_metadata(onnx_file) == METADATA


def test_the_file_names_no_folder_and_no_source_line_of_the_machine(onnx_file):
    content = onnx_file.read_bytes()
    assert b".py" not in content
    assert b"stack_trace" not in content


def test_batch_norm_is_folded_into_the_convolution_before_it(onnx_file):
    operators = {node.op_type for node in onnx.load(onnx_file).graph.node}
    assert "Conv" in operators
    assert "BatchNormalization" not in operators


def test_a_folder_whose_name_is_not_utf_8_takes_and_gives_files(tmp_path):
    folder = Path(os.fsdecode(bytes(tmp_path) + b"/d\xe9"))
    folder.mkdir()
    path = folder / "toy.onnx"
    export_onnx(toy_network(), toy_inputs(24, 40), path, metadata=METADATA)
    given, expected = toy_inputs(16, 24), toy_network()(**toy_inputs(16, 24)).depth_m
    for engine in ("onnxruntime", "openvino"):
        answer = open_engine(path, engine)(given)["depth_m"]
        torch.testing.assert_close(answer, expected, atol=1e-4, rtol=1e-4)


def test_shape_checks_are_on_again_after_an_export(onnx_file):
    assert onnx_file.exists()
    assert jaxtyping.config.jaxtyping_disable is False


def test_a_module_in_training_mode_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"call \.eval\(\) on it first"):
        export_onnx(
            toy_network().train(), toy_inputs(24, 40), tmp_path / "toy.onnx", metadata=METADATA
        )
    assert not any(tmp_path.iterdir())


def test_an_example_that_the_stride_does_not_divide_is_refused(tmp_path):
    with pytest.raises(ValueError, match="multiples of 8, got 24x41; pad the image"):
        export_onnx(toy_network(), toy_inputs(24, 41), tmp_path / "toy.onnx", metadata=METADATA)


def test_without_a_temporary_folder_the_export_says_so(tmp_path, monkeypatch):
    def find_none():
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr(tempfile, "gettempdir", find_none)
    with pytest.raises(FileNotFoundError, match=r"^No usable temporary directory found$"):
        export_onnx(toy_network(), toy_inputs(24, 40), tmp_path / "toy.onnx", metadata=METADATA)
    assert not any(tmp_path.iterdir())


class _Pair(nn.Module):
    def forward(self, image):
        return image, image


def test_a_module_that_returns_a_bare_tuple_is_refused_since_its_outputs_have_no_names(tmp_path):
    with pytest.raises(ValueError, match="a tensor or a NamedTuple of tensors, got tuple"):
        export_onnx(
            _Pair().eval(),
            {"image": torch.rand(1, 1, 8, 8)},
            tmp_path / "pair.onnx",
            metadata=METADATA,
        )


def test_a_failed_check_leaves_an_older_file_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "toy.onnx"
    path.write_bytes(b"older")

    def refuse(*_, **__):
        raise onnx.checker.ValidationError("no good")

    monkeypatch.setattr(onnx.checker, "check_model", refuse)
    with pytest.raises(onnx.checker.ValidationError):
        export_onnx(
            nn.Conv2d(1, 1, 1).eval(),
            {"input": torch.rand(1, 1, 16, 16)},
            path,
            metadata=METADATA,
        )
    assert path.read_bytes() == b"older"
    assert [entry.name for entry in tmp_path.iterdir()] == ["toy.onnx"]


def test_a_file_that_is_no_onnx_file_is_refused(tmp_path):
    path = tmp_path / "text.onnx"
    path.write_text("this is no model")
    with pytest.raises(ValueError, match="is no ONNX file, or is damaged"):
        read_onnx_metadata(path)


def test_an_onnx_file_of_another_tool_is_refused(tmp_path, onnx_file):
    model = onnx.load(onnx_file)
    del model.metadata_props[:]
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(ValueError, match=r"lacks the metadata sightline\.task, .* did not write"):
        read_onnx_metadata(tmp_path / "other.onnx")


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [("stride", "eight", "'eight'"), ("config", "[" * 100_000, "recursion")],
)
def test_damaged_metadata_is_refused(key, value, reason):
    properties = {**METADATA.to_properties(), f"sightline.{key}": value}
    with pytest.raises(ValueError, match=rf"toy\.onnx holds damaged metadata .*{reason}"):
        parse_metadata(properties, "toy.onnx")


def test_a_stride_below_one_is_refused():
    with pytest.raises(ValueError, match="stride must be at least 1, got 0"):
        ExportMetadata(task="toy", config={}, stride=0)
