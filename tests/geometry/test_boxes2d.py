import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.boxes3d import Boxes3D
from tests.reference import geometry as reference

edges = st.integers(-8, 8)
boxes = st.lists(st.tuples(edges, edges, edges, edges), min_size=0, max_size=6)


@given(a=boxes, b=boxes)
def test_pairwise_overlap_equals_the_reference(a, b):
    tensor_a = torch.tensor(a, dtype=torch.float64).reshape(-1, 4)
    tensor_b = torch.tensor(b, dtype=torch.float64).reshape(-1, 4)
    overlaps = pairwise_iou2d(Boxes2D(tensor_a), Boxes2D(tensor_b))
    expected = [[reference.iou2d(box_a, box_b) for box_b in b] for box_a in a]
    assert overlaps.shape == (len(a), len(b))
    assert overlaps.tolist() == [pytest.approx(row) for row in expected]


@pytest.mark.parametrize("kind", [torch.float16, torch.bfloat16])
def test_boxes_of_half_precision_larger_than_its_largest_number_overlap(kind):
    large = Boxes2D(torch.tensor([[0.0, 0.0, 512.0, 512.0]], dtype=kind))
    assert large.area().tolist() == [512.0**2]
    assert pairwise_iou2d(large, large).tolist() == [[1.0]]


def test_convention_area_has_no_plus_one():
    assert Boxes2D(torch.tensor([[0.0, 0.0, 2.0, 3.0]])).area().tolist() == [6.0]


def test_clipping_keeps_the_box_within_the_pixel_centres():
    clipped = Boxes2D(torch.tensor([[-5.0, 3.0, 2000.0, 400.0]])).clip((375, 1242))
    assert clipped.tensor.tolist() == [[0.0, 3.0, 1241.0, 374.0]]


def test_a_resized_box_covers_the_same_part_of_the_picture():
    whole = Boxes2D(torch.tensor([[-0.5, -0.5, 99.5, 49.5], [9.5, 4.5, 10.5, 5.5]]))
    resized = whole.resize(3.0, 0.5)
    assert resized.tensor.tolist() == [[-0.5, -0.5, 299.5, 24.5], [29.5, 2.0, 32.5, 2.5]]


def test_boxes_are_chosen_by_mask_index_and_slice():
    three = Boxes2D(torch.arange(12.0).reshape(3, 4))
    assert three[torch.tensor([True, False, True])].tensor[:, 0].tolist() == [0.0, 8.0]
    assert three[torch.tensor([2, 0])].tensor[:, 0].tolist() == [8.0, 0.0]
    assert len(three[1:]) == 2


@pytest.mark.parametrize(("kind", "columns"), [(Boxes2D, 4), (Boxes3D, 7)])
def test_boxes_are_iterated_numbered_and_made_arrays_like_sequences(kind, columns):
    numbers = torch.arange(3.0 * columns).reshape(3, columns)
    three = kind(numbers)
    assert [box.tolist() for box in three] == numbers.tolist()
    assert three[-1] == three[np.int64(2)] == kind(numbers[2:])
    assert np.asarray(three).tolist() == numbers.tolist()
    assert np.array(three, dtype=np.float64).dtype == np.float64
    with pytest.raises(IndexError):
        three[3]
