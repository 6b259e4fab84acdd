"""Similarity of two streams' features, against the plain definition with centred Gram matrices."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.open import open_dataset
from sightline.detection2d.model import Detector
from sightline.papers.stream_similarity import LinearCka, stream_similarity
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection2d.frames import TINY
from tests.reference.linear_cka import linear_cka


def drawn(seed, pixels, channels):
    return torch.randn(pixels, channels, generator=torch.Generator().manual_seed(seed))


@given(
    seed=st.integers(0, 99),
    sizes=st.lists(st.integers(1, 7), min_size=1, max_size=3),
    channels=st.tuples(st.integers(1, 4), st.integers(1, 4)),
)
def test_the_sums_over_parts_give_the_plain_definition(seed, sizes, channels):
    parts = [
        [drawn(seed + n, size, count) + n for count in channels] for n, size in enumerate(sizes)
    ]
    alignment = LinearCka()
    for part in parts:
        alignment.add(*part)
    expected = linear_cka(*(np.concatenate(each) for each in zip(*parts, strict=True)))
    if expected is None:
        assert alignment.value() is None
    else:
        assert alignment.value() == pytest.approx(expected, abs=1e-6)


def test_turned_and_scaled_features_are_alike_and_others_are_not():
    features, turn = drawn(0, 500, 3), torch.linalg.qr(drawn(1, 3, 3))[0]
    for other, expected in ((7 * features @ turn + 2, 1.0), (drawn(2, 500, 3), 0.0)):
        alignment = LinearCka()
        alignment.add(features, other)
        assert alignment.value() == pytest.approx(expected, abs=0.05)


def test_features_that_never_change_have_no_similarity():
    assert LinearCka().value() is None
    alignment = LinearCka()
    alignment.add(torch.ones(4, 2), drawn(0, 4, 2))
    assert alignment.value() is None


def test_streams_with_the_same_weights_and_images_are_alike():
    torch.manual_seed(0)
    network = Detector(TINY).eval()
    dataset = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})
    similar = stream_similarity(network, [dataset[0]])
    network.streams["lidar"] = network.streams["camera"]
    network.planes = lambda given: {
        sensor: network.prepare.camera(given["image"]) for sensor in ("camera", "lidar")
    }
    alike = stream_similarity(network, [dataset[0]])
    assert alike[0] == pytest.approx(1.0)
    assert all(each is None or each == pytest.approx(1.0) for each in alike)
    assert similar[0] < 0.99
