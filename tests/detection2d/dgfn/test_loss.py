import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection2d.dgfn.loss import (
    SsdLossConfig,
    hardest_negatives,
    match_priors,
    multibox_loss,
)
from sightline.detection2d.dgfn.network import corners_of
from sightline.detection2d.fusion import HeadOutput
from tests.detection2d.frames import targets
from tests.reference import ssd as reference

side = st.integers(1, 12)
corner = st.integers(0, 16)
box = st.tuples(corner, corner, side, side).map(lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3]))
places = st.lists(box, min_size=1, max_size=12)
truths = st.lists(st.tuples(box, st.integers(0, 2)), max_size=3)


def as_places(corners):
    rows = torch.tensor(corners, dtype=torch.float32)
    return torch.cat(((rows[:, :2] + rows[:, 2:]) / 2, rows[:, 2:] - rows[:, :2]), dim=1)


@given(
    priors=places, objects=st.lists(box, max_size=4), match_iou=st.sampled_from([0.25, 0.5, 0.7])
)
def test_priors_are_matched_as_plain_loops_say_even_at_ties(priors, objects, match_iou):
    found = match_priors(
        as_places(priors), torch.tensor(objects, dtype=torch.float32).reshape(-1, 4), match_iou
    )
    expected = reference.match(priors, objects, match_iou)
    assert found.tolist() == [-1 if each is None else each for each in expected]


@given(
    priors=places,
    frames=st.lists(st.tuples(truths, st.lists(box, max_size=2)), min_size=1, max_size=3),
    seed=st.integers(0, 1000),
    per_positive=st.sampled_from([0.0, 1.5, 3.0]),
)
def test_the_loss_is_that_of_plain_loops(priors, frames, seed, per_positive):
    generator = torch.Generator().manual_seed(seed)
    logits = 3 * torch.randn(len(frames), len(priors), 4, generator=generator)
    offsets = 2 * torch.randn(len(frames), len(priors), 4, generator=generator)
    truth = [
        ([each[0] for each in objects], [each[1] for each in objects], ignored)
        for objects, ignored in frames
    ]
    found = multibox_loss(
        HeadOutput(logits, offsets, as_places(priors)),
        [targets(*each) for each in truth],
        SsdLossConfig(negatives_per_positive=per_positive),
    )
    expected = reference.loss(
        logits.tolist(),
        offsets.tolist(),
        priors,
        truth,
        match_iou=0.5,
        per_positive=per_positive,
        ignored_share=0.5,
    )
    assert [float(each) for each in found] == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_only_the_hardest_negatives_count():
    costs = torch.tensor([[5.0, 1.0, 3.0, 4.0, 2.0, 9.0]])
    matched = torch.tensor([[True, False, False, False, False, False]])
    ignored = torch.tensor([[False, False, False, True, False, False]])
    chosen = hardest_negatives(costs, matched, ignored, 2.0)
    assert chosen.tolist() == [[False, False, True, False, False, True]]


def test_a_batch_without_objects_has_a_gradient_of_zero():
    logits = torch.randn(1, 3, 4, requires_grad=True)
    offsets = torch.randn(1, 3, 4, requires_grad=True)
    output = HeadOutput(logits, offsets, as_places([(0, 0, 4, 4)] * 3))
    sum(multibox_loss(output, [targets()], SsdLossConfig())).backward()
    assert not logits.grad.any()
    assert not offsets.grad.any()


@pytest.mark.parametrize("seed", range(5))
def test_matching_and_loss_are_those_of_torchvision(seed):
    ssd = pytest.importorskip("torchvision.models.detection.ssd", reason="no torchvision")
    generator = torch.Generator().manual_seed(seed)
    low = 100 * torch.rand(60, 2, generator=generator)
    priors = torch.cat((low, low + 5 + 60 * torch.rand(60, 2, generator=generator)), dim=1)
    low = 100 * torch.rand(2, 4, 2, generator=generator)
    truth = torch.cat((low, low + 5 + 60 * torch.rand(2, 4, 2, generator=generator)), dim=2)
    classes = torch.randint(0, 3, (2, 4), generator=generator)
    logits = torch.randn(2, 60, 4, generator=generator)
    offsets = torch.randn(2, 60, 4, generator=generator)

    peer = object.__new__(ssd.SSD)
    torch.nn.Module.__init__(peer)
    peer.box_coder = ssd.det_utils.BoxCoder(weights=(10.0, 10.0, 5.0, 5.0))
    peer.proposal_matcher = ssd.det_utils.SSDMatcher(0.5)
    peer.neg_to_pos_ratio = 3.0
    matches = [peer.proposal_matcher(ssd.box_ops.box_iou(boxes, priors)) for boxes in truth]
    peers = peer.compute_loss(
        [
            {"boxes": boxes, "labels": labels + 1}
            for boxes, labels in zip(truth, classes, strict=True)
        ],
        {"bbox_regression": offsets, "cls_logits": logits},
        [priors, priors],
        matches,
    )

    priors_tensor = as_places(priors.tolist())
    torch.testing.assert_close(corners_of(priors_tensor), priors)
    for boxes, expected in zip(truth, matches, strict=True):
        found = match_priors(priors_tensor, boxes, 0.5)
        assert found.clamp(min=-1).tolist() == expected.clamp(min=-1).tolist()
    found = multibox_loss(
        HeadOutput(logits, offsets, priors_tensor),
        [targets(b.tolist(), c.tolist()) for b, c in zip(truth, classes, strict=True)],
        SsdLossConfig(),
    )
    torch.testing.assert_close(found.boxes, peers["bbox_regression"], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(found.classification, peers["classification"], rtol=1e-4, atol=1e-4)
