import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torch import nn

from sightline.export.engines import TorchEngine, build_engine, open_engine
from sightline.export.extra import import_extra
from tests.export.networks import METADATA, toy_inputs, toy_network

NAMES = ("image", "sparse_depth_m")


@pytest.fixture(scope="module")
def torch_engine():
    return TorchEngine(toy_network(), NAMES, metadata=METADATA)


@pytest.fixture(
    scope="module",
    params=[("onnx_file", "onnxruntime"), ("onnx_file", "openvino"), ("openvino_file", "openvino")],
    ids=lambda param: f"{param[0]}-{param[1]}",
)
def engine(request):
    file, name = request.param
    return open_engine(request.getfixturevalue(file), name)


@pytest.mark.parametrize("size", [(24, 40), (8, 8), (16, 8), (64, 48)])
def test_every_engine_gives_what_pytorch_gives_at_any_size(engine, torch_engine, size):
    inputs = toy_inputs(*size, seed=1)
    expected = torch_engine(inputs)
    outputs = engine(inputs)
    assert list(outputs) == list(expected) == ["depth_m", "e_point_m"]
    for name, output in outputs.items():
        torch.testing.assert_close(output, expected[name], rtol=0, atol=1e-3)


def test_every_engine_switches_on_a_black_image_as_pytorch_does(engine, torch_engine):
    inputs = {**toy_inputs(24, 40), "image": torch.zeros(1, 3, 24, 40)}
    grey = {**inputs, "image": torch.full((1, 3, 24, 40), 1e-6)}
    expected = torch_engine(inputs)["depth_m"]
    assert (torch_engine(grey)["depth_m"] - expected).abs().max() > 0.1  # there is a switch
    torch.testing.assert_close(engine(inputs)["depth_m"], expected, rtol=0, atol=1e-3)


def test_an_engines_outputs_stay_as_they_are_when_it_runs_again(engine):
    first = engine(toy_inputs(24, 40, seed=1))["depth_m"]
    copy = first.clone()
    second = engine(toy_inputs(24, 40, seed=2))["depth_m"]
    assert not torch.equal(second, copy)
    assert torch.equal(first, copy)


def test_an_engine_returns_to_a_size_after_many_others(engine):
    first = engine(toy_inputs(24, 40))["depth_m"]
    for blocks in range(1, 7):
        assert engine(toy_inputs(8 * blocks, 16))["depth_m"].shape == (1, 1, 8 * blocks, 16)
    torch.testing.assert_close(engine(toy_inputs(24, 40))["depth_m"], first, rtol=0, atol=1e-3)


def test_engines_tell_their_inputs_and_what_they_run(engine):
    assert engine.input_names == NAMES
    assert engine.metadata == METADATA


def test_inputs_that_are_not_contiguous_are_taken(engine, torch_engine):
    inputs = {name: tensor.mT for name, tensor in toy_inputs(40, 24).items()}
    torch.testing.assert_close(
        engine(inputs)["depth_m"], torch_engine(inputs)["depth_m"], rtol=0, atol=1e-3
    )


def test_an_input_too_few_or_too_many_is_refused(engine):
    inputs = toy_inputs(24, 40)
    with pytest.raises(ValueError, match="takes the inputs image, sparse_depth_m, got image"):
        engine({"image": inputs["image"]})
    with pytest.raises(ValueError, match="got image, sparse_depth_m, filled_depth_m"):
        engine({**inputs, "filled_depth_m": inputs["sparse_depth_m"]})


@pytest.mark.parametrize("size", [(24, 44), (20, 40)])
def test_a_size_that_the_stride_does_not_divide_is_refused(engine, size):
    with pytest.raises(ValueError, match=f"multiples of 8, got {size[0]}x{size[1]}"):
        engine(toy_inputs(*size))


def test_threads_change_nothing_but_the_speed(onnx_file, torch_engine):
    inputs = toy_inputs(24, 40)
    expected = torch_engine(inputs)["depth_m"]
    before = torch.get_num_threads()
    engines = (
        TorchEngine(toy_network(), NAMES, metadata=METADATA, threads=before + 1),
        open_engine(onnx_file, "onnxruntime", threads=2),
        open_engine(onnx_file, "openvino", threads=2),
    )
    for engine in engines:
        torch.testing.assert_close(engine(inputs)["depth_m"], expected, rtol=0, atol=1e-3)
    assert torch.get_num_threads() == before


def test_no_threads_are_refused(onnx_file):
    with pytest.raises(ValueError, match="threads must be a whole number of at least 1, got 0"):
        open_engine(onnx_file, threads=0)


