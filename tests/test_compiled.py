"""What torch.compile and torch.export make of the project's own operators.

Runs by itself, without the shape checks of the other tests: their wrappers cannot be compiled.
Graphs are captured and differentiated, then run by torch: no C++ compiler is needed.
"""

from itertools import product

import pytest
import torch
from torch import library

from sightline.ops.ball_query import ball_query
from sightline.ops.farthest_points import farthest_points
from sightline.ops.group_points import group_points
from sightline.ops.interpolate_points import interpolate_points
from sightline.ops.nms import nms2d, nms_bev
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.ops.roi_points import roi_points
from sightline.ops.rotated_iou import aligned_iou_3d, pairwise_iou_3d, pairwise_iou_bev
from sightline.ops.three_nearest import three_nearest

BACKEND = "aot_eager"
BEV_COLUMNS = [0, 1, 3, 4, 6]

# PyTorch warns so on Python 3.13.0 alone, and warnings are errors here.
pytestmark = pytest.mark.filterwarnings("ignore:Guards may run slower:RuntimeWarning")


def some_boxes(seed: int, count: int) -> torch.Tensor:
    boxes = torch.randn(count, 7, generator=torch.Generator().manual_seed(seed))
    boxes[:, 3:6] = boxes[:, 3:6].abs() + 1
    return boxes


# ops


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor")  # opcheck looks at its copies
@pytest.mark.parametrize("name", ["pairwise_iou", "aligned_iou"])
@pytest.mark.parametrize("columns", [list(range(7)), BEV_COLUMNS])
def test_the_iou_operators_keep_their_contract_with_torch(name, columns):
    operator = getattr(torch.ops.sightline, name).default
    a, b = (some_boxes(seed, 5)[:, columns].requires_grad_() for seed in (0, 1))
    library.opcheck(operator, (a, b))
    library.opcheck(operator, (a.detach().double(), b.detach()[:5]))


@pytest.mark.parametrize("columns", [4, 5])
def test_the_suppression_operator_keeps_its_contract_with_torch(columns):
    boxes = torch.tensor([[0.0, 0, 2, 2, 1], [1, 0, 2, 2, 0], [3, 3, 4, 4, 0]])[:, :columns]
    scores, labels = torch.tensor([0.3, 0.9, 0.1]), torch.tensor([1, 1, 2])
    for classes, limit in product((None, labels), (None, 2)):
        library.opcheck(torch.ops.sightline.nms.default, (boxes, scores, classes, 0.2, limit))


@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor")  # opcheck looks at its copies
def test_the_operators_on_points_keep_their_contract_with_torch():
    points, boxes = torch.randn(2, 9, 3), torch.stack((some_boxes(0, 4), some_boxes(1, 4)))
    ops = torch.ops.sightline
    library.opcheck(ops.farthest_points.default, (points, 4))
    library.opcheck(ops.ball_query.default, (points, points[:, :3], 1.0, 2))
    library.opcheck(ops.three_nearest.default, (points, points[:, :3]))
    library.opcheck(ops.first_box_of_points.default, (points, boxes))
    library.opcheck(ops.roi_points.default, (points, boxes, 1.0, 5, 0))
    features, index = torch.randn(2, 9, 4, requires_grad=True), torch.tensor([[[0, 8, 8]]] * 2)
    library.opcheck(ops.group_points.default, (features, index))
    library.opcheck(ops.interpolate_points.default, (features, index, torch.rand(2, 1, 3)))


def test_a_compiled_set_abstraction_has_the_same_value_and_gradient():
    def abstract(points: torch.Tensor, features: torch.Tensor) -> torch.Tensor:
        chosen = farthest_points(points, 8)
        centers = group_points(points, chosen)
        near = ball_query(points, centers, radius_m=1.0, count=4)
        pooled = group_points(features, near.indices).amax(dim=2)
        return interpolate_points(pooled, three_nearest(centers, points)).square().sum()

    values, gradients = [], []
    points = torch.randn(2, 50, 3, generator=torch.Generator().manual_seed(0))
    for version in (abstract, torch.compile(abstract, fullgraph=True, backend=BACKEND)):
        features = points.repeat(1, 1, 2).requires_grad_()
        value = version(points, features)
        value.backward()
        values.append(value.detach())
        gradients.append(features.grad)
    torch.testing.assert_close(values[1], values[0])
    torch.testing.assert_close(gradients[1], gradients[0])
    assert gradients[0].abs().max() > 0


