"""Errors of a task's own code name their samples, and none is taken for the end of a loop."""

import re
import traceback
from dataclasses import replace

import pytest
import torch

from sightline.training.command import run_training
from sightline.training.own_code import EndingError
from tests.training import toy

PREPARATION = "--data.preparation.class_path=tests.training.test_own_code.Faulty"
MODEL = "--model.class_path=tests.training.test_own_code.FaultyModule"


def fail(kind):
    """Raise an error, as own code does by mistake."""
    if kind == "stop":
        next(name for name in ("Car",) if name == "Cyclist")
    if kind == "exit":
        raise SystemExit(3)
    if kind == "tensor":
        torch.zeros(2) + torch.zeros(3)
    if kind == "key":
        raise KeyError("cls")
    if kind == "nan":
        return float("nan")
    if kind == "value":
        raise ValueError("boxes lie behind the camera")
    return 1.0


class Faulty(toy.ToyPreparation):
    """Preparation that fails for one sample."""

    def __init__(self, kind: str = "stop", place: str = "prepare", use: str = "training"):
        super().__init__()
        self.kind, self.place, self.use = kind, place, use

    def prepare(self, sample, rng, *, training):
        batch = super().prepare(sample, rng, training=training)
        is_used = training == (self.use == "training")
        if sample.sample_id == "000005" and is_used and self.place == "prepare":
            return replace(batch, image=batch.image * fail(self.kind))
        return batch

    def for_update(self, rng):
        del rng
        if self.place == "for_update":
            fail(self.kind)
        return self

    def collate(self, prepared):
        if self.place == "collate" and any("000005" in each.sample_ids for each in prepared):
            fail(self.kind)
        return super().collate(prepared)


class FaultyModule(toy.ToyModule):
    """Module that fails in one of its methods."""

    def __init__(self, place: str = "losses", kind: str = "stop", sample: str = "000005"):
        super().__init__()
        self.place, self.kind, self.sample = place, kind, sample

    def losses(self, batch):
        losses = super().losses(batch)
        if self.place == "losses" and self.sample in batch.sample_ids:
            return losses._replace(total=losses.total * fail(self.kind))
        return losses

    def score(self, batch):
        if self.place == "score" and self.sample in batch.sample_ids:
            fail(self.kind)
        return super().score(batch)

    def picture(self, batch, prediction):
        del batch, prediction
        if self.place == "picture":
            fail(self.kind)

    def scores(self):
        if self.place == "scores":
            fail(self.kind)
        return super().scores()


def shown(recipes, error, *arguments):
    """Text of the error of a training, as Python prints it."""
    with pytest.raises(error) as raised:
        run_training("fit", ["--config", "toy", *arguments], recipes)
    return "".join(traceback.format_exception(raised.value))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks, threads around
@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize(
    ("kind", "error", "cause"),
    [
        ("stop", EndingError, "the code raises StopIteration()"),
        ("exit", EndingError, r"the code raises SystemExit(3)"),
        ("tensor", RuntimeError, "The size of tensor a (2) must match"),
        ("key", KeyError, "cls"),
        ("value", ValueError, "sample 000005: boxes lie behind the camera"),
    ],
)
def test_an_error_of_own_preparation_ends_the_training_with_its_sample_and_cause(
    recipes, workers, kind, error, cause
):
    given = [PREPARATION, f"--data.preparation.kind={kind}", f"--data.workers={workers}"]
    text = shown(recipes, error, *given)
    assert cause in text
    assert "sample 000005" in text
    assert "workers 0" not in text
    if kind != "value":
        assert "in fail" in text


@pytest.mark.parametrize("use", ["training", "validation"])
@pytest.mark.parametrize("place", ["prepare", "for_update", "collate"])
def test_no_step_of_own_preparation_is_taken_for_the_end_of_an_epoch(recipes, place, use):
    given = [
        f"--data.preparation.{name}={value}" for name, value in (("place", place), ("use", use))
    ]
    assert "EndingError: sample" in shown(recipes, EndingError, PREPARATION, *given)


@pytest.mark.parametrize("kind", ["stop", "tensor"])
@pytest.mark.parametrize("place", ["losses", "score", "picture", "scores"])
def test_no_method_of_an_own_module_is_taken_for_the_end_of_an_epoch(recipes, place, kind):
    error = EndingError if kind == "stop" else RuntimeError
    text = shown(recipes, error, MODEL, f"--model.place={place}", f"--model.kind={kind}")
    assert ("sample 0" in text or "samples 0" in text) == (place != "scores")


def test_a_sample_that_is_not_finite_is_no_divergence(recipes):
    text = shown(recipes, ValueError, PREPARATION, "--data.preparation.kind=nan")
    assert "the batch holds NaN or infinity in image of sample 000005; correct the data" in text
    assert "learning_rate" not in text


@pytest.mark.parametrize(
    ("sample", "expected"),
    [
        ("000005", r"in step 0, with finite weights and a finite batch \(samples .*000005"),
        ("000001", r"diverged, .*learning_rate.*; if the loss of samples .*000001.* is nan before"),
    ],
    ids=["in the first step", "later"],
)
def test_losses_that_are_not_finite_for_some_samples_are_told_with_them(recipes, sample, expected):
    given = [MODEL, "--model.kind=nan", f"--model.sample={sample}"]
    with pytest.raises(ValueError, match=expected) as raised:
        run_training("fit", ["--config", "toy", *given], recipes)
    assert ("learning_rate" in str(raised.value)) == (sample == "000001")


class Texts(toy.ToyPreparation):
    """Preparation that gives one text in place of several."""

    def learned_classes(self):
        return "Car"


class PartText(toy.ToyPreparation):
    parts = "image"


class NoteText(toy.ToyModule):
    def score_notes(self):
        return "few frames"


class BesideText(toy.ToyModule):
    monitored_beside = "validation/mse"


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("Texts", "Texts.learned_classes() is the text 'Car', expected a tuple; give ('Car',)"),
        ("PartText", "PartText.parts is the text 'image', expected a tuple; give ('image',)"),
        ("NoteText", "NoteText.score_notes() is the text 'few frames', expected a tuple"),
        ("BesideText", "BesideText.monitored_beside is the text 'validation/mse', expected"),
    ],
)
def test_a_text_in_place_of_several_is_not_taken_by_its_letters(recipes, kind, told):
    place = "model" if issubclass(globals()[kind], toy.ToyModule) else "data.preparation"
    given = ["--config", "toy", f"--{place}.class_path=tests.training.test_own_code.{kind}"]
    with pytest.raises(ValueError, match=re.escape(told)):
        run_training("fit", given, recipes)
