"""Reused memory, which is never reused while referenced."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from sightline.ops import spare_memory
from sightline.ops.group_points import group_points
from sightline.ops.spare_memory import rows_to_fill

MANY = torch.zeros(1, 200_000, dtype=torch.int64)  # of 8 channels: 6.4 MB


def address(tensor):
    return tensor.untyped_storage().data_ptr()


def test_a_large_result_takes_the_memory_of_one_that_is_gone():
    spare_memory._spare.clear()
    first = group_points(torch.rand(1, 3, 8), MANY)
    place = address(first)
    del first
    second = group_points(torch.full((1, 3, 8), 7.0), MANY)
    assert address(second) == place
    assert (second == 7).all()


def test_results_that_are_still_in_use_keep_theirs_also_by_a_part():
    spare_memory._spare.clear()
    first = group_points(torch.full((1, 3, 8), 1.0), MANY)
    part = first[0, 5:7].numpy()
    place = address(first)
    del first
    others = [group_points(torch.full((1, 3, 8), 2.0), MANY) for _ in range(3)]
    assert place not in map(address, others)
    assert (part == 1).all()
    del part
    assert address(group_points(torch.full((1, 3, 8), 3.0), MANY)) == place
    assert all((other == 2).all() for other in others)


def test_results_that_gradients_need_are_not_overwritten():
    spare_memory._spare.clear()
    features = torch.rand(1, 3, 8, dtype=torch.float64, requires_grad=True)
    squared = group_points(features, MANY).square()  # keeps its input for the gradient
    for _ in range(3):
        group_points(torch.full((1, 3, 8), 9.0).double(), MANY)
    squared.sum().backward()
    torch.testing.assert_close(features.grad[0, 0], 400_000 * features.detach()[0, 0])


def test_the_larger_of_two_blocks_is_kept_and_no_more_than_one():
    spare_memory._spare.clear()
    small, large = (rows_to_fill(count, 4, np.dtype(np.float32)) for count in (300_000, 600_000))
    del small, large
    assert [block.nbytes for block in spare_memory._spare] == [600_000 * 16]
    again = rows_to_fill(300_000, 4, np.dtype(np.float32))
    assert again.shape == (300_000, 4)
    assert not spare_memory._spare


def test_small_and_huge_results_are_not_kept():
    spare_memory._spare.clear()
    for count in (10, 20_000_000):
        rows_to_fill(count, 4, np.dtype(np.float32))
    assert not spare_memory._spare


def test_a_result_that_is_kept_does_not_hold_a_far_larger_block():
    spare_memory._spare.clear()
    large = rows_to_fill(2_000_000, 4, np.dtype(np.float32))
    del large
    kept = rows_to_fill(300_000, 4, np.dtype(np.float32))
    assert [block.nbytes for block in spare_memory._spare] == [2_000_000 * 16]
    assert kept.shape == (300_000, 4)


def test_a_part_of_an_array_keeps_its_memory():
    spare_memory._spare.clear()
    rows = rows_to_fill(300_000, 4, np.dtype(np.float32))
    rows[:] = 1
    part = rows[10:20].T[2]
    del rows
    other = rows_to_fill(300_000, 4, np.dtype(np.float32))
    other[:] = 2
    assert (part == 1).all()


def test_threads_never_share_a_block():
    spare_memory._spare.clear()

    def many(value):
        for _ in range(10):
            result = group_points(torch.full((1, 3, 8), value), MANY)
            again = group_points(torch.full((1, 3, 8), value + 0.5), MANY)
            if not (bool((result == value).all()) and bool((again == value + 0.5).all())):
                return False
        return True

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(many, [1.0, 2.0, 3.0, 4.0]))
    assert len(spare_memory._spare) <= 1
