"""Flip test of the compact detector: exact transforms, and predictions that follow them."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from sightline.cli.main import main
from sightline.detection3d.config import Detection3DConfig, HeadingHypothesesConfig
from sightline.detection3d.detector import Detector3D, propose, refine
from sightline.detection3d.examples import Detection3DExampleConfig, Detection3DExamples
from sightline.detection3d.pillars.boxes import (
    cell_middles,
    encode_centers,
    encode_regions,
    keeps_front,
    mirror_centers,
    turn_regions,
)
from sightline.detection3d.pillars.config import PillarGridConfig
from sightline.detection3d.pillars.region_config import RegionConfig
from sightline.detection3d.pillars.regions import (
    RegionOutput,
    RegionStage,
    cut_regions,
    flip_heading,
)
from sightline.detection3d.pillars.stage import mirror_pillars, pillar_features
from sightline.detection3d.stages import (
    UNCHANGED,
    StageView,
    mean_over_joined_views,
    mean_over_views,
)
from sightline.detection3d.sweeps import network_sweep
from sightline.detection3d.task import Detection3D
from sightline.geometry.transforms import wrap_angle
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection3d.frames import COMPACT, NAMES, TINY, simulated_frames, write_network

MIRROR = torch.tensor([1.0, -1, 1, 1, 1, 1, -1], dtype=torch.float64)
"""Of a box: y and the yaw change signs."""
seeds = st.integers(0, 10**6)


def some_boxes(seed, count=5):
    """x, y, z, length, width, height, yaw."""
    rng = torch.Generator().manual_seed(seed)
    drawn = torch.rand(count, 7, generator=rng, dtype=torch.float64)
    low = torch.tensor([2.0, -6, -2, 3, 1, 1, -3], dtype=torch.float64)
    high = torch.tensor([12.0, 6, 0, 5, 2, 2, 3], dtype=torch.float64)
    return low + (high - low) * drawn


@pytest.mark.parametrize("fields", [{}, {"reflectance": True}, {"local_window": 3}])
@given(seed=seeds)
def test_pillars_of_mirrored_points_are_the_mirrored_pillars(fields, seed):
    grid = PillarGridConfig(x_m=(0.0, 8.0), y_m=(-8.0, 8.0), cell_m=0.5, **fields)
    drawn = torch.randint(128, (200, 4), generator=torch.Generator().manual_seed(seed))
    points = (drawn + 0.5) / 128  # off the borders of pillars, and exact in float32
    points = points * torch.tensor([8.0, 16, 4, 1]) - torch.tensor([0.0, 8, 3, 0])
    mirrored = pillar_features(points * torch.tensor([1.0, -1, 1, 1]), grid)
    torch.testing.assert_close(
        mirror_pillars(pillar_features(points, grid)[None], grid)[0], mirrored
    )


@given(seed=seeds)
def test_centers_of_mirrored_boxes_are_the_mirrored_centers(seed):
    grid = PillarGridConfig(x_m=(0.0, 8.0), y_m=(-4.0, 4.0), cell_m=0.5)
    rows, columns = grid.head_size
    cells = torch.cartesian_prod(torch.arange(rows), torch.arange(columns))
    middles, sizes = cell_middles(cells, grid).double(), torch.ones(len(cells), 3).double()
    boxes = some_boxes(seed, rows * columns)  # one for each cell

    def encode(cell_values):
        code = torch.cat((encode_centers(cell_values, middles, sizes), cell_values[:, :1]), dim=1)
        return code.reshape(1, 1, rows, columns, -1).movedim(-1, 2)  # x stands for the quality

    there = (boxes * MIRROR).reshape(rows, columns, 7).flip(1).reshape(-1, 7)
    torch.testing.assert_close(mirror_centers(encode(boxes)), encode(there))


@given(seed=seeds)
def test_changes_of_turned_proposals(seed):
    boxes, proposals = some_boxes(seed), some_boxes(seed + 1)
    code = encode_regions(boxes, proposals)
    turned = proposals + torch.tensor([0, 0, 0, 0, 0, 0, math.pi], dtype=torch.float64)
    torch.testing.assert_close(turn_regions(code), encode_regions(boxes, turned))
    assert (keeps_front(boxes, turned) == ~keeps_front(boxes, proposals)).all()


@given(seed=seeds)
def test_regions_of_turned_proposals(seed):
    config = RegionConfig(num_points=32, in_channels=1)
    boxes, classes = some_boxes(seed), torch.arange(5) % 3
    near = boxes[:, :3].repeat(60, 1)
    noise = torch.randn(300, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    turn = torch.tensor([0, 0, 0, 0, 0, 0, math.pi], dtype=torch.float64)
    plain, turned = (
        cut_regions(near + noise, noise[:, :1], each, classes, config, seed=1)
        for each in (boxes, boxes + turn)
    )
    found = flip_heading(plain)
    torch.testing.assert_close(found.points, turned.points)
    torch.testing.assert_close(found.context, turned.context)
    assert torch.equal(flip_heading(found).points, plain.points)


class _Output(NamedTuple):
    first: Tensor
    second: Tensor


@pytest.mark.parametrize("average", [mean_over_views, mean_over_joined_views])
def test_the_mean_is_over_all_views_and_one_view_is_left_as_it_is(average):
    tenfold = StageView(
        lambda inputs: {"x": 10 * inputs["x"]},
        lambda output: output._replace(first=-output.first),
    )
    inputs = {"x": torch.tensor([1.0, 2.0])}

    def run(given_inputs):
        return _Output(given_inputs["x"], given_inputs["x"] + 1)

    both = average(run, inputs, (UNCHANGED, tenfold))
    assert both.first.tolist() == [-4.5, -9.0]
    assert both.second.tolist() == [6.5, 12.0]
    one = average(run, inputs, (UNCHANGED,))
    assert torch.equal(one.first, inputs["x"])


def test_the_rows_of_all_views_are_run_at_once():
    counts = []

    def run(given_inputs):
        counts.append(len(given_inputs["x"]))
        return _Output(given_inputs["x"], given_inputs["x"])

    mean_over_joined_views(run, {"x": torch.ones(3)}, (UNCHANGED, UNCHANGED))
    assert counts == [6]


def test_a_network_that_answers_by_the_front_alone_is_asked_from_both_ends():
    """The front's logit changes its sign, so what a network always says cancels out."""
    context = torch.zeros(2, 10)

    def always(inputs):
        count = len(inputs["points"])
        return RegionOutput(torch.ones(count, 8), torch.full((count,), 3.0), torch.zeros(count))

    inputs = {"points": torch.zeros(2, 4, 9), "context": context}
    output = mean_over_joined_views(always, inputs, RegionStage.views)
    assert output.front_logits.tolist() == [0, 0]
    assert output.values[0].tolist() == [0, 0, 1, 1, 1, 1, 1, 1]


