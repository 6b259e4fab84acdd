import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torchmetrics.functional.classification import binary_auroc

from sightline.evaluation.auroc import auroc, auroc_of_values
from tests.reference import auroc as reference

counts = st.lists(st.integers(0, 4), min_size=1, max_size=6)
values = st.lists(st.sampled_from([0.0, 0.1, 0.25, 0.5, 1.0]), max_size=12)  # ties are common


@given(both=counts.flatmap(lambda first: st.tuples(st.just(first), st.lists(
    st.integers(0, 4), min_size=len(first), max_size=len(first)))))  # fmt: skip
def test_counts_at_levels_give_what_comparing_every_pair_gives(both):
    positives, negatives = (np.array(each, dtype=np.int64) for each in both)
    groups = [np.repeat(np.arange(len(each)), each).tolist() for each in (positives, negatives)]
    assert auroc(positives, negatives) == pytest.approx(reference.auroc(*groups))


@given(positives=values, negatives=values)
def test_values_give_what_comparing_every_pair_gives(positives, negatives):
    found = auroc_of_values(np.array(positives, dtype=float), np.array(negatives, dtype=float))
    assert found == pytest.approx(reference.auroc(positives, negatives))


def test_it_is_that_of_torchmetrics():
    rng = np.random.default_rng(0)
    positives, negatives = rng.normal(0.4, 1, 300).round(1), rng.normal(0, 1, 500).round(1)
    scores = torch.from_numpy(np.concatenate((positives, negatives))).sigmoid()
    truth = torch.cat((torch.ones(300), torch.zeros(500))).long()
    assert auroc_of_values(positives, negatives) == pytest.approx(
        float(binary_auroc(scores, truth)), abs=1e-6
    )


def test_groups_of_many_millions_do_not_overflow():
    positives, negatives = np.array([0, 2**31 - 1]), np.array([2**31 - 1, 0])
    assert auroc(positives, negatives) == 1.0
    assert auroc(negatives, positives) == 0.0
