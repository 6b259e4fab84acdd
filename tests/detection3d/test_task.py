"""Detectors in training: that they learn, what is held still, what is logged and drawn."""

from dataclasses import replace
from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

from sightline.data.formats.image_file import read_rgb
from sightline.detection3d.config import Detection3DConfig, Detection3DLossConfig
from sightline.detection3d.examples import Detection3DExampleConfig, Detection3DExamples
from sightline.detection3d.pictures import LABELLED, RIGHT, WRONG, training_picture
from sightline.detection3d.points.config import ProposalConfig, ProposalSamplingConfig
from sightline.detection3d.points.refinement_training import box_loss, confidence_loss
from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig
from sightline.detection3d.task import Detection3D
from sightline.detection3d.training import detection_losses, validation_losses
from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.batch import concatenate
from sightline.structures.predictions import Detections3D
from sightline.training.quiet import LIGHTNING_NOISE
from sightline.visualization.birds_eye import draw_birds_eye
from tests.detection3d.frames import (
    COMPACT,
    NAMES,
    PUBLISHED,
    SWEEP,
    TINY,
    simulated_frames,
    without_refinement,
    write_network,
)

pytestmark = [pytest.mark.filterwarnings(f"ignore:{beginning}") for beginning in LIGHTNING_NOISE]

LOSS = Detection3DLossConfig(sampling=ProposalSamplingConfig(num_samples=16, max_foreground=8))
SETTINGS = Detection3DExampleConfig(
    input=SWEEP, class_names=NAMES, changes=None, targets=SweepTruthConfig(min_points=8)
)


def batch_of(samples, *, training):
    examples, rng = Detection3DExamples(SETTINGS), np.random.default_rng(0)
    return concatenate([examples.prepare(each, rng, training=training) for each in samples])


@pytest.fixture(scope="module")
def frames():
    return simulated_frames()


@pytest.fixture(scope="module")
def batch(frames):
    return batch_of(frames, training=True)


@pytest.fixture(scope="module")
def scored(frames):
    return batch_of(frames, training=False)


def test_both_stages_learn_two_frames_by_heart(batch, scored):
    torch.manual_seed(0)
    task = Detection3D(TINY, loss=LOSS, stages="both")
    first, second = task.network.first, task.network.second
    rates = [(first, 1e-2), (second, 5e-3)]
    groups = [{"params": stage.parameters(), "lr": rate} for stage, rate in rates]
    optimizer = torch.optim.Adam(groups)
    costs = []
    for step in range(160):
        for group, (_, rate) in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate if step < 120 else 0.3 * rate
        optimizer.zero_grad()
        losses = task.losses(batch)
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(task.network.parameters(), 10.0)
        optimizer.step()
        costs.append({name: float(value.detach()) for name, value in losses._asdict().items()})
    assert costs[-1]["first/total"] < 0.2 * costs[0]["first/total"]
    assert costs[-1]["second/boxes"] < 0.3 * max(each["second/boxes"] for each in costs)
    task.network.eval()
    with torch.inference_mode():
        task.score(scored)
    assert float(task.scores()["recall/0.5"]) > 40  # of other seeds 54 to 69


def test_the_first_stage_alone_answers_by_its_proposals(batch, scored):
    task = Detection3D(without_refinement(), stages="first")
    losses = task.losses(batch)
    assert set(losses.terms) == {
        f"first/{name}" for name in ("total", "segmentation", "center", "heading", "size")
    }
    torch.testing.assert_close(losses.total, losses.terms["first/total"])
    task.network.eval()
    with torch.inference_mode():
        detections = task.score(scored)
    assert all(0 < len(each.scores) <= TINY.proposals.num_proposals for each in detections)
    scores = task.scores()
    assert len(scores) == 2 * 3 * 18 + 4  # over 40, 11 and all recall positions
    assert {"Car/3d/moderate", "loose/Car/bev/easy_R11", "recall/0.7"} <= set(scores)


