import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import DepthCompleter
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import load

NAMES = ("depth-fast-cpu", "detection2d-fast-cpu", "detection3d-fast-cpu")


@pytest.fixture(scope="module")
def samples():
    dataset = open_dataset(PACKAGED_FRAMES)
    return [dataset[0], dataset[1]]


@pytest.fixture(scope="module")
def predictors():
    networks = [load(name, engine="torch", threads=1) for name in NAMES]
    method = DepthCompleter("linear")
    return [*networks, method, MultiTaskPredictor({"depth-completion": method})]


def tensors_of(prediction):
    """All tensors of a prediction, nested ones included."""
    if isinstance(prediction, torch.Tensor):
        return [prediction]
    slots = [name for kind in type(prediction).__mro__ for name in getattr(kind, "__slots__", ())]
    parts = [
        getattr(prediction, name, None) for name in (*slots, *getattr(prediction, "__dict__", {}))
    ]
    return [tensor for part in parts if part is not prediction for tensor in tensors_of(part)]


def test_a_list_of_samples_gives_the_predictions_of_its_samples_in_order(predictors, samples):
    for predictor in predictors:
        predictions = predictor(samples)
        assert isinstance(predictions, list)
        for prediction, sample in zip(predictions, samples, strict=True):
            alone = tensors_of(predictor(sample))
            assert alone
            for one, other in zip(tensors_of(prediction), alone, strict=True):
                assert torch.equal(one, other)
        assert predictor([]) == []
        assert len(predictor(tuple(samples[:1]))) == 1


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.zeros((9, 4), np.float32), "got numpy.ndarray;"),
        (torch.zeros(9, 4), "got torch.Tensor;"),
        ("000000", "got str;"),
        (None, "got NoneType;"),
        ({"image": None}, "got dict;"),
        ([3], "got int at position 0 of the list;"),
    ],
)
def test_anything_but_a_sample_is_a_type_error_that_names_it(predictors, given, message):
    for predictor in predictors:
        with pytest.raises(TypeError, match=f"takes a CameraLidarSample or a list.*{message}"):
            predictor(given)


def test_a_sample_of_a_list_that_lacks_a_sensor_is_refused_by_its_name(predictors, samples):
    blind = replace(samples[1], points=None)
    with pytest.raises(ValueError, match=samples[1].sample_id):
        predictors[2]([samples[0], blind])


def test_predictions_do_not_depend_on_pytorchs_default_type_of_numbers(predictors, samples):
    expected = [tensors_of(predictor(samples[0])) for predictor in predictors[:3]]
    torch.set_default_dtype(torch.float64)
    try:
        loaded = [load(name, engine="torch", threads=1) for name in NAMES]
        sample = open_dataset(PACKAGED_FRAMES)[0]
        for predictor, tensors in zip(loaded, expected, strict=True):
            for one, other in zip(tensors_of(predictor(sample)), tensors, strict=True):
                assert one.dtype == other.dtype
                assert torch.equal(one, other)
        assert torch.get_default_dtype() == torch.float64
    finally:
        torch.set_default_dtype(torch.float32)


def test_several_arguments_are_refused_with_a_hint_at_lists(predictors, samples):
    with pytest.raises(TypeError, match=r"got 2 arguments; put .* predictor\(\[a, b\]\)"):
        predictors[0](*samples)


def test_predictions_do_not_depend_on_pytorchs_default_device(predictors, samples):
    torch.set_default_device("meta")
    try:
        loaded = load("depth-fast-cpu", engine="torch", threads=1)
        found = loaded(samples[0])
    finally:
        torch.set_default_device(None)
    assert torch.equal(found.depth_m, predictors[0](samples[0]).depth_m)


def test_a_predictor_that_was_used_can_be_used_in_a_forked_process(predictors, samples):
    torch.zeros(2000, 2000).exp().sum()  # in several threads, which a fork loses
    expected = predictors[0](samples[0]).depth_m
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)

    def send():
        sender.send(bool(torch.equal(predictors[0](samples[0]).depth_m, expected)))

    process = context.Process(target=send, daemon=True)
    process.start()
    try:
        assert receiver.poll(60), "the forked process sent no result"
        assert receiver.recv()
    finally:
        process.kill()
        process.join()


def test_tensors_without_values_or_with_gradients_are_refused_by_their_name(predictors, samples):
    sample = samples[0]
    for predictor in predictors:
        for changed, said in (
            (
                sample.points.clone().requires_grad_(),
                "requires gradients, .* give points.detach\\(\\)",
            ),
            (sample.points.to("meta"), "is on PyTorch's device meta and has no values; give data"),
        ):
            with pytest.raises(ValueError, match=f"points of sample 000000 {said}"):
                predictor([sample, replace(sample, points=changed)])
