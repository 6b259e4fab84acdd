import json
import math

import pytest
import torch
from rich.console import Console

from sightline.export.engines import TorchEngine, open_engine
from sightline.export.parity import check_parity
from tests.export.networks import METADATA, toy_inputs, toy_network


class FixedEngine:
    """Gives the same outputs for every input."""

    metadata = METADATA
    input_names = ("image",)

    def __init__(self, name, **outputs):
        self.name = name
        self._outputs = {key: torch.tensor(value) for key, value in outputs.items()}

    def __call__(self, inputs):
        del inputs
        return dict(self._outputs)


CASES = {"8x8": {"image": torch.zeros(1, 3, 8, 8)}}
REFERENCE = FixedEngine("torch", depth_m=[1.0, 2.0, 4.0], error_m=[0.0])


def test_differences_are_the_largest_and_the_mean_absolute_ones_in_the_unit_asked_for():
    engine = FixedEngine("openvino", depth_m=[1.0, 1.5, 4.25], error_m=[0.0])
    report = check_parity(REFERENCE, [engine], CASES, unit="mm", scale=1e3)
    depth, error = report.differences
    assert (depth.engine, depth.case, depth.output) == ("openvino", "8x8", "depth_m")
    assert (depth.max_difference, depth.mean_difference) == (500, 250)
    assert (error.max_difference, error.mean_difference) == (0, 0)
    assert report.worst is depth
    assert report.is_within(500.0)
    assert not report.is_within(499.0)


def test_there_is_one_row_for_each_input_engine_and_output():
    engines = [REFERENCE, FixedEngine("openvino", depth_m=[0.0] * 3, error_m=[0.0])]
    report = check_parity(REFERENCE, engines, {**CASES, "16x8": CASES["8x8"]})
    rows = [(entry.case, entry.engine, entry.output) for entry in report.differences]
    assert len(rows) == len(set(rows)) == 2 * 2 * 2


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_output_that_is_not_finite_is_the_worst_and_within_no_bound(value):
    engine = FixedEngine("openvino", depth_m=[1e9, 2.0, 4.0], error_m=[value])
    report = check_parity(REFERENCE, [engine], CASES)
    assert report.worst.output == "error_m"
    assert not report.is_within(1e30)
    assert json.loads(json.dumps(report.to_json(), allow_nan=False))["differences"][1] == {
        "engine": "openvino",
        "case": "8x8",
        "output": "error_m",
        "max": None,
        "mean": None,
    }


@pytest.mark.parametrize(
    ("allowed", "verdict"),
    [(None, ""), (750.0, "; within the 750 mm allowed"), (1.0, "; more than the 1 mm allowed")],
)
def test_the_table_ends_in_the_largest_difference_of_all_and_a_verdict(allowed, verdict):
    engine = FixedEngine("openvino", depth_m=[1.0, 1.5, 4.25], error_m=[0.75])
    report = check_parity(REFERENCE, [engine], CASES, unit="mm", scale=1e3, allowed=allowed)
    assert report.table().caption == f"largest: 7.5e+02 mm, openvino, error_m at 8x8{verdict}"


def test_outputs_of_different_units_are_each_told_in_their_own():
    engine = FixedEngine("openvino", depth_m=[1.0, 1.5, 4.25], error_m=[0.75])
    table = check_parity(REFERENCE, [engine], CASES, allowed=1.0).table()
    assert table.title == "difference to PyTorch"
    assert table.caption == "largest: 0.75, openvino, error_m at 8x8; within the 1 allowed"


def test_other_outputs_than_the_references_are_refused():
    with pytest.raises(ValueError, match="openvino gives the outputs depth_m, but torch depth_m,"):
        check_parity(REFERENCE, [FixedEngine("openvino", depth_m=[0.0] * 3)], CASES)
    engine = FixedEngine("openvino", depth_m=[0.0] * 2, error_m=[0.0])
    with pytest.raises(ValueError, match=r"openvino's depth_m has the shape \(2,\), expected"):
        check_parity(REFERENCE, [engine], CASES)


def test_nothing_to_compare_is_refused():
    with pytest.raises(ValueError, match="at least one engine and one input"):
        check_parity(REFERENCE, [], CASES)
    with pytest.raises(ValueError, match="at least one engine and one input"):
        check_parity(REFERENCE, [REFERENCE], {})


def test_real_engines_agree_at_two_sizes_and_the_table_tells_so(onnx_file, openvino_file):
    reference = TorchEngine(toy_network(), ("image", "sparse_depth_m"), metadata=METADATA)
    cases = {"16x24": toy_inputs(16, 24), "40x32": toy_inputs(40, 32)}
    engines = [open_engine(onnx_file), open_engine(openvino_file)]
    report = check_parity(reference, engines, cases, unit="mm", scale=1e3)
    assert report.is_within(1.0)
    console = Console(width=100, record=True, file=None)
    with console.capture() as capture:
        console.print(report.table())
    for text in ("difference to PyTorch, mm", "onnxruntime", "openvino", "16x24", "e_point_m"):
        assert text in capture.get()


def test_outputs_that_hold_nothing_are_the_same():
    nothing = FixedEngine("torch", boxes=[])
    assert check_parity(nothing, [nothing], CASES).is_within(0.0)