@pytest.mark.parametrize("mode_is_set", [False, True])
def test_a_first_stage_that_is_held_still_does_not_change(batch, mode_is_set):
    torch.manual_seed(0)
    task = Detection3D(TINY, loss=LOSS, stages="second")
    if mode_is_set:  # Lightning sets none
        task.train()
    before = {name: tensor.clone() for name, tensor in task.network.points.state_dict().items()}
    losses = task.losses(batch)
    losses.total.backward()
    assert set(losses.terms) == {"second/total", "second/boxes", "second/confidence"}
    after = task.network.points.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)  # statistics, too
    assert all(each.grad is None for each in task.network.points.parameters())
    assert any(each.grad.abs().sum() > 0 for each in task.network.refinement.parameters())


def test_sweeps_without_points_cost_nothing(frames):
    empty = batch_of([replace(frames[0], points=frames[0].points[:0])], training=True)
    task = Detection3D(TINY, loss=LOSS)
    losses = task.losses(empty)
    losses.total.backward()
    assert float(losses.total.detach()) == 0
    assert all(float(each.grad.abs().sum()) == 0 for each in task.network.parameters())
    both = concatenate([batch_of([frames[0]], training=True), empty])
    task.network.eval()
    alone = detection_losses(task.network, batch_of([frames[0]], training=True), LOSS, "both")
    torch.testing.assert_close(
        detection_losses(task.network, both, LOSS, "both").total, alone.total
    )


def test_ignored_objects_are_no_background(batch):
    """Calling every object ignored leaves no term of segmentation on their points."""
    task = Detection3D(without_refinement(), stages="first")
    task.network.eval()
    truths = tuple(
        replace(
            each,
            boxes=each.boxes[:0],
            classes=each.classes[:0],
            ignored_boxes=torch.cat((each.ignored_boxes, each.boxes)),
            ignored_classes=torch.ones(len(each.ignored_boxes) + len(each.boxes), 3).bool(),
        )
        for each in batch.truths
    )
    ignored = task.losses(replace(batch, truths=truths))
    none = tuple(
        replace(each, ignored_boxes=each.boxes, ignored_classes=each.ignored_classes[:0])
        for each in truths
    )
    background = task.losses(replace(batch, truths=none))
    assert float(ignored.total.detach()) < float(background.total.detach())


class Gallery(lightning.pytorch.loggers.CSVLogger):
    """Takes pictures as Weights & Biases does."""

    def log_image(self, key, images, step=None):
        self.image = (key, len(images), images[0].dtype, step)


def test_every_logger_gets_losses_scores_and_pictures(batch, scored, tmp_path):
    task = Detection3D(TINY, loss=LOSS)
    loaders = [
        DataLoader([0], batch_size=None, collate_fn=lambda _, each=each: each)
        for each in (batch, scored)
    ]
    gallery = Gallery(tmp_path, name="gallery", version="")
    trainer = lightning.Trainer(
        default_root_dir=tmp_path,
        max_steps=1,
        accelerator="cpu",
        logger=[
            lightning.pytorch.loggers.TensorBoardLogger(tmp_path, name="", version=""),
            lightning.pytorch.loggers.CSVLogger(tmp_path, name="csv", version=""),
            gallery,
        ],
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=1,
        num_sanity_val_steps=0,
    )
    trainer.fit(task, *loaders)
    assert gallery.image == ("validation/0", 1, np.uint8, 1)
    (picture,) = (tmp_path / "csv").rglob("*.png")
    assert picture.relative_to(tmp_path / "csv").as_posix() == "pictures/validation/0/0000001.png"
    assert read_rgb(picture).std() > 5
    assert "validation/loose/Car/3d/moderate" in (tmp_path / "csv" / "metrics.csv").read_text()
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"training/total", "training/first/center", "validation/Car/3d/moderate"} <= scalars
    assert {"validation/loose/Car/3d/moderate", "validation/recall/0.5"} <= scalars
    assert {"validation/loose/Car/3d/moderate_R11", "validation/second/total"} <= scalars
    assert events.Tags()["images"] == ["validation/0"]


