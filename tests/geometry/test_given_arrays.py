import numpy as np
import pytest
import torch

from sightline.geometry.given_arrays import given_array
from sightline.geometry.plain_arrays import without_masked


@pytest.mark.parametrize(
    "given",
    [
        [[1, 2], [3, 4]],
        np.array([[1, 2], [3, 4]], ">f8"),
        np.ma.masked_array([[1, 2], [3, 4]], mask=False),
        torch.tensor([[1.0, 2], [3, 4]], requires_grad=True),
        torch.tensor([[1.0, 2], [3, 4]]).to_sparse(),
    ],
)
def test_arrays_tensors_and_lists_give_their_numbers(given):
    assert given_array("it", given).tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.ma.masked_array([1, 2, 3], [0, 1, 0]), "it has 1 of 3 values masked, .*; fill them"),
        (torch.empty(3, device="meta"), "it is a tensor on the device meta, .* no values; give"),
        (
            torch.ones(3).to(torch.float8_e5m2),
            r"it is a tensor of torch.float8_e5m2, .*\.float\(\)",
        ),
        ([[1], [2, 3]], "it is .*, expected an array; give rows of one length"),
    ],
)
def test_what_has_no_values_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        given_array("it", given)


def test_masked_numbers_are_filled_and_nothing_else_changes():
    masked = np.ma.masked_array([1, 2, 3], [0, 1, 0])
    assert without_masked(masked, 0.0).tolist() == [1, 0, 3]
    assert np.isnan(without_masked(masked)[1])
    assert without_masked("x") == "x"


def test_points_in_bfloat16_are_doubted_and_images_are_not():
    numbers = torch.tensor([[60.1, 2.0, 3.0]]).bfloat16()
    with pytest.warns(UserWarning, match=r"the points are bfloat16, .*steps of 0\.25 m; give"):
        given_array("the points", numbers)
    assert given_array("the image", torch.arange(256).bfloat16()).tolist() == list(range(256))
