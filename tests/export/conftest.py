"""The toy network as files, written once: the exporter takes seconds."""

from pathlib import Path

import pytest

from sightline.export.onnx import export_onnx
from sightline.export.openvino import convert_to_openvino
from tests.export.networks import METADATA, toy_inputs, toy_network


@pytest.fixture(scope="session")
def onnx_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("onnxscript", reason="the extra `export` is not installed")
    path = tmp_path_factory.mktemp("onnx") / "toy.onnx"
    export_onnx(toy_network(), toy_inputs(24, 40), path, metadata=METADATA)
    return path


@pytest.fixture(scope="session")
def openvino_file(onnx_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("openvino", reason="the extra `export` is not installed")
    path = tmp_path_factory.mktemp("openvino") / "toy.xml"
    convert_to_openvino(onnx_file, path)
    return path
