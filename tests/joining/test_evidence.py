import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.joining.evidence import (
    IMAGE_COLUMNS,
    SWEEP_COLUMNS,
    gather_evidence,
    image_iou,
    logit,
)
from tests.joining.scenes import flat_scene
from tests.reference import joining as reference

whole = st.integers(0, 4)
corners = st.tuples(whole, whole, whole, whole).map(
    lambda c: (min(c[0], c[2]), min(c[1], c[3]), max(c[0], c[2]), max(c[1], c[3]))
)
boxes = st.lists(
    st.tuples(st.sampled_from(["Car", "Cyclist"]), st.sampled_from([0.25, 0.5, 0.75]), corners),
    max_size=5,
)


@given(sweep=boxes, image=boxes)
def test_evidence_of_the_other_detector_is_what_loops_find(sweep, image):
    evidence = gather_evidence(flat_scene(sweep, image))
    assert evidence.sweep.shape == (len(sweep), len(SWEEP_COLUMNS))
    assert evidence.image.shape == (len(image), len(IMAGE_COLUMNS))
    for rows, columns, own, others in (
        (evidence.sweep, SWEEP_COLUMNS, sweep, image),
        (evidence.image, IMAGE_COLUMNS, image, sweep),
    ):
        value = columns.index("IoU times that score")
        other = next(i for i, name in enumerate(columns) if "another class" in name)
        for row, (name, score, box) in zip(rows, own, strict=True):
            overlap, best = reference.best_partner(box, name, others, same=True)
            assert row[0] == pytest.approx(logit(score))
            assert row[value] == pytest.approx(overlap * best)
            overlap, best = reference.best_partner(box, name, others, same=False)
            assert row[other] == pytest.approx(overlap * best)


def test_a_box_outside_the_image_overlaps_nothing():
    outside = np.full((1, 4), np.nan)
    assert image_iou(outside, np.array([[0.0, 0.0, 9.0, 9.0]])).tolist() == [[0.0]]
    car = ("Car", 0.5, (math.nan,) * 4)
    evidence = gather_evidence(flat_scene([car], [("Car", 0.5, (0, 0, 9, 9))]))
    assert np.isfinite(evidence.sweep).all()
    assert evidence.image[0, IMAGE_COLUMNS.index("IoU times that score")] == 0


def test_logits_are_limited():
    assert logit(np.array([0.0, 0.5, 1.0])).tolist() == [
        pytest.approx(-6.9068, abs=1e-4),
        0.0,
        pytest.approx(6.9068, abs=1e-4),
    ]
