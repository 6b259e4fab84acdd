import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.fitting import FitFrame, fit_logistic, fit_models
from sightline.joining.models import CLASSES, COLUMNS
from sightline.structures.labels import ObjectLabels
from tests.joining.scenes import detections2d, detections3d, make_sample


def loss_of(values, evidence, target):
    """Cross-entropy with the penalty, in a loop."""
    mean, scale = evidence.mean(axis=0), evidence.std(axis=0)
    total = float(10 * np.square(values[:-1]).sum() / 2)
    for row, share in zip((evidence - mean) / scale, target, strict=True):
        score = 1 / (1 + np.exp(-(row @ values[:-1] + values[-1])))
        total -= share * np.log(score) + (1 - share) * np.log(1 - score)
    return total


@settings(max_examples=15)
@given(seed=st.integers(0, 1000))
def test_no_other_weights_have_a_smaller_loss(seed):
    rng = np.random.default_rng(seed)
    evidence, target = rng.normal(2, 3, (30, 2)), rng.uniform(size=30)
    model = fit_logistic(evidence, target)
    weights = np.array(model.weights) * evidence.std(axis=0)
    bias = model.bias + np.array(model.weights) @ evidence.mean(axis=0)
    best = np.append(weights, bias)
    for _ in range(10):
        other = best + rng.normal(0, 0.1, 3)
        assert loss_of(best, evidence, target) < loss_of(other, evidence, target)


def test_scores_of_constant_evidence_are_the_share_of_right_boxes():
    model = fit_logistic(np.ones((8, 1)), np.array([1.0] * 6 + [0.0] * 2))
    assert model.score(np.ones((1, 1)))[0] == pytest.approx(0.75, abs=1e-4)


PLACES = [(name, 0.9, 12.0 + 5 * i, 6.0 * i - 6, -0.95, 4, 1.8, 1.5, 0) for i, name in
          enumerate(CLASSES)]  # fmt: skip
IMAGE_BOXES = [(name, 0.8, (100.0 + 200 * i, 180.0, 160.0 + 200 * i, 240.0))
               for i, name in enumerate(CLASSES)]  # fmt: skip


def labelled(boxes3d, boxes2d):
    names = tuple(name for name, *_ in boxes3d)
    count = len(names)
    return ObjectLabels(
        class_names=names,
        boxes2d=Boxes2D(torch.tensor([corners for _, _, corners in boxes2d]).double()),
        boxes3d=Boxes3D(torch.tensor([numbers for _, _, *numbers in boxes3d]).double()),
        truncation=torch.zeros(count).double(),
        occlusion=torch.zeros(count).long(),
        alpha=torch.zeros(count).double(),
    )


def frames():
    """Frames with right detections of high and wrong ones of low score."""
    labels = labelled(PLACES, IMAGE_BOXES)
    wrong = [(name, 0.2, x, y + 15, *rest) for name, _, x, y, *rest in PLACES]
    wrong_seen = [(name, 0.2, (x0, 10.0, x1, 60.0)) for name, _, (x0, _, x1, _) in IMAGE_BOXES]
    return [
        FitFrame(
            sample=make_sample(points, objects=labels),
            found2d=detections2d(*IMAGE_BOXES, *wrong_seen),
            found3d=None if points is None else detections3d(*PLACES, *wrong),
        )
        for points in ([10.0, 0, -1.7, 0.5], None)
    ] * 3


def test_models_of_all_kinds_and_classes_score_right_boxes_higher_and_again_equally():
    models = fit_models(frames(), {"seed": "none"})
    assert models == fit_models(frames(), {"seed": "none"})
    for kind in ("sweep", "image", "alone"):
        for name in CLASSES:
            model = getattr(models, kind)[name]
            assert len(model.weights) == len(COLUMNS[kind])
            assert model.weights[0] > 0
    assert models.provenance == {"seed": "none"}


def test_boxes_on_look_alikes_and_in_areas_without_labels_are_left_out():
    vans = dataclasses.replace(
        labelled(PLACES, IMAGE_BOXES), class_names=("Van", "Pedestrian", "Cyclist")
    )
    frame = FitFrame(sample=make_sample(objects=vans), found2d=None, found3d=detections3d(*PLACES))
    with pytest.raises(
        ValueError, match=r"no box of Car, Pedestrian \(image, .*\) fits a label, so no"
    ):
        fit_models([frame], {})


def test_a_frame_without_labels_is_refused():
    with pytest.raises(ValueError, match="sample 000000 has no labels"):
        fit_models([FitFrame(sample=make_sample(), found2d=None, found3d=None)], {})