def test_a_validation_loss_is_that_of_all_proposals_with_points_and_their_objects(scored):
    task = Detection3D(TINY, loss=LOSS).eval()
    task.score(scored)
    losses = validation_losses(task.network, scored, task._proposed, LOSS)
    boxes, logits, targets, ious = [], [], [], []
    for sweep, proposed, truth in zip(scored.points, task._proposed, scored.truths, strict=True):
        regions = task.network.second.regions(sweep, proposed, seed=0)
        output = task.network.second(**regions.inputs)
        for place, box, logit in zip(regions.places, output.boxes, output.logits, strict=True):
            overlaps = pairwise_iou_3d(proposed.boxes[place][None].double(), truth.boxes)[0]
            boxes.append(box)
            logits.append(logit)
            targets.append(truth.boxes[int(overlaps.argmax())].float())
            ious.append(overlaps.max())
    samples = torch.stack(boxes), torch.stack(targets), torch.stack(ious)
    assert len(ious) > 10
    box_term = box_loss(*samples, LOSS.refinement).total
    confidence = confidence_loss(torch.stack(logits), samples[2], LOSS.refinement)
    torch.testing.assert_close(losses.confidence, confidence)
    torch.testing.assert_close(losses.total, box_term + confidence)
    assert validation_losses(Detection3D(COMPACT).network, scored, task._proposed, LOSS) is None


def test_the_picture_tells_right_from_wrong():
    truths = torch.tensor([[20.0, 5, -1, 4, 2, 1.5, 0], [40.0, -5, -1, 4, 2, 1.5, 0]])
    boxes = torch.tensor([[20.1, 5, -1, 4, 2, 1.5, 0], [60.0, -5, -1, 4, 2, 1.5, 0]])
    found = Detections3D(class_names=("Car", "Car"), boxes=Boxes3D(boxes), scores=torch.ones(2))

    def has(picture, color):
        return bool((picture == np.array(color)).all(axis=2).any())

    nothing = torch.zeros(0, 4)
    both = training_picture(nothing, found, truths)
    assert all(has(both, color) for color in (RIGHT, WRONG, LABELLED))
    above_px = draw_birds_eye(nothing).shape[0]
    in_3d = both[above_px + (both.shape[0] - above_px) // 4 :]  # without the titles
    assert in_3d.shape[0] > 200
    for color in (RIGHT, WRONG, LABELLED):  # lines are blended with the ground
        assert np.abs(in_3d.astype(int) - np.array(color)).max(axis=2).min() < 10
    low_scored = replace(found, scores=torch.tensor([0.9, 0.1]))
    assert not has(training_picture(nothing, low_scored, truths), WRONG)
    assert not has(training_picture(nothing, found, truths[:0]), RIGHT)


def test_a_second_stage_starts_from_the_weights_of_a_first(tmp_path):
    path = tmp_path / "rpn.safetensors"
    network = write_network(path, without_refinement())
    task = Detection3D(TINY, stages="second", initial_weights=path, initial_part="points")
    for name, tensor in task.network.points.state_dict().items():
        assert torch.equal(tensor, network.points.state_dict()[name])
    with pytest.raises(ValueError, match="other settings"):
        Detection3D(TINY, initial_weights=path)


def test_a_second_stage_is_not_trained_on_a_first_that_has_learned_nothing():
    task = Detection3D(TINY, stages="second")
    task.trainer = SimpleNamespace()
    task.setup("validate")
    with pytest.raises(ValueError, match=r"initial_weights, with --\S+initial_part points"):
        task.setup("fit")
    task.is_resumed = True
    task.setup("fit")


def test_settings_that_do_not_fit_together_are_refused():
    with pytest.raises(ValueError, match="no second stage to train"):
        Detection3D(without_refinement(), stages="second")
    with pytest.raises(ValueError, match="needs one first stage"):
        Detection3DConfig(pillars=None)
    with pytest.raises(ValueError, match=r"points.backbone.in_channels is 0, expected 1"):
        replace(TINY, input=replace(SWEEP, reflectance=True))
    with pytest.raises(ValueError, match=r"refinement.in_channels is 7, expected 24"):
        replace(TINY, refinement=replace(TINY.refinement, in_channels=7))
    with pytest.raises(ValueError, match="refinement makes layers of 1048576 numbers of a propos"):
        replace(PUBLISHED, proposals=ProposalConfig(num_proposals=1000))
    with pytest.raises(ValueError, match="must be up to 4294967296, got 4194304 times 4096"):
        replace(PUBLISHED, input=SweepConfig(num_points=2**22))


def test_what_predictors_do_otherwise_is_told_and_that_networks_of_points_search_no_whole_turn():
    told = [Detection3D(each).difference_in_use() for each in (COMPACT, TINY)]
    assert all("flip_test, axes and alignment" in each for each in told)
    assert ["whole turns" in each for each in told] == [True, False]
