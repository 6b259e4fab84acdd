import subprocess
import sys

import pytest

from sightline.export import choice
from sightline.export.choice import choose_engine


@pytest.fixture
def installed(monkeypatch):
    """Set the installed libraries."""
    libraries = {"openvino", "onnx", "onnxscript"}
    monkeypatch.delenv("SIGHTLINE_ENGINE")
    monkeypatch.setattr(choice, "find_spec", lambda name: name if name in libraries else None)
    return libraries


def test_openvino_is_taken_where_it_is_installed_with_all_that_it_needs(installed):
    assert choose_engine("auto") == "openvino"
    for library in sorted(installed):
        installed.remove(library)
        assert choose_engine("auto") == "torch"
        installed.add(library)


@pytest.mark.usefixtures("installed")
def test_on_another_device_pytorch_is_taken():
    assert choose_engine("auto", "cuda") == "torch"


@pytest.mark.parametrize("named", ["torch", "onnxruntime", "openvino"])
@pytest.mark.usefixtures("installed")
def test_what_is_named_is_taken(named, monkeypatch):
    assert choose_engine(named) == named
    monkeypatch.setenv("SIGHTLINE_ENGINE", named)
    assert choose_engine("auto") == named
    assert choose_engine("torch") == "torch"


def test_a_variable_that_names_no_engine_is_refused(monkeypatch):
    monkeypatch.setenv("SIGHTLINE_ENGINE", "auto")
    with pytest.raises(ValueError, match="SIGHTLINE_ENGINE is 'auto', which is no engine; set it"):
        choose_engine("auto")


def test_an_engine_that_there_is_none_of_is_no_extra_to_install():
    # in a process of its own, where no hook checks types first
    code = "from sightline.export.choice import choose_engine; choose_engine('tensorrt')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "no engine tensorrt; choose auto, torch, onnxruntime, openvino" in done.stderr
