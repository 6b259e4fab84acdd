from dataclasses import replace
from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch
import yaml
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

from sightline.data.open import open_dataset
from sightline.detection2d.config import PAPER, Detection2DConfig, DgfnConfig
from sightline.detection2d.examples import DetectionExamples
from sightline.detection2d.loss import detection_loss
from sightline.detection2d.task import Detection2D
from sightline.files.settings import config_to_dict
from sightline.files.weights import write_weights
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.batch import concatenate
from sightline.tasks import PACKAGE_RECIPES
from sightline.training.optimizer import OptimizerConfig, make_optimizer
from sightline.training.quiet import LIGHTNING_NOISE
from tests.detection2d.frames import SIZE, TINY, painted_frame, whole_frames, write_network

pytestmark = [pytest.mark.filterwarnings(f"ignore:{beginning}") for beginning in LIGHTNING_NOISE]


def batch_of(samples, settings):
    examples = DetectionExamples(settings)
    rng = np.random.default_rng(0)
    return concatenate([examples.prepare(each, rng, training=False) for each in samples])


@pytest.fixture(scope="module")
def batch():
    frames = [painted_frame(number) for number in range(4)]
    return batch_of(frames, whole_frames(SIZE))


def train(task, batch, steps, learning_rate):
    optimizer = torch.optim.Adam(task.network.parameters(), lr=learning_rate, betas=(0.9, 0.99))
    costs = []
    for step in range(steps):
        factor = min(1, (step + 1) / 5) * (1 if step < 0.7 * steps else 0.3)
        optimizer.param_groups[0]["lr"] = learning_rate * factor
        optimizer.zero_grad()
        losses = task.losses(batch)
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(task.network.parameters(), 10.0)
        optimizer.step()
        costs.append(float(losses.total.detach()))
    return costs


def scores_of(task, batch):
    task.network.eval()
    with torch.inference_mode():
        task.score(batch)
    return {name: float(value) for name, value in task.scores().items()}


def test_the_papers_network_learns_two_frames_by_heart():
    batch = batch_of([painted_frame(0), painted_frame(1)], whole_frames(SIZE))
    torch.manual_seed(0)
    task = Detection2D(replace(TINY, width=0.0625))
    train(task, batch, steps=120, learning_rate=1e-3)
    # Over all points: AP over 40 recall positions needs more than 40 objects to come near 100.
    assert scores_of(task, batch)["Car/bbox/moderate_all_points"] > 90


@pytest.mark.parametrize("num_updates", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_gates_of_the_quarter_recipe_stay_open_over_the_first_updates(num_updates):
    recipe = yaml.safe_load((PACKAGE_RECIPES / "detection2d-dgfn-quarter.yaml").read_text())
    optimizer = OptimizerConfig(**recipe["model"]["init_args"]["optimizer"])
    two = batch_of([painted_frame(0), painted_frame(1)], whole_frames(SIZE))
    torch.manual_seed(0)
    dgfn = DgfnConfig(batch_norm=True)  # features of length 20, so that gates move faster
    task = Detection2D(replace(TINY, dgfn=dgfn), optimizer=optimizer)
    stepper = make_optimizer(task.network.named_parameters(), optimizer)
    lowest, costs = [], []
    for _ in range(num_updates):
        stepper.zero_grad()
        outputs = task.network.run_heads(two.image, two.lidar)
        losses = detection_loss(outputs, two, task.loss, compact=False)
        losses.total.backward()
        torch.nn.utils.clip_grad_norm_(task.network.parameters(), 10.0)
        stepper.step()
        costs.append(float(losses.total.detach()))
        lowest.append(min(float(each.detach().sigmoid().mean()) for each in outputs.gates[0]))
    assert lowest[0] == pytest.approx(0.5, abs=0.05)
    assert min(lowest) > 0.2  # at the full rate 0.01 after six updates
    assert costs[-1] < 0.7 * costs[0]


def test_only_the_images_scores_are_logged(batch):
    scores = scores_of(Detection2D(TINY), batch)
    assert len(scores) == 3 * 9  # over 40, 11 and all recall positions
    assert all("/bbox/" in name for name in scores)


def test_tensorboard_gets_losses_scores_and_pictures(batch, tmp_path):
    task = Detection2D(TINY)
    loader = DataLoader([0], batch_size=None, collate_fn=lambda _: batch)
    trainer = lightning.Trainer(
        default_root_dir=tmp_path,
        max_steps=1,
        accelerator="cpu",
        logger=lightning.pytorch.loggers.TensorBoardLogger(tmp_path, name="", version=""),
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        log_every_n_steps=1,
        num_sanity_val_steps=0,
    )
    trainer.fit(task, loader, loader)
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"training/total", "training/boxes", "validation/Car/bbox/moderate"} <= scalars
    assert "validation/Car/bbox/moderate_all_points" in scalars
    assert events.Tags()["images"] == ["validation/0"]


