"""The 64 samples of a frame: each rule by itself, and all against loops over lists."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.points.config import ProposalSamplingConfig
from sightline.detection3d.points.refinement_training import sample_proposals
from sightline.ops.rotated_iou import pairwise_iou_3d
from tests.detection3d.boxes import car, near_boxes, rows
from tests.reference import proposals as reference

ON, BESIDE, OFF, BETWEEN = 0.25, 1.75, 30.0, 1.25  # m aside from a car: IoU 0.88, 0.39, 0, 0.52


def sample(proposals, truths, seed=0, **settings):
    generator = torch.Generator().manual_seed(seed)
    config = ProposalSamplingConfig(**settings)
    return sample_proposals(rows(proposals), rows(truths), config, generator=generator)


def counts(samples):
    """Foreground by IoU, hard and easy background by IoU, other."""
    iou = samples.iou
    is_hard = (iou >= 0.05) & (iou < 0.45)
    foreground, hard, easy = (int(part.sum()) for part in (iou >= 0.55, is_hard, iou < 0.05))
    return foreground, hard, easy, len(iou) - foreground - hard - easy


def scene(on=0, beside=0, off=0, between=0):
    """Proposals around one car, which is itself one of those on it if there are any."""
    steps = (on, ON), (beside, BESIDE), (off, OFF), (between, BETWEEN)
    # hundredths apart, so that all differ
    return [car(shift + k / 100) for count, shift in steps for k in range(count)]


TRUTH = [car(0.0)]


@given(
    proposals=near_boxes,
    truths=near_boxes | st.just([]),
    seed=st.integers(0, 9),
    num_samples=st.integers(2, 9),
)
def test_all_samples_come_from_the_pools_in_their_shares(proposals, truths, seed, num_samples):
    limit = num_samples // 2
    samples = sample(proposals, truths, seed, num_samples=num_samples, max_foreground=limit)
    foreground, easy, hard = reference.pools(proposals, truths)
    if not proposals:
        assert len(samples.proposal) == 0
        return
    if easy or hard:
        num_foreground = min(len(foreground), limit)
        num_hard = (num_samples - num_foreground) // (2 if easy else 1) if hard else 0
    else:
        num_foreground, num_hard = num_samples, 0
    num_easy = num_samples - num_foreground - num_hard
    start = 0
    places = {tuple(box): k for k, box in reversed(list(enumerate(truths)))}
    for pool, share in ((foreground, num_foreground), (easy, num_easy), (hard, num_hard)):
        drawn = []
        for k in range(start, start + share):
            proposal, box = samples.proposal[k].item(), samples.boxes[k].tolist()
            truth = places[tuple(box)] if truths else -1
            drawn.append((proposal, truth))
            expected = reference.upright_iou(proposals[proposal], box) if truths else 0
            assert samples.iou[k].item() == pytest.approx(expected, abs=1e-12)
        known = {(p, places[tuple(truths[t])] if truths else -1) for p, t in pool}
        assert set(drawn) <= known
        assert share < len(pool) or set(drawn) == known
        start += share
    assert start == num_samples


def test_foreground_alone_fills_all_samples_by_repetition_or_choice():
    few = sample(scene(on=5), TRUTH)
    assert counts(few) == (64, 0, 0, 0)
    assert set(few.proposal.tolist()) == set(range(5))
    many = sample([car(k / 1000) for k in range(100)], TRUTH)
    assert counts(many) == (64, 0, 0, 0)
    assert len(set(many.proposal.tolist())) == 64


def test_background_alone_fills_all_samples_half_easy_half_hard():
    beside_and_off = scene(beside=40, off=40)
    samples = sample(beside_and_off, [*TRUTH, car(BESIDE + 4.0, 9.0)])
    # the best beside it is foreground by rank: 1 of 64, then 63 of background, the odd one easy
    assert counts(samples) == (0, 32, 32, 0)
    assert (samples.iou[1:33] < 0.05).all()
    without_objects = sample(scene(off=70), [])
    assert counts(without_objects) == (0, 0, 64, 0)
    assert len(set(without_objects.proposal.tolist())) == 64


def test_with_both_at_most_32_are_foreground():
    assert counts(sample([*(car(k / 1000) for k in range(50)), car(OFF)], TRUTH)) == (32, 0, 32, 0)


def test_with_both_and_little_foreground_all_of_it_is_taken_once():
    samples = sample(scene(on=3, off=9), TRUTH)
    assert counts(samples) == (3, 0, 61, 0)
    assert sorted(samples.proposal[:3].tolist()) == [0, 1, 2]


def test_background_is_half_easy_half_hard_and_the_odd_one_is_easy():
    assert counts(sample(scene(on=3, beside=50, off=50), TRUTH)) == (3, 30, 31, 0)
    assert counts(sample(scene(on=4, beside=50, off=50), TRUTH)) == (4, 30, 30, 0)


def test_a_small_share_of_background_is_repeated_to_its_half():
    samples = sample(scene(on=4, beside=2, off=50), TRUTH)
    assert counts(samples) == (4, 30, 30, 0)
    assert set(samples.proposal[34:].tolist()) == {4, 5}


@pytest.mark.parametrize(
    ("scene_of", "expected"),
    [
        ({"on": 4, "beside": 7}, (4, 60, 0, 0)),
        ({"on": 4, "off": 7}, (4, 0, 60, 0)),
    ],
)
def test_background_of_one_kind_alone_fills_the_share(scene_of, expected):
    assert counts(sample(scene(**scene_of), TRUTH)) == expected


def test_what_is_neither_foreground_nor_background_is_never_drawn():
    samples = sample(scene(on=2, between=20, off=5), TRUTH)
    assert counts(samples) == (2, 0, 62, 0)


def test_the_best_proposal_of_an_object_is_foreground_whatever_its_iou():
    samples = sample([car(BESIDE), car(BESIDE + 0.25), car(OFF)], TRUTH)
    assert samples.proposal[0].item() == 0
    assert samples.iou[0].item() == pytest.approx(0.391, abs=1e-3)
    assert 0 not in samples.proposal[1:].tolist()  # not background with the same object, too
    alone = sample([car(BETWEEN)], TRUTH)
    assert alone.proposal.tolist() == [0] * 64
    assert counts(alone) == (0, 0, 0, 64)


def test_the_best_proposal_of_an_object_is_one_sample_more_with_that_object():
    # it is on the first car, and yet the best that the second one has
    truths = [car(0.0), car(3.5)]
    samples = sample([car(0.25), car(OFF)], truths)
    assert samples.proposal[:2].tolist() == [0, 0]
    assert {box[0] for box in samples.boxes[:2].tolist()} == {0.0, 3.5}
    assert sorted(samples.iou[:2].tolist()) == pytest.approx([0.75 / 7.25, 3.75 / 4.25])
    assert samples.proposal[2:].tolist() == [1] * 62


def test_an_object_that_nothing_overlaps_has_no_best_proposal():
    assert counts(sample([car(OFF)], TRUTH)) == (0, 0, 64, 0)


def test_an_overlap_by_rounding_alone_makes_no_pair():
    beside = [21.34, 1.83, -1.0, 3.9, 1.6, 1.5, 2.34]
    truth = [19.35, 5.38, -1.0, 3.9, 1.6, 1.5, 2.88]
    assert 0 < pairwise_iou_3d(rows([beside]), rows([truth])).item() < 1e-9
    samples = sample([beside], [truth])
    assert samples.iou.max().item() < 0.05
    assert counts(sample([beside, car(OFF)], [truth])) == (0, 0, 64, 0)
    assert set(
        sample([beside, car(OFF)], [truth], num_samples=2, max_foreground=1).proposal.tolist()
    ) == {0, 1}


def test_without_proposals_there_are_no_samples():
    for truths in (TRUTH, []):
        samples = sample([], truths)
        assert samples.boxes.shape == (0, 7)
        assert len(samples.proposal) == len(samples.iou) == 0


def test_the_same_generator_draws_the_same_and_all_have_the_same_chance():
    proposals = scene(on=40, off=100)
    assert torch.equal(sample(proposals, TRUTH, 3).proposal, sample(proposals, TRUTH, 3).proposal)
    drawn = torch.cat([sample(proposals, TRUTH, seed).proposal for seed in range(400)])
    times = drawn.bincount(minlength=140)
    foreground, easy = times[:40], times[40:]
    assert ((foreground - 320).abs() < 60).all()  # 32 of 40, 400 times: standard deviation 8
    assert ((easy - 128).abs() < 60).all()


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="max_foreground must be from 1 to num_samples 4, got 5"):
        ProposalSamplingConfig(num_samples=4, max_foreground=5)
    with pytest.raises(ValueError, match=r"must rise from 0 to 1, got 0\.05, 0\.7, 0\.55"):
        ProposalSamplingConfig(background_iou=0.7)