def trained(config):
    """A detector whose second stage changes something, as after training."""
    torch.manual_seed(0)
    detector = Detector3D(config).eval().requires_grad_(requires_grad=False)
    for parameter in detector.regions.parameters():
        parameter.add_(0.1 * torch.randn_like(parameter))
    return detector


@pytest.fixture(scope="module")
def sweep():
    """Half a millimetre aside, so that no point lies on the border of two pillars."""
    seen = network_sweep(simulated_frames()[0], COMPACT.input)
    return seen + seen.new_tensor([0, 0.0005, 0, 0])


def test_with_a_flip_test_proposals_of_a_mirrored_sweep_are_the_mirrored_proposals(sweep):
    mirrored = sweep * sweep.new_tensor([1, -1, 1, 1])
    detector = trained(replace(COMPACT, flip_test=True))
    here, there = (propose(detector, each)[0] for each in (sweep, mirrored))
    torch.testing.assert_close(there.scores, here.scores, atol=1e-4, rtol=0)
    assert torch.equal(there.classes, here.classes)
    assert same_boxes(there.boxes, here.boxes * MIRROR.float())
    plain, other = (propose(detector, each, in_use=False)[0] for each in (sweep, mirrored))
    assert not same_boxes(other.boxes, plain.boxes * MIRROR.float())


def test_with_a_flip_test_it_does_not_matter_at_which_end_a_proposal_has_its_front(sweep):
    detector = trained(replace(COMPACT, flip_test=True))
    proposed = propose(detector, sweep)[0]
    turn = torch.tensor([0, 0, 0, 0, 0, 0, math.pi])
    turned = proposed._replace(boxes=proposed.boxes + turn)
    here, there = (refine(detector, sweep, each) for each in (proposed, turned))
    torch.testing.assert_close(there.scores, here.scores, atol=1e-4, rtol=0)
    assert same_boxes(there.boxes.tensor, here.boxes.tensor)
    plain, other = (refine(detector, sweep, each, in_use=False) for each in (proposed, turned))
    assert not same_boxes(other.boxes.tensor, plain.boxes.tensor)


def same_boxes(one, other):
    """To a millimetre and a thousandth of a radian."""
    if len(one) != len(other):
        return False
    turn = wrap_angle(one[:, 6] - other[:, 6])
    return bool(((one[:, :6] - other[:, :6]).abs() < 1e-3).all() and (turn.abs() < 1e-3).all())


@pytest.mark.parametrize("is_cached", [False, True])
def test_a_training_scores_without_what_is_for_use_alone(is_cached, tmp_path):
    weights = tmp_path / "w.safetensors"
    in_use = replace(
        COMPACT, flip_test=True, axes=HeadingHypothesesConfig(class_names=NAMES, passes=1)
    )
    write_network(weights, in_use)
    detections = []
    for config in (COMPACT, in_use):
        task = Detection3D(config, stages="second", initial_weights=weights).eval()
        cache = None
        if is_cached:
            cache = tmp_path / "cache"
            arguments = [str(PACKAGED_FRAMES), str(cache), "--weights", str(weights)]
            assert main(["proposals", *arguments, "--workers", "1"]) == 0
        examples = Detection3DExamples(
            Detection3DExampleConfig(input=COMPACT.input, class_names=NAMES, changes=None),
            cache=cache,
        )
        batch = examples.prepare(simulated_frames()[0], np.random.default_rng(0), training=False)
        with torch.no_grad():
            detections.append(task.score(batch)[0])
    assert torch.equal(detections[0].boxes.tensor, detections[1].boxes.tensor)
    assert task.network_config() == in_use


@pytest.mark.parametrize(
    ("config", "changes", "message"),
    [
        (TINY, {}, "flip_test is of the compact stages: set it to false, or pillars and no"),
        (
            COMPACT,
            {"regions": replace(COMPACT.regions, canonical=False)},
            "flip_test needs regions in their own frames: set it to false, or",
        ),
        (
            COMPACT,
            {"pillars": replace(COMPACT.pillars, grid=PillarGridConfig(y_m=(-16.0, 32.0)))},
            "as far to the left as to the right, got pillars.grid.y_m -16.0 to 32.0",
        ),
    ],
)
def test_designs_without_mirror_images_are_refused(config, changes, message):
    assert isinstance(config, Detection3DConfig)
    with pytest.raises(ValueError, match=message):
        replace(config, flip_test=True, **changes)
