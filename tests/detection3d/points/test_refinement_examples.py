"""Which proposals of a sweep the second stage is trained on."""

import torch

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.points.config import ProposalSamplingConfig
from sightline.detection3d.points.refinement import PointRefinement
from sightline.detection3d.stages import Proposed, Regions
from sightline.detection3d.sweeps import SweepTruth
from tests.detection3d.boxes import car, rows

CONFIG = Detection3DLossConfig(sampling=ProposalSamplingConfig(num_samples=12, max_foreground=6))


class AllButFar(PointRefinement):
    """A second stage to which there is nothing around proposals beyond 60 m."""

    def __init__(self):
        torch.nn.Module.__init__(self)

    def regions(self, sweep, proposed, *, seed):
        del sweep, seed
        places = (proposed.boxes[:, 0] < 60).nonzero()[:, 0]
        return Regions(places, proposed.boxes[places], proposed.scores[places], {})


def examples(proposals, truths, ignored=()):
    boxes = torch.tensor(proposals).reshape(-1, 7)
    count = len(boxes)
    proposed = Proposed(boxes, torch.zeros(count, dtype=torch.int64), torch.ones(count))
    truth = SweepTruth(
        boxes=rows(truths),
        classes=torch.zeros(len(truths), dtype=torch.int64),
        ignored_boxes=rows(ignored),
        ignored_classes=torch.ones(len(ignored), 1).bool(),
    )
    return AllButFar().examples(torch.zeros(1, 4), proposed, truth, CONFIG, seed=0)


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
    assert len(samples.iou) == len(regions.places) < 12


def test_a_sweep_without_proposals_has_no_examples():
    regions, samples = examples([], [car(10)])
    assert len(regions.places) == len(samples.iou) == 0
