"""Predictors and writers of a user's own, with mistakes."""

import traceback
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import torch

from sightline.depth_completion.registration import TASK
from sightline.detection2d import registration as detection2d
from sightline.detection2d.predictor import DetectionResult
from sightline.detection3d import registration as detection3d
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.inference.predict import predict
from sightline.inference.predictor import check_predictor
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D
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


def in_millimetres(sample):
    return DepthMap(depth_m=sparse(sample).depth_m * 1000, valid=sparse(sample).valid)


def guessed_in_millimetres(sample):
    depth_m = torch.full(sample.image_size, 12_000.0)
    return DepthMap(depth_m=depth_m, valid=depth_m < 0, guessed=depth_m > 0)


def of_an_infinite_sky(sample):
    depth_m = torch.full(sample.image_size, torch.inf)
    depth_m[-10:] = 5.0
    return DepthMap(depth_m=depth_m, valid=depth_m < 9)


def at_another_size(_sample):
    return DepthMap(depth_m=torch.ones(3, 4), valid=torch.ones(3, 4, dtype=torch.bool))


@pytest.mark.parametrize(
    ("function", "told"),
    [
        (in_millimetres, r"sample 000000: \d+ of \d+ depths are above 256 m, .* give metres"),
        (guessed_in_millimetres, r"(\d+) of \1 depths are above 256 m, .* give metres"),
        (of_an_infinite_sky, r"the first is inf m at row 0, .* use 0 for no value"),
        (at_another_size, r"000000.png is 3x4 \(height x width\), expected .*resize its maps"),
    ],
)
def test_depth_maps_of_other_units_or_sizes_are_refused(data, out, function, told):
    with pytest.raises(ValueError, match=told):
        write(data, out, function)
    assert not list(out.glob("*.png"))


@pytest.mark.parametrize("box", [(300.0, 300.0, 50.0, 50.0), (np.nan, 100.0, 200.0, 200.0)])
def test_image_boxes_without_sound_edges_are_refused(data, out, box):
    def detect(_sample):
        boxes = Boxes2D(torch.tensor([(10.0, 10.0, 20.0, 20.0), box]))
        found = Detections2D(
            class_names=("Car", "Car"), boxes=boxes, scores=torch.tensor([0.5, 0.9])
        )
        return DetectionResult(detections=found)

    predictor = FunctionPredictor(detect, gives=("detections2d",))
    told = "sample 000000: detection 1 of 2 has the box .*expected finite x_min, y_min"
    with pytest.raises(ValueError, match=told):
        predict(detection2d.TASK, predictor, data, out)


@pytest.mark.parametrize("size", [-4.0, 0.0, np.inf])
def test_boxes_in_3d_without_a_sound_size_are_refused(data, out, size):
    def detect(_sample):
        boxes = Boxes3D(torch.tensor([(20.0, 0.0, -1.0, size, 2.0, 1.5, 0.0)]))
        return Detections3D(class_names=("Car",), boxes=boxes, scores=torch.tensor([0.9]))

    predictor = FunctionPredictor(detect, gives=("detections3d",))
    told = "sample 000000: detection 0 of 1 has the box .*expected finite x, y, z, length, width"
    with pytest.raises(ValueError, match=told):
        predict(detection3d.TASK, predictor, data, out)


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


class Silent:
    """Callable without any declaration."""

    def __call__(self, sample):
        return sparse(sample)


@pytest.mark.parametrize(
    ("predictor", "told"),
    [
        (None, "the predictor is None, expected an object of sightline.inference.predictor"),
        (FunctionPredictor, "the predictor is the class FunctionPredictor, expected an object"),
        (sparse, "the predictor is the function sparse, expected an object of sightline.inference"),
        (FunctionPredictor(sparse).__call__, "the predictor is the function __call__, expected"),
        (Silent(), r"Silent, which lacks name, parts, needs, gives, made_by; give it all members"),
        ("nearest", "the predictor is of type str, which lacks name, parts, .*, __call__; give it"),
        (FunctionPredictor(sparse, made_by=None), r"made_by is of type NoneType, .* give \{\} for"),
        (FunctionPredictor(sparse, parts=None), "parts is of type NoneType, expected a tuple; giv"),
        (
            FunctionPredictor(sparse, made_by={"weights": Fraction(1)}),
            r"FunctionPredictor\.made_by\['weights'\] is of type fractions.Fraction, expected text",
        ),
        (FunctionPredictor(sparse, name=Fraction(1)), "name is of type fractions.Fraction"),
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


def test_kept_results_of_a_predictor_without_a_version_give_a_warning(data, out):
    write(data, out, made_by={})  # nothing is kept
    with pytest.warns(UserWarning, match=r"6 results .* made_by of sparse is empty, .*--overwrite"):
        write(data, out, made_by={})
    write(data, out, made_by={}, overwrite=True)