def test_pytorch_runs_in_bfloat16_and_gives_float32(torch_engine):
    engine = TorchEngine(toy_network(), NAMES, metadata=METADATA, precision="bfloat16")
    inputs = toy_inputs(24, 40)
    output, expected = engine(inputs)["depth_m"], torch_engine(inputs)["depth_m"]
    assert output.dtype == torch.float32
    assert 0 < (output - expected).abs().max() < 0.1 * expected.abs().max()


def test_onnx_runtime_refuses_bfloat16(onnx_file):
    with pytest.raises(ValueError, match="float32 only, got bfloat16"):
        open_engine(onnx_file, "onnxruntime", precision="bfloat16")


@pytest.mark.parametrize("name", ["torch", "openvino"])
def test_a_module_becomes_an_engine_without_a_file_of_ones_own(name):
    module = nn.Conv2d(1, 1, 1).eval()
    example = {"input": torch.rand(1, 1, 16, 16, generator=torch.Generator().manual_seed(0))}
    engine = build_engine(module, example, name, metadata=METADATA)
    assert engine.name == name
    other = {"input": example["input"].repeat(1, 1, 1, 2)}
    torch.testing.assert_close(engine(other)["output"], module(other["input"]).detach())


def test_a_module_in_training_mode_is_refused():
    with pytest.raises(ValueError, match="cannot be run"):
        TorchEngine(toy_network().train(), NAMES, metadata=METADATA)


def test_a_file_that_an_engine_cannot_run_is_refused(openvino_file, onnx_file, tmp_path):
    with pytest.raises(ValueError, match=r"onnxruntime cannot run .*toy\.xml; choose .* openvino"):
        open_engine(openvino_file, "onnxruntime")
    with pytest.raises(ValueError, match=r"torch cannot run .*toy\.onnx"):
        open_engine(onnx_file, "torch")
    with pytest.raises(ValueError, match=r"absent\.onnx is no \.onnx or \.xml file"):
        open_engine(tmp_path / "absent.onnx")


def test_an_onnx_file_whose_graph_is_damaged_is_refused_by_onnx_runtime_too(tmp_path):
    onnx = pytest.importorskip("onnx")
    image, output = (
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1]) for name in "ia"
    )
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("None", "i", "a")], "g", [image], [output]
    )
    model = onnx.helper.make_model(graph)
    onnx.helper.set_model_props(model, METADATA.to_properties())
    onnx.save(model, tmp_path / "model.onnx")
    with pytest.raises(
        ValueError, match=r"onnxruntime cannot read .*model.onnx: .* export it again"
    ):
        open_engine(tmp_path / "model.onnx", "onnxruntime")


def test_an_openvino_file_without_its_weights_is_refused(openvino_file, tmp_path):
    path = tmp_path / "toy.xml"
    path.write_bytes(openvino_file.read_bytes())
    with pytest.raises(ValueError, match=r"\.bin beside it, is damaged or missing"):
        open_engine(path)


def test_a_library_that_is_not_installed_is_named_with_the_extra_that_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "openvino", None)
    with pytest.raises(
        ValueError, match=r"openvino is not installed; .* pip install '\.\[export\]'"
    ):
        import_extra("openvino")


def test_a_library_that_lacks_a_part_of_its_own_is_not_called_missing(monkeypatch, tmp_path):
    (tmp_path / "openvino.py").write_text("import a_part_of_openvino")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "openvino", raising=False)
    with pytest.raises(ModuleNotFoundError, match="No module named 'a_part_of_openvino'"):
        import_extra("openvino")


def test_onnx_runtime_is_kept_from_sending_usage_data(monkeypatch):
    monkeypatch.delenv("ORT_DISABLE_TELEMETRY", raising=False)
    import_extra("onnxruntime")
    assert os.environ["ORT_DISABLE_TELEMETRY"] == "1"


def test_signals_still_come_after_several_openvino_engines(openvino_file):
    """Each `openvino.Core` puts up a signal stack; it must not be gone when one is needed."""
    program = f"""
import signal
from pathlib import Path
from sightline.export.engines import open_engine
engines = [open_engine(Path({str(openvino_file)!r}), threads=1) for _ in range(3)]
while engines:
    engines.pop(0)
signal.signal(signal.SIGUSR1, lambda *_: print("it came"))
signal.raise_signal(signal.SIGUSR1)
"""
    run = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True
    )
    assert (run.returncode, run.stdout) == (0, "it came\n"), run.stderr


def test_threads_may_share_an_engine(engine):
    sizes = [(24, 40), (16, 8), (24, 40)]
    expected = [engine(toy_inputs(*size))["depth_m"] for size in sizes]
    with ThreadPoolExecutor(3) as pool:
        for _ in range(20):
            found = pool.map(lambda size: engine(toy_inputs(*size))["depth_m"], sizes)
            assert all(map(torch.equal, found, expected))
