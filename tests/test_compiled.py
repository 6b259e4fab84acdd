"""What torch.compile and torch.export make of the project's own operators.

Runs by itself, without the shape checks of the other tests: their wrappers cannot be compiled.
Graphs are captured and differentiated, then run by torch: no C++ compiler is needed.
"""

from itertools import product

import pytest
import torch
from torch import library

from sightline.ops.nms import nms2d, nms_bev
from sightline.ops.rotated_iou import (
    aligned_iou_3d,
    aligned_iou_bev,
    pairwise_iou_3d,
    pairwise_iou_bev,
)

BACKEND = "aot_eager"
BEV_COLUMNS = [0, 1, 3, 4, 6]


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
        return aligned_iou_bev(boxes, anchors), nms2d(boxes[:, :4].sort(dim=1).values, scores, 0.5)


def test_an_exported_program_holds_the_operators_and_gives_the_same():
    boxes, anchors = some_boxes(6, 12)[:, BEV_COLUMNS], some_boxes(7, 12)[:, BEV_COLUMNS]
    example = (boxes, anchors, boxes[:, 0].clone())
    program = torch.export.export(Suppression(), example)
    called = {str(node.target) for node in program.graph.nodes if node.op == "call_function"}
    assert {"sightline.aligned_iou.default", "sightline.nms.default"} <= called
    for exported, eager in zip(program.module()(*example), Suppression()(*example), strict=True):
        assert torch.equal(exported, eager)
