import os
import socket
import subprocess
import sys

import onnx
import openvino_telemetry
import pytest

from sightline.export.engines import open_engine
from sightline.export.openvino import convert_to_openvino, ir_files
from sightline.files.atomic import DiskError
from tests.export.networks import METADATA


def test_the_two_files_stand_side_by_side_and_tell_what_they_are(openvino_file):
    assert sorted(path.name for path in openvino_file.parent.iterdir()) == ["toy.bin", "toy.xml"]
    assert open_engine(openvino_file).metadata == METADATA


def test_weights_are_kept_in_full_precision(openvino_file, onnx_file):
    stored = sum(
        onnx.numpy_helper.to_array(tensor).nbytes
        for tensor in onnx.load(onnx_file).graph.initializer
        if tensor.data_type == onnx.TensorProto.FLOAT
    )
    assert openvino_file.with_suffix(".bin").stat().st_size >= stored


def test_nothing_is_sent_while_a_file_is_converted_and_opened(onnx_file, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("reached for the network")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(openvino_telemetry.Telemetry, "send_event", refuse)
    convert_to_openvino(onnx_file, tmp_path / "toy.xml")
    open_engine(tmp_path / "toy.xml")


def test_nothing_is_sent_or_left_behind_by_the_import(tmp_path):
    """OpenVINO counts each import where `openvino_telemetry` is at hand."""
    code = """
import sys
from sightline.export.extra import import_extra
import_extra("openvino")
assert "openvino_telemetry" not in sys.modules
from openvino.tools.ovc import telemetry_utils
print(telemetry_utils.tm.__name__)
"""
    ran = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.strip() == "openvino.tools.ovc.telemetry_stub"
    assert not any(tmp_path.iterdir())


def test_a_path_without_the_suffix_xml_is_refused(onnx_file, tmp_path):
    with pytest.raises(ValueError, match=r"ends in \.xml, got .*toy\.ir"):
        convert_to_openvino(onnx_file, tmp_path / "toy.ir")
    assert not any(tmp_path.iterdir())


def test_two_files_are_written_together_or_not_at_all(tmp_path):
    path = tmp_path / "toy.xml"
    path.write_text("older")
    with pytest.raises(RuntimeError):
        _write_and_fail(path)
    assert path.read_text() == "older"
    assert [entry.name for entry in tmp_path.iterdir()] == ["toy.xml"]


def test_a_disk_without_room_is_told_in_one_line(onnx_file, tmp_path, monkeypatch):
    import openvino

    def fail(*_, **__):
        raise RuntimeError("basic_ios::clear: iostream error\nat src")

    monkeypatch.setattr(openvino, "save_model", fail)
    with pytest.raises(DiskError, match=r"^[^\n]*toy\.xml cannot be written: OpenVINO says 'basic"):
        convert_to_openvino(onnx_file, tmp_path / "toy.xml")
    assert not any(tmp_path.iterdir())


def _write_and_fail(path):
    with ir_files(path) as aside:
        aside.write_text("newer")
        aside.with_suffix(".bin").write_text("newer")
        raise RuntimeError