def test_compiled_region_pooling_gives_the_same():
    def pool(points: torch.Tensor, boxes: torch.Tensor) -> torch.Tensor:
        drawn = roi_points(points, boxes, margin_m=1.0, count=6, seed=2)
        label = first_box_of_points(points, boxes)[..., None].to(points.dtype)
        return group_points(torch.cat((points, label), dim=2), drawn.indices)

    points, boxes = torch.randn(1, 40, 3), some_boxes(8, 5)[None]
    compiled = torch.compile(pool, fullgraph=True, backend=BACKEND)
    assert torch.equal(compiled(points, boxes), pool(points, boxes))


@pytest.mark.parametrize("function", [pairwise_iou_3d, aligned_iou_3d])
def test_a_compiled_loss_of_ious_has_the_same_value_and_gradient(function):
    def loss(boxes: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        return (1 - function(boxes * 1.01, targets)).square().sum()

    values, gradients = [], []
    for version in (loss, torch.compile(loss, fullgraph=True, backend=BACKEND)):
        boxes = some_boxes(2, 8).requires_grad_()
        value = version(boxes, some_boxes(3, 8))
        value.backward()
        values.append(value.detach())
        gradients.append(boxes.grad)
    torch.testing.assert_close(values[1], values[0])
    torch.testing.assert_close(gradients[1], gradients[0])
    assert gradients[0].abs().max() > 0


def test_a_compiled_iou_serves_any_number_of_boxes_and_still_refuses_bad_ones():
    compiled = torch.compile(pairwise_iou_bev, fullgraph=True, backend=BACKEND, dynamic=True)
    for n, m in ((3, 4), (6, 2), (5, 5)):
        a, b = some_boxes(n, n)[:, BEV_COLUMNS], some_boxes(m, m)[:, BEV_COLUMNS]
        assert torch.equal(compiled(a, b), pairwise_iou_bev(a, b))
    with pytest.raises(ValueError, match=r"boxes_b\[0\] is \[nan"):
        compiled(torch.ones(3, 5), torch.full((3, 5), torch.nan))


@torch._dynamo.config.patch(capture_dynamic_output_shape_ops=True)
def test_compiled_suppression_gathers_the_boxes_that_stay():
    boxes, scores = some_boxes(4, 40)[:, BEV_COLUMNS], some_boxes(5, 40)[:, 0]

    def best(boxes: torch.Tensor, scores: torch.Tensor) -> torch.Tensor:
        return boxes[nms_bev(boxes, scores, 0.1, max_detections=9)] * 2

    expected = best(boxes, scores)
    assert 1 < len(expected) < 10
    assert torch.equal(
        torch.compile(best, fullgraph=True, backend=BACKEND)(boxes, scores), expected
    )


class Suppression(torch.nn.Module):
    """A head as it is exported: overlaps with anchors, then suppression."""

    def forward(
        self, boxes: torch.Tensor, anchors: torch.Tensor, scores: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return aligned_iou_3d(boxes, anchors), nms2d(boxes[:, :4].sort(dim=1).values, scores, 0.5)


def test_an_exported_program_holds_the_operators_and_gives_the_same():
    boxes, anchors = some_boxes(6, 12), some_boxes(7, 12)
    example = (boxes, anchors, boxes[:, 0].clone())
    program = torch.export.export(Suppression(), example)
    called = {str(node.target) for node in program.graph.nodes if node.op == "call_function"}
    assert {"sightline.aligned_iou.default", "sightline.nms.default"} <= called
    for exported, eager in zip(program.module()(*example), Suppression()(*example), strict=True):
        assert torch.equal(exported, eager)