def test_a_picture_shows_both_inputs_and_both_gates(batch):
    task = Detection2D(TINY)
    with torch.inference_mode():
        output = task.score(batch)
    picture = task.picture(batch, output)
    title_px = 22
    row_px = SIZE[0] + title_px
    assert picture.shape == (4 * row_px, SIZE[1], 3)
    np.testing.assert_array_equal(
        picture[row_px + title_px : 2 * row_px],
        (batch.lidar[0].permute(1, 2, 0) * 255).round().byte(),
    )
    assert all(picture[row * row_px : row * row_px + title_px].max() > 200 for row in range(4))
    without = task.picture(batch, output._replace(camera_gate=None, lidar_gate=None))
    np.testing.assert_array_equal(without, picture[: 2 * row_px])


def attached(task, **data):
    """A task whose Trainer has such data."""
    task.trainer = lightning.Trainer(logger=False, enable_checkpointing=False, accelerator="cpu")
    task.trainer.datamodule = SimpleNamespace(**data)
    return task


def test_vgg_weights_are_taken_when_a_training_begins_and_only_then(tmp_path):
    task = attached(Detection2D(TINY, vgg_weights=str(tmp_path / "absent.pth")))
    task.setup("validate")
    with pytest.raises(ValueError, match="fit a network of width 1"):
        task.setup("fit")


def test_initial_weights_go_before_those_of_vgg(tmp_path, capsys):
    path, vgg = tmp_path / "w.safetensors", str(tmp_path / "absent.pth")
    whole = write_network(path)
    task = attached(Detection2D(initial_weights=path, vgg_weights=vgg))
    task.load_start()  # as before step 0
    task.setup("fit")
    for name, tensor in task.network.state_dict().items():
        assert torch.equal(tensor, whole.state_dict()[name])
    line = f"the training starts from {path}, not from VGG16's weights ({vgg})\n"
    assert capsys.readouterr().err == line


def test_streams_are_taken_over_the_weights_when_a_training_begins_and_only_then(tmp_path):
    whole = write_network(tmp_path / "w.safetensors")
    torch.manual_seed(1)
    other = Detection2D(TINY).network
    write_weights(
        tmp_path / "other.safetensors",
        other.state_dict(),
        task="detection2d",
        config=config_to_dict(TINY),
        provenance={},
    )
    task = attached(
        Detection2D(
            initial_weights=tmp_path / "w.safetensors",
            initial_streams={"lidar": tmp_path / "other.safetensors"},
        )
    )
    for stage, lidar in (("validate", whole), ("fit", other)):
        task.setup(stage)
        for name, tensor in task.network.state_dict().items():
            source = lidar if name.startswith("streams.lidar.") else whole
            assert torch.equal(tensor, source.state_dict()[name])


def test_a_training_starts_from_the_weights_of_another(tmp_path):
    network = write_network(tmp_path / "w.safetensors")
    started = Detection2D(initial_weights=tmp_path / "w.safetensors")
    assert started.network_config() == TINY
    for name, tensor in started.network.state_dict().items():
        assert torch.equal(tensor, network.state_dict()[name])
    other = replace(TINY, fusion="ones")
    with pytest.raises(ValueError, match=r"other settings .*\(fusion gated .*network null"):
        Detection2D(other, initial_weights=tmp_path / "w.safetensors")


@pytest.mark.slow
def test_the_papers_network_takes_ten_steps_of_its_own_training():
    samples = open_dataset(PACKAGED_FRAMES, parts={"image", "points", "objects"})
    batch = batch_of([samples[0]], whole_frames(PAPER.input.size))
    torch.manual_seed(0)
    optimizer = OptimizerConfig(name="sgd", learning_rate=3e-4, weight_decay=5e-4)
    task = Detection2D(PAPER, optimizer=optimizer)
    update = task.configure_optimizers()
    costs = []
    for _ in range(10):
        update.zero_grad()
        losses = task.losses(batch)
        losses.total.backward()
        update.step()
        costs.append(float(losses.total.detach()))
    assert all(np.isfinite(costs))
    assert costs[-1] < costs[0]


def test_weights_of_another_task_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    write_weights(path, {"a": torch.zeros(1)}, task="tarot", config={}, provenance={})
    with pytest.raises(ValueError, match="is of task tarot, expected detection2d"):
        Detection2D(TINY, initial_weights=path)


def test_frames_that_predictors_search_in_bands_are_named_but_for_networks_of_one_size():
    told = Detection2D(Detection2DConfig()).difference_in_use()
    assert "from 975 px of focal length, or of more than 440 rows once shrunk to 750 px" in told
    assert Detection2D(TINY).difference_in_use() is None
