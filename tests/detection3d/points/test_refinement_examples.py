"""Which proposals of a sweep the second stage is trained on, and towards which yaws."""

import math

import pytest
import torch

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.points.config import (
    ProposalSamplingConfig,
    RefinementConfig,
    RoiPoolingConfig,
)
from sightline.detection3d.points.refinement import PointRefinement, RefinementOutput
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import SweepTruth
from tests.detection3d.boxes import car, rows

CONFIG = Detection3DLossConfig(sampling=ProposalSamplingConfig(num_samples=12, max_foreground=6))
PLAIN = RefinementConfig(in_channels=0, levels=(), global_widths=(4,), head_widths=())


def examples(proposals, truths, ignored=(), *, config=CONFIG, full_to_m=60.0):
    """Of a sweep with a point at each proposal nearer than `full_to_m`."""
    boxes = torch.tensor(proposals).reshape(-1, 7)
    near = boxes[boxes[:, 0] < full_to_m, :3]
    sweep = torch.cat((near, torch.zeros(len(near), 1)), dim=1)
    count = len(boxes)
    proposed = Proposed(boxes, torch.zeros(count, dtype=torch.int64), torch.ones(count))
    truth = SweepTruth(
        boxes=rows(truths),
        classes=torch.zeros(len(truths), dtype=torch.int64),
        ignored_boxes=rows(ignored),
        ignored_classes=torch.ones(len(ignored), 1).bool(),
    )
    stage = PointRefinement(PLAIN, RoiPoolingConfig(num_points=8, margin_m=0.0))
    return stage.examples(sweep, proposed, truth, config, seed=0)


def test_proposals_on_ignored_objects_are_neither_foreground_nor_background():
    proposals = [car(10.25), car(30.25), car(50.0)]
    regions, samples = examples(proposals, [car(10)], [car(30)])
    assert set(regions.boxes[:, 0].tolist()) == {10.25, 50.0}
    assert torch.equal(samples.boxes[samples.iou > 0.5].unique(dim=0), torch.tensor([car(10.0)]))


def test_one_on_both_an_ignored_and_a_wanted_object_goes_by_the_larger_overlap():
    regions, _ = examples([car(10.25)], [car(10.1)], [car(10.6)])
    assert len(regions.places) == 12
    regions, _ = examples([car(10.25)], [car(10.6)], [car(10.1)])
    assert len(regions.places) == 0


def test_all_zero_proposals_and_those_around_which_nothing_is_are_left_out():
    regions, samples = examples([car(10.25), [0.0] * 7, car(65.0)], [car(10)])
    assert set(regions.boxes[:, 0].tolist()) == {10.25}
    assert len(samples.iou) == len(regions.places) == 12


def test_samples_are_drawn_among_the_proposals_with_points_so_that_none_is_lost():
    full = [car(10.25), car(25.0), car(40.0)]
    empty = [car(62.0 + 5 * k) for k in range(20)]
    sampling = ProposalSamplingConfig()
    regions, samples = examples(
        [*full, *empty], [car(10)], config=Detection3DLossConfig(sampling=sampling)
    )
    assert len(regions.places) == len(samples.iou) == sampling.num_samples
    assert set(regions.places.tolist()) == {0, 1, 2}
    assert regions.inputs["points"].shape == (sampling.num_samples, 8, 3)
    assert torch.equal(regions.inputs["points"], regions.boxes[:, None, :3].expand(-1, 8, 3))


def test_a_sweep_without_proposals_has_no_examples():
    regions, samples = examples([], [car(10)])
    assert len(regions.places) == len(samples.iou) == 0


@pytest.mark.parametrize("yaw", [-math.pi, -3.13, 3.13, 0.01, -1.5, 1.5])
def test_yaws_are_compared_in_a_range_without_an_end_at_oncoming_cars(yaw):
    regions, samples = examples([car(10.25)], [car(10, yaw=yaw)])
    expected = yaw - 2 * math.pi if yaw > 3 else yaw  # oncoming cars lie together, near -pi
    boxes = samples.boxes.clone().float()
    boxes[:, 6] = expected
    output = RefinementOutput(boxes, torch.zeros(len(boxes)))
    stage = PointRefinement(PLAIN, RoiPoolingConfig(num_points=8, margin_m=0.0))
    assert stage.losses(output, regions, samples, CONFIG).boxes.item() == pytest.approx(0, abs=1e-9)
