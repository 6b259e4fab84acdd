"""Test-time augmentation by mirrored frames."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.mirrored_prediction import predict_with_mirror
from sightline.depth_completion.model import DepthCompletionNet
from tests.depth_completion.networks import tiny_config


def by_column(inputs):
    """Prediction in which left and right differ."""
    sparse = inputs["sparse_depth_m"]
    columns = torch.arange(sparse.shape[-1], dtype=torch.float32)
    return {"depth_m": sparse * columns, "uncertainty_m": sparse + columns}


@given(seed=st.integers(0, 10**6), height=st.integers(1, 4), width=st.integers(1, 9))
def test_it_is_the_mean_of_both_answers(seed, height, width):
    sparse = torch.rand(1, 1, height, width, generator=torch.Generator().manual_seed(seed))
    prediction = predict_with_mirror(by_column, {"sparse_depth_m": sparse})
    for row in range(height):
        for column in range(width):
            value, mean = float(sparse[0, 0, row, column]), (column + width - 1 - column) / 2
            for name, expected in (("depth_m", value * mean), ("uncertainty_m", value + mean)):
                found = float(prediction[name][0, 0, row, column])
                assert math.isclose(found, expected, rel_tol=1e-5, abs_tol=1e-6)


def test_a_mirrored_frame_gives_the_mirrored_answer():
    generator = torch.Generator().manual_seed(0)
    network = DepthCompletionNet(tiny_config(filled_input=True, residual=True)).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn(parameter.shape, generator=generator))
    sizes = {"image": 3, "sparse_depth_m": 1, "filled_depth_m": 1}
    inputs = {
        name: torch.rand(1, planes, 8, 12, generator=generator) for name, planes in sizes.items()
    }

    def run(tensors):
        return {"depth_m": network(**tensors).depth_m}

    prediction = predict_with_mirror(run, inputs)["depth_m"]
    mirrored = predict_with_mirror(run, {name: each.flip(3) for name, each in inputs.items()})
    torch.testing.assert_close(mirrored["depth_m"].flip(3), prediction)
    assert not torch.allclose(run(inputs)["depth_m"], prediction)


def test_what_is_not_finite_stays_so_without_a_warning():
    endless = torch.tensor([[[[math.inf, 1.0, -math.inf, 3e38]]]])
    prediction = predict_with_mirror(lambda _: {"depth_m": endless}, {"image": endless})["depth_m"]
    assert not prediction[..., [0, 3]].isfinite().any()
