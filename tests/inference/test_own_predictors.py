"""Predictors and writers of a user's own, with mistakes."""

import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sightline.depth_completion.registration import TASK
from sightline.inference.predictor import check_predictor
from tests.inference.function_predictor import FunctionPredictor, sparse, write


@pytest.mark.parametrize("kind", ["none", "other"])
def test_a_writer_that_leaves_no_file_of_the_given_name_is_told(data, out, kind, monkeypatch):
    def write_other(path, _sample, prediction):
        if kind == "other":
            np.save(path, prediction.depth_m.numpy())  # adds a suffix

    output = replace(TASK.outputs[0], write=write_other)
    monkeypatch.setattr(type(TASK), "outputs", (output,))
    message = f"sample 000000: the writer of the output {output.name} wrote no 000000.png; write e"
    with pytest.raises(ValueError, match=message):
        write(data, out)


def fail_in_the_third(sample):
    if sample.sample_id == "000002":
        raise KeyError("cls")
    return sparse(sample)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_an_own_predictors_code_names_its_frame(data, out, workers):
    with pytest.raises((KeyError, RuntimeError)) as raised:
        write(data, out, fail_in_the_third, workers=workers)
    text = "".join(traceback.format_exception(raised.value))
    assert "sample 000002" in text
    assert "in fail_in_the_third" in text
    assert "KeyError: 'cls'" in text


@pytest.mark.parametrize(
    ("predictor", "told"),
    [
        (None, "the predictor is None, expected an object of sightline.inference.predictor"),
        (FunctionPredictor, "the predictor is the class FunctionPredictor, expected an object"),
        (
            FunctionPredictor(sparse, made_by={"weights": Path("a")}),
            r"FunctionPredictor\.made_by\['weights'\] is of type pathlib.PosixPath, expected text",
        ),
        (FunctionPredictor(sparse, name=Path("a")), "Predictor.name is of type pathlib.PosixPath"),
        (FunctionPredictor(sparse, gives="depth"), r"gives is the text 'depth', .* \('depth',\)$"),
    ],
)
def test_a_predictor_that_declares_what_no_manifest_can_hold_is_refused(predictor, told):
    with pytest.raises(ValueError, match=told):
        check_predictor(predictor)


def test_what_predictors_declare_is_checked_before_any_work(data, out):
    with pytest.raises(ValueError, match=r"made_by\['x'\] is of type numpy.float32, expected text"):
        write(data, out, made_by={"x": np.float32(1)})
    assert not out.exists()
