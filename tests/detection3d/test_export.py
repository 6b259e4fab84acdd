"""Both stages as files that give what PyTorch gives."""

import pytest
import torch

from sightline.detection3d.detector import refine
from sightline.detection3d.export_graph import MAX_DIFFERENCE, REGIONS_A_RUN, region_portions
from sightline.detection3d.predictor import Detection3DPredictor, StageRunners
from sightline.detection3d.registration import TASK
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import network_sweep
from sightline.export.engines import open_engine
from sightline.export.write import export_graphs
from sightline.files.weights import write_weights
from sightline.inference.network import load_network
from tests.detection3d.frames import COMPACT, TINY, simulated_frames, write_network


@pytest.fixture(autouse=True, scope="module")
def _extra():
    for library in ("onnxscript", "onnxruntime", "openvino"):
        pytest.importorskip(library, reason="the extra `export` is not installed")


OUTPUTS = {
    "points": ({"features", "class_logits", "box_values"}, {"boxes", "logits"}),
    "pillars": (
        {"heat_logits", "center_values"},
        {"values", "front_logits", "quality_logits"},
    ),
}


@pytest.fixture(scope="module", params=[TINY, COMPACT], ids=["points", "pillars"])
def weights(request, tmp_path_factory):
    """Statistics of batch norms as after a training."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    network = write_network(path, request.param)
    generator = torch.Generator().manual_seed(0)
    for part in network.modules():
        if isinstance(part, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            part.running_mean.uniform_(-0.2, 0.2, generator=generator)
            part.running_var.uniform_(0.5, 2, generator=generator)
    if network.first_name == "pillars":  # else its second stage changes nothing
        torch.nn.init.normal_(network.regions.network.answer.weight, std=0.1, generator=generator)
    else:  # else its boxes are all about the first one, and only one is left of them
        last = network.refinement.network.box_head[-1]
        torch.nn.init.normal_(last.weight, generator=generator)
        torch.nn.init.zeros_(last.bias)
    loaded = load_network(TASK, path)
    write_weights(path, network.state_dict(), task="detection3d", config=loaded.weights.config,
                  provenance={})  # fmt: skip
    return path


def test_each_stage_is_a_file_that_gives_what_pytorch_gives(weights, tmp_path):
    out = tmp_path / "out.onnx"
    loaded = load_network(TASK, weights)
    reports = export_graphs(TASK.graphs(loaded), out, "onnx")
    names = {path.name: report for path, report in reports.items()}
    assert set(names) == {"out-proposals.onnx", "out-refinement.onnx"}
    assert all(report.is_within(MAX_DIFFERENCE) for report in reports.values())
    outputs = {name: {each.output for each in report.differences} for name, report in names.items()}
    expected = OUTPUTS[loaded.network.first_name]
    assert (outputs["out-proposals.onnx"], outputs["out-refinement.onnx"]) == expected
    cases = {each.case for each in names["out-proposals.onnx"].differences}
    assert cases == {"clusters", "other clusters", "one point"}
    for graph in TASK.graphs(loaded):
        engine = open_engine(tmp_path / f"out-{graph.name}.onnx", "openvino")
        with torch.inference_mode():
            expected = graph.module(**graph.example_inputs)
        found = engine(graph.example_inputs)
        for name, value in expected._asdict().items():
            torch.testing.assert_close(found[name], value, rtol=0, atol=MAX_DIFFERENCE)


def test_another_engine_answers_as_pytorch_does(weights):
    sample = simulated_frames()[0]
    expected, found = (
        Detection3DPredictor.load(weights, engine=engine)(sample)
        for engine in ("torch", "onnxruntime")
    )
    assert found.class_names == expected.class_names
    torch.testing.assert_close(found.boxes.tensor, expected.boxes.tensor, atol=2e-3, rtol=0)
    torch.testing.assert_close(found.scores, expected.scores, atol=1e-3, rtol=0)


@pytest.mark.parametrize("count", [1, REGIONS_A_RUN - 1, REGIONS_A_RUN, 2 * REGIONS_A_RUN + 5])
def test_regions_go_in_portions_of_the_size_that_a_file_takes(count):
    inputs = {"points": torch.randn(count, 4, 3), "context": torch.arange(float(count))[:, None]}
    portions = list(region_portions(inputs))
    assert len(portions) == -(-count // REGIONS_A_RUN)
    for name, values in inputs.items():
        together = torch.cat([each[name] for each in portions])
        assert all(len(each[name]) == REGIONS_A_RUN for each in portions)
        assert together[:count].equal(values)
        assert (together[count:] == values[-1]).all()


@pytest.mark.parametrize(("engine", "within"), [("torch", 1e-5), ("onnxruntime", 2e-3)])
def test_more_regions_than_are_run_at_once_are_refined_as_all_together(weights, engine, within):
    loaded = load_network(TASK, weights)
    sweep = network_sweep(simulated_frames()[0], loaded.network.config.input)
    count = 2 * REGIONS_A_RUN + 5
    around = sweep[torch.linspace(0, len(sweep) - 1, count).long(), :3]
    boxes = torch.cat((around, around.new_tensor([[3.9, 1.6, 1.5, 0.5]]).expand(count, 4)), dim=1)
    scores, channels = torch.linspace(0.9, 0.5, count), loaded.network.first.feature_channels
    features = torch.ones(len(sweep), channels) if channels else None
    proposed = Proposed(boxes, torch.zeros(count, dtype=torch.int64), scores, features)
    with torch.inference_mode():
        expected = refine(loaded.network, sweep, proposed)
    found = StageRunners(loaded, engine=engine).refine(sweep, proposed)
    assert len(expected.scores) > REGIONS_A_RUN
    torch.testing.assert_close(found.boxes.tensor, expected.boxes.tensor, atol=within, rtol=0)
    torch.testing.assert_close(found.scores, expected.scores, atol=within, rtol=0)
