"""The compact design as a whole: that it learns, by which precision, and which settings fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.augmentation.sweep_changes import GroundShapeConfig
from sightline.cli.main import main
from sightline.detection3d.classes import CAR
from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.detector import propose, refine
from sightline.detection3d.examples import (
    Detection3DExampleConfig,
    Detection3DExamples,
    SceneChangeConfig,
)
from sightline.detection3d.object_sampling import ObjectSamplingConfig
from sightline.detection3d.pillars.config import PillarDetectionConfig
from sightline.detection3d.pillars.region_config import RegionConfig, RegionExamplesConfig
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig
from sightline.detection3d.task import Detection3D
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.batch import concatenate
from sightline.training.data import CameraLidarData
from sightline.training.sources import SourceConfig
from tests.detection3d.frames import COMPACT, NAMES, PUBLISHED, simulated_frames, write_network

SETTINGS = Detection3DExampleConfig(
    input=COMPACT.input, class_names=NAMES, changes=None, targets=SweepTruthConfig(min_points=5)
)
LOSS = Detection3DLossConfig(region_examples=RegionExamplesConfig(num_objects=12))


@pytest.fixture(scope="module")
def frames():
    return simulated_frames()


def batch_of(samples, settings=SETTINGS, *, training=True, seed=0):
    examples, rng = Detection3DExamples(settings), np.random.default_rng(seed)
    return concatenate([examples.prepare(each, rng, training=training) for each in samples])


def test_both_stages_learn_two_frames_of_different_lengths_by_heart_in_bfloat16(frames):
    torch.manual_seed(0)
    batch = batch_of(frames)
    assert len({len(points) for points in batch.points}) == 2
    centers = replace(COMPACT.centers, min_heat=0.1)
    task = Detection3D(replace(COMPACT, centers=centers), loss=LOSS)
    optimizer = torch.optim.Adam(task.network.parameters(), lr=5e-3)
    for step in range(60):
        seeds = tuple(2 * step + number for number in range(2))
        with torch.autocast("cpu", torch.bfloat16):
            losses = task.losses(replace(batch, seeds=seeds))
        optimizer.zero_grad()
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(task.network.parameters(), 10.0)
        optimizer.step()
        for group in optimizer.param_groups:
            group["lr"] = 5e-3 if step < 45 else 1e-3
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16):
        task.score(batch_of(frames, training=False))  # with the batches' own means, still
    assert float(task.scores()["recall/0.5"]) > 60


def test_boxes_are_told_exactly_whatever_the_networks_precision(frames, tmp_path):
    """Means of far boxes, and what an untrained second stage, which changes nothing, leaves."""
    detector = write_network(tmp_path / "w.safetensors", COMPACT)
    sweep = batch_of(frames[:1], training=False).points[0]
    with torch.no_grad():
        output = detector.pillars(**detector.pillars.inputs([sweep]))
        plain = propose(detector, sweep, lambda _: output)[0]
        with torch.autocast("cpu", torch.bfloat16):
            proposed = propose(detector, sweep, lambda _: output)[0]
            found = refine(detector, sweep, proposed)
    assert len(plain.boxes) == 20
    assert torch.equal(proposed.boxes, plain.boxes)
    expected = (plain.scores * 0.5).sqrt().sort(descending=True).values  # a quality of a half
    torch.testing.assert_close(found.scores, expected[: len(found.scores)], atol=1e-6, rtol=0)
    distance = torch.cdist(found.boxes.tensor[:, :3], plain.boxes[:, :3]).amin(dim=1)
    assert distance.max() < 1e-5


def test_a_first_stage_held_still_does_not_change(frames):
    task = Detection3D(COMPACT, loss=LOSS, stages="second")
    task.train()
    before = {name: value.clone() for name, value in task.network.pillars.state_dict().items()}
    losses = task.losses(batch_of(frames[:1]))
    losses.total.backward()
    assert set(losses.terms) == {
        f"second/{name}" for name in ("total", "values", "corners", "front", "quality")
    }
    after = task.network.pillars.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert any(each.grad.abs().sum() > 0 for each in task.network.regions.parameters())


def test_the_second_stage_trains_on_what_sightline_proposals_kept_of_the_first(frames, tmp_path):
    seen = replace(COMPACT.input, reflectance=True)
    grid = replace(COMPACT.pillars.grid, reflectance=True)
    config = replace(
        COMPACT,
        input=seen,
        pillars=replace(COMPACT.pillars, grid=grid),
        regions=replace(COMPACT.regions, in_channels=1),
    )
    weights, cache = tmp_path / "w.safetensors", tmp_path / "cache"
    write_network(weights, config)
    command = ["proposals", str(PACKAGED_FRAMES), str(cache), "--weights", str(weights)]
    assert main([*command, "--workers", "1"]) == 0
    task = Detection3D(config, loss=LOSS, stages="second", initial_weights=weights)
    examples = Detection3DExamples(replace(SETTINGS, input=seen), cache=cache)
    batch = examples.prepare(frames[0], np.random.default_rng(0), training=True)
    task.eval()
    by_cache = task.losses(batch)
    by_stage = task.losses(replace(batch, records=None))
    torch.testing.assert_close(by_cache.total, by_stage.total)


CHANGES = SceneChangeConfig(
    ground=GroundShapeConfig(), range_noise_m=0.01, objects=ObjectSamplingConfig(), bank_frames=2
)


def pasted_batch(changes, workers):
    """The first batch of a training on the embedded frames."""
    data = CameraLidarData(
        Detection3DExamples(replace(SETTINGS, changes=changes)),
        root=PACKAGED_FRAMES,
        training=(SourceConfig(path=Path()),),
        batch_size=2,
        workers=workers,
    )
    return next(iter(data.train_dataloader()))


def test_pasted_objects_are_the_same_at_each_start_and_for_any_number_of_workers():
    first, again, without = (
        pasted_batch(changes, workers)
        for changes, workers in ((CHANGES, 0), (CHANGES, 1), (replace(CHANGES, objects=None), 0))
    )
    for one, other in zip(first.points, again.points, strict=True):
        assert torch.equal(one, other)
    for one, other in zip(first.truths, again.truths, strict=True):
        assert torch.equal(one.boxes, other.boxes)
    many, few = (sum(len(truth.boxes) for truth in each.truths) for each in (first, without))
    assert many > few


def test_points_that_are_not_canonical_are_told_where_they_are(frames):
    plain = replace(COMPACT, regions=replace(COMPACT.regions, canonical=False))
    task = Detection3D(plain, loss=LOSS, stages="both")
    points = batch_of(frames[:1]).points[0]
    proposed = Proposed(torch.tensor([[8.0, 0, -1, 4, 2, 2, 0.3]]), torch.tensor([0]),
                        torch.ones(1))  # fmt: skip
    region_points = task.network.regions.regions(points, proposed, seed=0).inputs["points"]
    assert region_points.shape == (1, 48, 3)
    assert (torch.cdist(region_points[0], points[:, :3]).amin(dim=1) < 1e-3).all()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pillars": None}, "needs one first stage: set pillars or points"),
        ({"points": PUBLISHED.points}, "needs one first stage: set pillars or points"),
        ({"refinement": PUBLISHED.refinement}, "at most one second stage: set refinement or"),
        ({"input": SweepConfig(reflectance=True)}, r"pillars\.grid\.reflectance is False, but"),
        ({"regions": RegionConfig(in_channels=1)}, r"regions\.in_channels is 1, expected 0"),
        ({"regions": RegionConfig(classes=(CAR,))}, r"regions\.classes are Car, expected the"),
        (
            {
                "regions": RegionConfig(num_points=16_384),
                "centers": PillarDetectionConfig(max_boxes=1000),
            },
            r"regions makes layers of 3145728 numbers of a proposal, .* centers\.max_boxes allows",
        ),
    ],
)
def test_stages_that_do_not_fit_together_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        replace(COMPACT, **wrong)
    with pytest.raises(ValueError, match=r"input\.num_points must be a number where points"):
        replace(PUBLISHED, input=SweepConfig(num_points=None))


def test_examples_take_input_and_classes_of_the_network_and_refuse_others():
    def settings_for(settings):
        return Detection3DExamples(settings).for_network(COMPACT).settings

    assert settings_for(replace(SETTINGS, input=None, class_names=None)) == SETTINGS
    assert settings_for(SETTINGS) == SETTINGS
    with pytest.raises(ValueError, match=r"settings\.input is .*, expected the network's"):
        settings_for(replace(SETTINGS, input=SweepConfig()))
    with pytest.raises(ValueError, match=r"settings\.class_names is \('Car',\), expected the"):
        settings_for(replace(SETTINGS, class_names=("Car",)))
