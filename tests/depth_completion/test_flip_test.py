"""A network asked for a frame and for its mirror image."""

import math

import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.flip_test import answer_with_mirror
from sightline.depth_completion.model import DepthCompletionNet
from tests.depth_completion.networks import tiny_config


def corrected(inputs):
    """Corrects by the column, so that left and right differ, and leaves the first columns."""
    filled = inputs["filled_depth_m"]
    columns = torch.arange(filled.shape[-1], dtype=torch.float32)
    return {"depth_m": torch.where(columns < 2, filled, filled * (1 + columns / 10))}


@given(seed=st.integers(0, 10**6), height=st.integers(1, 4), width=st.integers(1, 9))
def test_it_is_the_mean_where_both_correct_and_else_the_completion(seed, height, width):
    generator = torch.Generator().manual_seed(seed)
    filled = 5 + 40 * torch.rand(1, 1, height, width, generator=generator)
    answer = answer_with_mirror(corrected, {"filled_depth_m": filled})["depth_m"]
    for row in range(height):
        for column in range(width):
            value, mirrored = float(filled[0, 0, row, column]), width - 1 - column
            first, second = (value * (1 + each / 10) for each in (column, mirrored))
            expected = value if min(column, mirrored) < 2 else (first + second) / 2
            assert math.isclose(answer[0, 0, row, column], expected, rel_tol=1e-5)


def test_without_a_completion_it_is_the_mean_of_all_outputs():
    sparse = torch.tensor([[[[1.0, 2.0, 6.0]]]])
    weights = torch.tensor([1.0, 2.0, 3.0])
    answer = answer_with_mirror(
        lambda given: dict.fromkeys(("depth_m", "other"), given["sparse_depth_m"] * weights),
        {"sparse_depth_m": sparse},
    )
    for each in answer.values():
        assert each.flatten().tolist() == [2.0, 4.0, 12.0]


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

    def run(given):
        return {"depth_m": network(**given).depth_m}

    answer = answer_with_mirror(run, inputs)["depth_m"]
    mirrored = answer_with_mirror(run, {name: each.flip(3) for name, each in inputs.items()})
    torch.testing.assert_close(mirrored["depth_m"].flip(3), answer)
    assert not torch.allclose(run(inputs)["depth_m"], answer)
