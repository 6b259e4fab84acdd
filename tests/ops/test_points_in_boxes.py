"""Points in rotated boxes, and draws of them, by kernel and by plain PyTorch."""

import inspect
import math
from collections import Counter

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.points_in_boxes import first_box_of_points, first_by_torch
from sightline.ops.roi_points import choose_by_torch, roi_points
from tests.ops.clouds import as_batch, clouds, spread, street
from tests.reference import point_ops as reference

sizes = st.sampled_from([0.0, 1.0, 2.0, 40.0])
yaws = st.floats(-7, 7, width=32) | st.just(0.0)
boxes = st.tuples(spread, sizes, sizes, sizes, yaws).map(lambda b: (*b[0], *b[1:]))
box_lists = st.lists(boxes, max_size=4)


def require_no_point_on_a_face(points, boxes, margin=0.0):
    """Tolerate some digits at faces: cosines are rounded."""
    assume(
        all(
            box[6] == 0 or abs(reference.depth_in_box(point, box, margin)) > 1e-6
            for point in points
            for box in boxes
        )
    )


@given(points=clouds(), boxes=box_lists)
def test_each_point_is_given_to_the_first_box_that_holds_it(points, boxes):
    require_no_point_on_a_face(points, boxes)
    holding = [reference.points_in_box(points, box) for box in boxes]
    expected = [
        next((k for k, inside in enumerate(holding) if i in inside), -1) for i in range(len(points))
    ]
    cloud = as_batch(points)
    rows = torch.tensor(boxes).reshape(1, -1, 7)
    assert first_box_of_points(cloud, rows).tolist() == [expected]
    if boxes and points:
        by_torch = first_by_torch(cloud[0].double().T, rows[0].double())
        assert by_torch.tolist() == expected


def test_faces_belong_to_a_box_and_turned_ones_hold_what_boxes3d_says():
    cloud = torch.tensor([[[2.0, 0, 0], [2.001, 0, 0], [0, -1, 0.75], [0, -1, 0.751]]])
    assert first_box_of_points(cloud, torch.tensor([[[0.0, 0, 0, 4, 2, 1.5, 0]]])).tolist() == [
        [0, -1, 0, -1]
    ]
    scene = street(5, 3000).double()
    turned = torch.tensor([[20.0, 0, -1, 12, 6, 2, 0.7]], dtype=torch.float64)
    inside = first_box_of_points(scene, turned[None])[0] == 0
    assert 5 < inside.sum() < 2000
    assert torch.equal(inside, Boxes3D(turned).contain(scene[0])[0])


@given(
    points=clouds(max_size=20),
    boxes=box_lists,
    margin_m=st.sampled_from([0.0, 1.0]),
    count=st.integers(1, 9),
    seed=st.integers(0, 2**31 - 1),
)
def test_exactly_so_many_points_are_drawn_as_the_rule_says(points, boxes, margin_m, count, seed):
    require_no_point_on_a_face(points, boxes, margin_m)
    cloud, rows = as_batch(points), torch.tensor(boxes).reshape(1, -1, 7)
    drawn = roi_points(cloud, rows, margin_m=margin_m, count=count, seed=seed)
    for k, box in enumerate(boxes):
        inside = reference.points_in_box(points, box, margin_m)
        assert drawn.num_inside[0, k] == len(inside)
        assert drawn.indices[0, k].tolist() == reference.roi_points(inside, k, count, seed)
    if points:
        index, num_inside = choose_by_torch(
            cloud[0].double().T, rows[0].double(), margin_m, count, seed
        )
        assert torch.equal(index, drawn.indices[0])
        assert torch.equal(num_inside, drawn.num_inside[0])


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1])
def test_of_many_points_each_has_the_same_chance(seed):
    points, everywhere = torch.rand(1, 50, 3), torch.tensor([0.5, 0.5, 0.5, 2, 2, 2, 0])
    drawn = roi_points(points, everywhere.expand(1, 2000, 7), margin_m=0.0, count=20, seed=seed)
    times = Counter(drawn.indices.flatten().tolist())
    # 2000 draws at 0.4: a standard deviation of 22
    assert all(abs(times[point] - 800) < 100 for point in range(50))
    assert all(len(set(row)) == 20 for row in drawn.indices[0].tolist())


