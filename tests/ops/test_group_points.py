"""Grouping and its gradient, against loops."""

import inspect

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.group_points import group_points


@given(seed=st.integers(0, 99), points=st.integers(1, 6), shape=st.sampled_from([(), (3,), (2, 4)]))
def test_features_and_their_gradients_go_where_the_index_says(seed, points, shape):
    generator = torch.Generator().manual_seed(seed)
    features = torch.rand(2, points, 5, generator=generator).requires_grad_()
    index = torch.randint(points, (2, *shape), generator=generator)
    weight = torch.rand(2, *shape, 5, generator=generator)
    grouped = group_points(features, index)
    (grouped * weight).sum().backward()
    expected = torch.zeros(2, points, 5)
    for sweep in range(2):
        chosen = index[sweep].reshape(-1).tolist()
        rows, weights = grouped[sweep].reshape(-1, 5), weight[sweep].reshape(-1, 5)
        for row, factor, point in zip(rows, weights, chosen, strict=True):
            assert torch.equal(row, features[sweep, point])
            expected[sweep, point] += factor
    torch.testing.assert_close(features.grad, expected)


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16])
def test_other_precisions_stay_as_they_are(dtype):
    features = torch.rand(1, 4, 3).to(dtype).requires_grad_()
    grouped = group_points(features, torch.tensor([[2, 2, 0]]))
    assert grouped.dtype == dtype
    assert torch.equal(grouped[0], features[0, [2, 2, 0]])
    grouped.sum().backward()
    assert features.grad[0, :, 0].tolist() == [1, 0, 2, 0]


def test_gradients_equal_finite_differences():
    features = torch.rand(2, 4, 3, dtype=torch.float64, requires_grad=True)
    index = torch.tensor([[[0, 3], [3, 3]], [[1, 1], [2, 0]]])
    assert torch.autograd.gradcheck(lambda values: group_points(values, index), features)


def test_columns_of_a_larger_tensor_are_read_as_they_are():
    table = torch.rand(1, 6, 9)
    view, index = table[:, ::2, 1:8:2], torch.tensor([[2, 0]])
    assert torch.equal(group_points(view, index), group_points(view.clone(), index))


def test_no_index_gives_nothing_and_a_wrong_one_is_refused():
    features = torch.rand(2, 4, 3, requires_grad=True)
    none = group_points(features, torch.zeros(2, 0, 5, dtype=torch.int64))
    assert none.shape == (2, 0, 5, 3)
    none.sum().backward()
    assert torch.equal(features.grad, torch.zeros(2, 4, 3))
    for wrong in (-1, 4):
        with pytest.raises(ValueError, match="index must be from 0 to 3, the points of a sweep"):
            group_points(features, torch.tensor([[0], [wrong]]))
    with pytest.raises(ValueError, match="batch sizes differ: features 2, index 1"):
        inspect.unwrap(group_points)(features, torch.tensor([[0]]))


@pytest.mark.parametrize(
    ("features", "index", "message"),
    [
        (
            torch.rand(4, 3),
            torch.tensor([[0]]),
            r"features must .* got torch.float32 of shape \(4, 3\)",
        ),
        (
            torch.ones(1, 4, 3, dtype=torch.int64),
            torch.tensor([[0]]),
            "features must .* got torch.int64",
        ),
        (torch.rand(1, 4, 3), torch.tensor([[True]]), "index must .* whole numbers .* torch.bool"),
        (torch.rand(1, 4, 3), torch.tensor(1), r"index must .* of shape \(\)"),
    ],
)
def test_what_is_no_features_or_no_index_is_refused(features, index, message):
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(group_points)(features, index)


def test_points_without_features_give_none():
    features = torch.rand(2, 4, 0, requires_grad=True)
    grouped = group_points(features, torch.zeros(2, 3, dtype=torch.int64))
    assert grouped.shape == (2, 3, 0)
    grouped.sum().backward()
    assert features.grad.shape == (2, 4, 0)
