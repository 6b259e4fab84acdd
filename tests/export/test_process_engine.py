import multiprocessing
import pickle

import pytest
import torch

from sightline.depth_completion.config import TrunkConfig
from sightline.depth_completion.export_graph import export_graph
from sightline.depth_completion.predictor import DepthPredictor
from sightline.depth_completion.registration import TASK
from sightline.export import kept_files, process_engine
from sightline.export.process_engine import ProcessEngine
from sightline.inference.network import load_network
from tests.depth_completion.networks import write_tiny_weights
from tests.depth_completion.test_predictor import random_frame


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    return write_tiny_weights(
        path,
        shift_conv=None,
        trunk=TrunkConfig(channels=(4,), modules=1, blocks=1),
        trunk_stride=2,
        filled_input=True,
        residual=True,
        uncertainty=True,
    )


@pytest.fixture(scope="module")
def exported(weights):
    """The network as an ONNX file: made once, as it takes seconds."""
    return kept_files._export(export_graph(load_network(TASK, weights)))


@pytest.fixture
def load(weights, exported, monkeypatch):
    monkeypatch.setattr(process_engine, "onnx_file_of", lambda _: exported)
    return lambda engine: DepthPredictor.load(weights, engine=engine, threads=2)


def complete_in_a_forked_process(predictor, sparse, image):
    """Depth, or the error message."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def send():
        try:
            sender.send(predictor.complete(sparse, image).depth_m.tolist())
        except ValueError as error:
            sender.send(f"{type(error).__name__}: {error}")

    process = context.Process(target=send, daemon=True)
    process.start()
    assert receiver.poll(60), "the forked process does not answer"
    return receiver.recv()


@pytest.mark.parametrize("engine", ["onnxruntime", "openvino"])
@pytest.mark.parametrize("size", [(16, 20), (27, 33)])
def test_every_engine_gives_what_pytorch_gives(load, engine, size):
    sparse, image = random_frame(*size)
    expected = load("torch").complete(sparse, image)
    dense = load(engine).complete(sparse, image)
    torch.testing.assert_close(dense.depth_m, expected.depth_m, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(dense.uncertainty_m, expected.uncertainty_m, rtol=1e-4, atol=1e-3)
    assert torch.equal(dense.valid, expected.valid)


@pytest.mark.parametrize("engine", ["torch", "onnxruntime", "openvino"])
def test_an_engine_survives_pickling(load, engine):
    sparse, image = random_frame(16, 20)
    predictor = load(engine)
    expected = predictor.complete(sparse, image).depth_m
    copied = pickle.loads(pickle.dumps(predictor))
    assert torch.equal(copied.complete(sparse, image).depth_m, expected)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_onnx_runtime_that_was_used_can_be_used_in_a_forked_process(load):
    sparse, image = random_frame(16, 20)
    predictor = load("onnxruntime")
    expected = predictor.complete(sparse, image).depth_m.tolist()
    assert complete_in_a_forked_process(predictor, sparse, image) == expected


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_openvino_says_that_it_cannot_be_used_again_in_a_forked_process(load):
    sparse, image = random_frame(16, 20)
    predictor = load("openvino")
    predictor.complete(sparse, image)
    message = complete_in_a_forked_process(predictor, sparse, image)
    assert message.startswith("SetupError: openvino has run before this process was forked")


def test_a_device_that_an_engine_cannot_use_is_refused(weights):
    graph = export_graph(load_network(TASK, weights))
    with pytest.raises(ValueError, match="openvino runs on the cpu only, got cuda"):
        ProcessEngine(graph, name="openvino", device="cuda")
    for device in ("warp", *([] if torch.cuda.device_count() else ["cuda"])):
        with pytest.raises(ValueError, match=r"device \w+ cannot be used \(.*\); choose") as raised:
            ProcessEngine(graph, name="torch", device=device)
        assert "\n" not in str(raised.value)


def test_a_network_that_cannot_be_exported_is_run_by_pytorch_where_no_engine_is_named(
    weights, monkeypatch
):
    def fail(_):
        raise torch.onnx.OnnxExporterError("no such\noperator")

    monkeypatch.setattr(process_engine, "onnx_file_of", fail)
    monkeypatch.setenv("SIGHTLINE_ENGINE", "openvino")
    graph = export_graph(load_network(TASK, weights))
    with pytest.warns(UserWarning, match="PyTorch runs the network, .* openvino: no such operator"):
        engine = ProcessEngine(graph, name="auto")
    assert engine.name == "torch"
    assert engine(graph.example_inputs)
    with pytest.raises(torch.onnx.OnnxExporterError):
        ProcessEngine(graph, name="openvino")


def test_the_engine_that_was_taken_is_told(load, monkeypatch):
    monkeypatch.setenv("SIGHTLINE_ENGINE", "onnxruntime")
    predictor = load("auto")
    assert predictor.engine == predictor.made_by["engine"] == "onnxruntime"
    assert predictor.complete(*random_frame(16, 20)).depth_m.shape == (16, 20)
