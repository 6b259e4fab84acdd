import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection2d.compact.loss import (
    AlignedLossConfig,
    Assignment,
    AssignmentConfig,
    aligned_loss,
    assign_places,
    generalized_iou,
)
from sightline.detection2d.compact.network import cells, decode_distances
from sightline.detection2d.fusion import HeadOutput
from tests.detection2d.frames import targets
from tests.reference import aligned as reference

STEPS = 5
seeds = st.integers(0, 10_000)
corner = st.integers(0, 60)
side = st.integers(3, 40)
box = st.tuples(corner, corner, side, side).map(lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3]))
objects = st.lists(st.tuples(box, st.integers(0, 2)), max_size=4)
PLACES = torch.cat([cells(4, 5, 16, torch.zeros(1)), cells(2, 3, 32, torch.zeros(1))])


def output_of(seed, batch=1):
    generator = torch.Generator().manual_seed(seed)
    return HeadOutput(
        2 * torch.randn(batch, len(PLACES), 3, generator=generator),
        2 * torch.randn(batch, len(PLACES), 4 * STEPS, generator=generator),
        PLACES,
    )


@given(seed=seeds, found=objects, best=st.sampled_from([1, 3, 100]),
       exponents=st.sampled_from([(1.0, 6.0), (0.5, 2.0)]))  # fmt: skip
def test_places_are_assigned_as_plain_loops_say(seed, found, best, exponents):
    output = output_of(seed)
    scores, boxes = (
        output.class_logits[0].sigmoid().double(),
        decode_distances(output)[0].double(),
    )
    truth, classes = [each[0] for each in found], [each[1] for each in found]
    config = AssignmentConfig(alpha=exponents[0], beta=exponents[1], cells=best)
    assigned = assign_places(scores.float(), boxes.float(), PLACES, targets(truth, classes), config)
    owners, qualities = reference.assign(
        scores.tolist(), boxes.tolist(), PLACES[:, :2].tolist(), truth, classes,
        alpha=exponents[0], beta=exponents[1], cells=best,
    )  # fmt: skip
    assert assigned.objects.tolist() == [-1 if each is None else each for each in owners]
    assert assigned.qualities.tolist() == pytest.approx(qualities, rel=1e-3, abs=1e-5)


def test_an_object_between_all_cells_is_still_somebodys():
    output = output_of(0)
    truth = targets([(16, 16, 18, 18)], [1])
    assigned = assign_places(
        output.class_logits[0].sigmoid(), decode_distances(output)[0], PLACES, truth,
        AssignmentConfig(),
    )  # fmt: skip
    (place,) = (assigned.objects == 0).nonzero()[:, 0].tolist()
    assert PLACES[place].tolist() == [15.5, 15.5, 32.0, 32.0]
    assert assigned.qualities[place] >= 0.1


@given(seed=seeds)
def test_boxes_are_the_means_of_their_distributions(seed):
    output = output_of(seed)
    expected = reference.decode(output.box_logits[0].tolist(), PLACES.tolist())
    torch.testing.assert_close(
        decode_distances(output)[0], torch.tensor(expected), rtol=0, atol=1e-3
    )


@given(a=box, b=box)
def test_the_generalized_iou_is_that_of_plain_arithmetic(a, b):
    found = generalized_iou(torch.tensor([a]).float(), torch.tensor([b]).float())
    assert float(found) == pytest.approx(reference.generalized_iou(a, b), abs=1e-5)


@given(
    seed=seeds,
    frames=st.lists(st.tuples(objects, st.lists(box, max_size=2)), min_size=1, max_size=2),
    kind=st.sampled_from(["quality_focal", "varifocal"]),
    data=st.data(),
)
def test_the_loss_is_that_of_plain_loops(seed, frames, kind, data):
    output = output_of(seed, len(frames))
    rows, truths, assignments = [], [], []
    for index, (found, ignored) in enumerate(frames):
        flags = [data.draw(st.tuples(*[st.booleans()] * 3)) for _ in ignored]
        owner = st.sampled_from([None, *range(len(found))])
        owners = [data.draw(owner) for _ in range(len(PLACES))]
        qualities = [0.0 if each is None else 0.1 + 0.05 * (n % 9) for n, each in enumerate(owners)]
        truth, classes = [each[0] for each in found], [each[1] for each in found]
        ignored_classes = torch.tensor(flags).reshape(-1, 3)
        truths.append(targets(truth, classes, ignored, ignored_classes))
        assignments.append(
            Assignment(
                torch.tensor([-1 if each is None else each for each in owners]),
                torch.tensor(qualities),
            )
        )
        rows.append(
            (output.class_logits[index].tolist(), output.box_logits[index].tolist(), truth,
             classes, ignored, flags, owners, qualities)
        )  # fmt: skip
    config = AlignedLossConfig(
        classification=kind, class_weight=1.5, box_weight=2.0, distribution_weight=0.25
    )
    factors = [0.0, 1.0][-len(frames) :]
    expected = reference.loss(
        rows, PLACES.tolist(), kind=kind, weights=(1.5, 2.0, 0.25), image_weights=factors
    )
    found = aligned_loss(output, truths, assignments, config, image_weights=torch.tensor(factors))
    assert [float(each) for each in found] == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_nothing_to_find_is_a_loss_of_scores_alone():
    output = output_of(1)
    for logits in output[:2]:
        logits.requires_grad_()
    nothing = Assignment(torch.full((len(PLACES),), -1), torch.zeros(len(PLACES)))
    found = aligned_loss(output, [targets()], [nothing], AlignedLossConfig())
    assert found.classification > 0
    assert (found.boxes.item(), found.distribution.item()) == (0, 0)
    sum(found).backward()
    assert output.class_logits.grad.any()
    assert not output.box_logits.grad.any()


@pytest.mark.parametrize("kind", ["quality_focal", "varifocal"])
def test_scores_that_are_the_qualities_cost_least(kind):
    from sightline.detection2d.compact.loss import class_costs

    target = torch.tensor([0.3, 0.7])
    logits = torch.logit(target).requires_grad_()
    class_costs(logits, target, kind).sum().backward()
    torch.testing.assert_close(logits.grad, torch.zeros(2), rtol=0, atol=1e-6)
