"""The second stage's network and its loss: sizes, order of points, and that it learns."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.pillars.region_config import (
    RegionConfig,
    RegionExamplesConfig,
    RegionLossConfig,
)
from sightline.detection3d.pillars.region_training import region_examples, region_loss
from sightline.detection3d.pillars.regions import (
    RegionNetwork,
    RegionOutput,
    RegionStage,
    cut_regions,
)
from sightline.detection3d.stages import Proposed
from sightline.ops.rotated_iou import aligned_iou_3d
from tests.detection3d.scenes import scene_of, sweep_of
from tests.reference import compact3d as reference

SMALL = RegionConfig(num_points=48, point_widths=(24, 32), region_width=48, head_widths=(48, 32))
number = st.integers(-6, 6).map(lambda step: step / 8)
size = st.sampled_from([0.8, 1.0, 1.3])
box = st.tuples(number, number, number, size, size, size, number)


def random_stage():
    torch.manual_seed(0)
    stage = RegionStage(SMALL).eval()
    torch.nn.init.normal_(stage.network.answer.weight, std=0.1)
    return stage


def random_network():
    return random_stage().network


def test_the_default_is_of_the_size_that_was_chosen_and_changes_nothing_at_first():
    config = RegionConfig()
    network = RegionNetwork(config)
    assert sum(weight.numel() for weight in network.parameters()) == 110_250
    output = network(torch.rand(5, 192, 9), torch.rand(5, 10))
    assert not any(part.any() for part in output)
    assert [len(part) for part in network(torch.rand(0, 192, 9), torch.rand(0, 10))] == [0, 0, 0]


def test_the_order_of_points_and_repetitions_do_not_matter():
    network, context = random_network(), torch.rand(2, 10)
    points = torch.rand(2, 20, 9)
    repeated = torch.cat((points, points[:, :7]), dim=1)[:, torch.randperm(27)]
    for straight, other in zip(network(points, context), network(repeated, context), strict=True):
        torch.testing.assert_close(other, straight)


@given(truth=box, proposal=box, seed=st.integers(0, 99))
def test_a_change_costs_by_its_code_and_background_by_its_quality_alone(truth, proposal, seed):
    generator = torch.Generator().manual_seed(seed)
    values, front, quality = (
        torch.randn(shape, generator=generator, dtype=torch.float64)
        for shape in ((2, 8), (2,), (2,))
    )
    output = RegionOutput(values, front, quality)
    proposals = torch.tensor([proposal, proposal], dtype=torch.float64)
    truths = torch.tensor([truth, truth], dtype=torch.float64)
    losses = region_loss(output, proposals, truths, torch.tensor([False, True]), RegionLossConfig())
    code = reference.region_values(truth, proposal)
    errors = [given - expected for given, expected in zip(values[1].tolist(), code, strict=True)]
    expected = sum(reference.smooth_l1(error, 0.25) for error in errors)
    assert losses.values.item() == pytest.approx(expected, abs=1e-9)
    total = losses.values + 4 * losses.corners + losses.front + 0.5 * losses.quality
    assert losses.total.item() == pytest.approx(total.item())
    without = region_loss(
        output, proposals, truths, torch.tensor([False, True]), RegionLossConfig(corner_weight=0.0)
    )
    assert without.total.item() == pytest.approx((total - 4 * losses.corners).item())


def test_the_quality_is_asked_for_by_the_iou_of_the_changed_box():
    proposal = torch.tensor([[5.0, 1.0, 0.0, 2.0, 1.0, 1.0, 0.3]])
    output = RegionOutput(torch.zeros(1, 8), torch.full((1,), 9.0), torch.zeros(1))
    for shift, expected in ((0.0, 1.0), (1 / 3, 0.5), (3.0, 0.0)):  # half: an IoU of a half
        moved = proposal + torch.tensor([0, 0, shift, 0, 0, 0, 0])
        losses = []
        for logit in (-4.0, 4.0):
            rated = output._replace(quality_logits=torch.tensor([logit]))
            loss = region_loss(rated, proposal, moved, torch.tensor([True]), RegionLossConfig())
            losses.append(loss.quality.item())
        assert (losses[0] - losses[1]) / 8 == pytest.approx(expected - 0.5, abs=1e-5)


def test_without_objects_or_regions_nothing_but_quality_costs():
    values = torch.ones(2, 8, requires_grad=True)
    output = RegionOutput(values, torch.zeros(2), torch.zeros(2, requires_grad=True))
    boxes = torch.rand(2, 7) + 0.5
    losses = region_loss(output, boxes, boxes, torch.tensor([False, False]), RegionLossConfig())
    losses.total.backward()
    assert [part.item() for part in losses[1:4]] == [0, 0, 0]
    assert losses.quality.item() == pytest.approx(0.6931, abs=1e-4)
    assert not values.grad.any()
    nothing = RegionOutput(values[:0], torch.zeros(0), torch.zeros(0))
    none = torch.zeros(0, dtype=torch.bool)
    loss = region_loss(nothing, boxes[:0], boxes[:0], none, RegionLossConfig())
    assert loss.total.item() == 0


BOXES = [
    [8.1, 2.3, -0.9, 4.1, 1.7, 1.5, 0.4],
    [10.2, -3.9, -0.9, 3.7, 1.6, 1.6, -2.4],
    [5.0, 5.1, -0.8, 0.9, 0.6, 1.7, 2.0],
]


def test_the_second_stage_learns_to_bring_moved_boxes_back_and_again_in_a_second_pass():
    stage, rng = random_stage(), np.random.default_rng(0)
    network, sweep = stage.network, sweep_of(BOXES)
    points = sweep[:, :3]
    scene = scene_of(BOXES, [0, 0, 1])
    optimizer = torch.optim.Adam(network.parameters(), lr=4e-3)
    for step in range(320):
        drawn = region_examples(scene, points, SMALL.classes, rng, RegionExamplesConfig())
        proposals = drawn.proposals.float()
        regions = cut_regions(points, points[:, :0], proposals, drawn.classes, SMALL, seed=step)
        output, truths = network(*regions), drawn.truths.float()
        loss = region_loss(output, proposals, truths, drawn.is_object, RegionLossConfig())
        optimizer.zero_grad()
        loss.total.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
    network.eval()
    config = RegionExamplesConfig(num_objects=40, num_background=0)
    drawn = region_examples(scene, points, SMALL.classes, np.random.default_rng(1), config)
    proposed = Proposed(drawn.proposals.float(), drawn.classes, torch.ones(40))
    truths = drawn.truths.float()
    ious = [aligned_iou_3d(proposed.boxes, truths).mean()]
    for _ in range(2):
        proposed = changed(stage, sweep, proposed)
        ious.append(aligned_iou_3d(proposed.boxes, truths).mean())
        assert ((proposed.boxes[:, 6] - truths[:, 6]).cos() > 0).float().mean() > 0.9
    assert ious[1] > ious[0] + 0.1
    assert ious[2] > ious[1]


def changed(stage, sweep, proposed):
    """As a pass leaves proposals; the scores stay those of the first stage."""
    regions = stage.regions(sweep, proposed, seed=0)
    with torch.no_grad():
        refined = stage.refine(stage(**regions.inputs), regions)
    return proposed._replace(boxes=refined.boxes)


def test_the_score_is_made_of_the_proposal_s_and_the_quality():
    sweep, stage = sweep_of(BOXES), RegionStage(SMALL)
    proposed = Proposed(torch.tensor(BOXES), torch.tensor([0, 0, 1]), torch.tensor([0.4, 0.9, 0.5]))
    regions = stage.regions(sweep, proposed, seed=0)
    boxes, scores, _ = stage.refine(stage(**regions.inputs), regions)
    torch.testing.assert_close(boxes, proposed.boxes)  # an untrained one changes nothing
    assert scores.tolist() == pytest.approx([0.2**0.5, 0.45**0.5, 0.25**0.5])
    by_quality = RegionStage(replace(SMALL, quality_share=1.0))
    assert by_quality.refine(stage(**regions.inputs), regions).scores.tolist() == [0.5, 0.5, 0.5]


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="passes must be from 1 to 10, got 0"):
        RegionConfig(passes=0)
    with pytest.raises(ValueError, match="quality_share must be from 0 to 1, got 2"):
        RegionConfig(quality_share=2.0)
    with pytest.raises(ValueError, match="front_weight must be finite and not negative, got -1"):
        RegionLossConfig(front_weight=-1.0)
    with pytest.raises(ValueError, match="corner_knee_m must be positive and finite, got 0"):
        RegionLossConfig(corner_knee_m=0.0)
