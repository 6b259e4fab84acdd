import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.propagation import propagate
from tests.reference import propagation as reference


def maps(seed, channels, height, width):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(1, channels, height, width, dtype=torch.float64, generator=generator)


@given(
    seed=st.integers(0, 2**31),
    height=st.integers(1, 5),
    width=st.integers(1, 5),
    steps=st.integers(0, 3),
)
def test_propagation_mixes_as_the_reference_does(seed, height, width, steps):
    depth_m = maps(seed, 1, height, width).exp() * 10
    affinity = maps(seed + 1, 8, height, width)
    confidence = maps(seed + 2, 1, height, width) * 4
    sparse_m = (maps(seed + 3, 1, height, width) * 10).relu()
    expected = reference.propagate(
        depth_m[0, 0].tolist(),
        affinity[0].tolist(),
        confidence[0, 0].tolist(),
        sparse_m[0, 0].tolist(),
        steps,
    )
    mixed = propagate(depth_m, affinity, confidence, sparse_m, steps=steps)
    torch.testing.assert_close(mixed[0, 0], torch.tensor(expected, dtype=torch.float64))


@given(seed=st.integers(0, 2**31), steps=st.integers(1, 4))
def test_an_even_map_stays_as_it_is(seed, steps):
    even_m = torch.full((1, 1, 4, 5), 12.5, dtype=torch.float64)
    affinity = maps(seed, 8, 4, 5) * 5
    confidence = maps(seed, 1, 4, 5)
    mixed = propagate(even_m, affinity, confidence, torch.zeros_like(even_m), steps=steps)
    assert torch.equal(mixed, even_m)


def test_logits_of_zero_change_no_pixel_without_a_measurement():
    depth_m = maps(0, 1, 6, 7).exp()
    sparse_m = torch.zeros_like(depth_m)
    sparse_m[..., 3, 3] = 40
    zero = torch.zeros_like(depth_m)
    mixed = propagate(depth_m, zero.expand(-1, 8, -1, -1), zero, sparse_m, steps=2)
    assert torch.equal(mixed == depth_m, sparse_m == 0)


@pytest.mark.parametrize(("logit", "kept"), [(-20.0, 0.0), (20.0, 1.0)])
def test_confidence_says_how_far_a_measurement_is_believed(logit, kept):
    depth_m = torch.full((1, 1, 3, 3), 10.0)
    sparse_m = torch.full((1, 1, 3, 3), 20.0)
    confidence = torch.full((1, 1, 3, 3), logit)
    mixed = propagate(depth_m, torch.zeros(1, 8, 3, 3), confidence, sparse_m, steps=1)
    torch.testing.assert_close(mixed, depth_m + kept * (sparse_m - depth_m))