def test_of_few_points_each_stays_and_is_repeated_with_the_same_chance():
    points, everywhere = torch.rand(1, 4, 3), torch.tensor([0.5, 0.5, 0.5, 2, 2, 2, 0])
    drawn = roi_points(points, everywhere.expand(1, 500, 7), margin_m=0.0, count=12, seed=8)
    assert drawn.indices[0, :, :4].tolist() == [[0, 1, 2, 3]] * 500
    times = Counter(drawn.indices[0, :, 4:].flatten().tolist())
    assert all(abs(times[point] - 1000) < 140 for point in range(4))  # standard deviation 27


def test_the_same_seed_draws_the_same_and_another_one_does_not():
    scene, box = street(1, 2000), torch.tensor([[[10.0, 0, -1, 9, 9, 3, 0.3]]])
    first, again, other = (
        roi_points(scene, box, margin_m=1.0, count=32, seed=seed) for seed in (3, 3, 4)
    )
    assert first.num_inside.item() > 100
    assert torch.equal(first.indices, again.indices)
    assert not torch.equal(first.indices, other.indices)


def test_each_sweep_of_a_batch_has_points_and_boxes_of_its_own():
    scenes = torch.cat((street(0, 600), street(1, 600)))
    rows = torch.cat((scenes[:, :5], torch.full((2, 5, 4), 3.0)), dim=2)
    rows[1, 3:] = 0.0  # filled up
    both = roi_points(scenes, rows, margin_m=1.0, count=8, seed=0)
    assert both.num_inside[1].tolist()[3:] == [0, 0]
    for sweep in (0, 1):
        part = slice(sweep, sweep + 1)
        alone = roi_points(scenes[part], rows[part], margin_m=1.0, count=8, seed=0)
        assert torch.equal(both.indices[part], alone.indices)
        assert torch.equal(
            first_box_of_points(scenes[part], rows[part]), first_box_of_points(scenes, rows)[part]
        )


@pytest.mark.parametrize(("num_points", "num_boxes"), [(0, 0), (0, 2), (3, 0)])
def test_no_points_or_no_boxes_give_nothing(num_points, num_boxes):
    points, rows = torch.zeros(1, num_points, 3), torch.ones(1, num_boxes, 7)
    assert first_box_of_points(points, rows).shape == (1, num_points)
    drawn = roi_points(points, rows, margin_m=1.0, count=4, seed=0)
    assert drawn.indices.shape == (1, num_boxes, 4)
    assert drawn.num_inside.tolist() == [[0] * num_boxes]


def test_what_is_out_of_range_is_refused():
    points, rows = torch.zeros(1, 4, 3), torch.ones(1, 2, 7)
    with pytest.raises(ValueError, match="margin_m must be finite and not negative, got -1"):
        roi_points(points, rows, margin_m=-1.0, count=4, seed=0)
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        roi_points(points, rows, margin_m=1.0, count=0, seed=0)
    for seed in (-1, 2**31):
        with pytest.raises(ValueError, match=f"seed must be from 0 to 2147483647, got {seed}"):
            roi_points(points, rows, margin_m=1.0, count=4, seed=seed)
    for column, value in ((0, math.nan), (6, math.inf), (4, -0.1), (2, 2e9)):
        bad = rows.clone()
        bad[0, 1, column] = value
        with pytest.raises(ValueError, match=r"^boxes\[0, 1\] is .* sizes not negative"):
            first_box_of_points(points, bad)
    with pytest.raises(ValueError, match=r"^points\[0, 2\] is .* must be finite"):
        first_box_of_points(points.index_fill(1, torch.tensor([2]), math.nan), rows)
    with pytest.raises(ValueError, match=r"boxes must be .* got torch.float32 of shape \(1, 2, 5"):
        inspect.unwrap(first_box_of_points)(points, rows[..., :5])
    with pytest.raises(ValueError, match="batch sizes differ: points 1, boxes 2"):
        inspect.unwrap(first_box_of_points)(points, rows.expand(2, -1, -1))
