import json
from dataclasses import asdict, replace

import lightning
import numpy as np
import pytest
import torch
from lightning.pytorch.loggers import TensorBoardLogger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from torch.utils.data import DataLoader

from sightline.data.open import open_dataset
from sightline.depth_completion.config import DepthCompletionConfig, TrunkConfig
from sightline.depth_completion.examples import AugmentationConfig, ExampleConfig, make_example
from sightline.depth_completion.loss import DepthLossConfig
from sightline.depth_completion.pictures import training_picture
from sightline.depth_completion.task import DepthCompletion
from sightline.evaluation.depth_scores import score_depth
from sightline.files.weights import write_weights
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.training.optimizer import OptimizerConfig
from sightline.training.quiet import LIGHTNING_NOISE

pytestmark = [pytest.mark.filterwarnings(f"ignore:{beginning}") for beginning in LIGHTNING_NOISE]

NETWORK = DepthCompletionConfig(
    trunk=TrunkConfig(channels=(4, 6), modules=1, blocks=1, exchange="neighbours"),
    stem_channels=4,
    trunk_stride=4,
    filled_input=True,
    residual=True,
    uncertainty=True,
)
LOSS = DepthLossConfig(unit_m=1.0, mse=0.0, l1=1.0, emd=0.0, uncertainty=0.1)


@pytest.fixture(scope="module")
def example():
    sample = open_dataset(PACKAGED_FRAMES, parts={"image", "points", "depth"})[0]
    fixed = AugmentationConfig(random_crop=False)
    settings = ExampleConfig(truth="both", filled=True, crop_size=(256, 512), augmentation=fixed)
    return make_example(sample, settings, np.random.default_rng(0), training=True)


@pytest.fixture
def task():
    torch.manual_seed(0)
    return DepthCompletion(NETWORK, LOSS, OptimizerConfig(learning_rate=3e-3))


def loader(example):
    return DataLoader([0], batch_size=None, collate_fn=lambda _: example)


def train(task, example, folder, steps):
    trainer = lightning.Trainer(
        default_root_dir=folder,
        max_epochs=steps,
        accelerator="cpu",
        logger=TensorBoardLogger(folder, name="", version=""),
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        check_val_every_n_epoch=steps,
        log_every_n_steps=1,
    )
    trainer.fit(task, loader(example), loader(example))
    return trainer


def test_training_lowers_the_error_below_the_classical_completion(task, example, tmp_path):
    classical = score_depth(
        example.filled_depth_m[0, 0].numpy(), example.depth_m[0, 0].numpy()
    ).rmse_mm
    trainer = train(task, example, tmp_path, steps=30)
    assert trainer.callback_metrics["validation/rmse_mm"] < 0.98 * classical


def test_before_training_it_scores_as_the_classical_completion(task, example):
    trainer = lightning.Trainer(accelerator="cpu", logger=False, enable_progress_bar=False)
    (scores,) = trainer.test(task, loader(example), verbose=False)
    clamped = example.filled_depth_m[0, 0].clamp(0.5, 120).numpy()
    expected = score_depth(clamped, example.depth_m[0, 0].numpy())
    assert scores["test/rmse_mm"] == pytest.approx(expected.rmse_mm, rel=1e-5)
    assert scores["test/mae_mm"] == pytest.approx(expected.mae_mm, rel=1e-5)


def test_weights_from_before_a_setting_of_the_trunk_can_be_started_from(task, tmp_path):
    config = json.loads(json.dumps(asdict(NETWORK)))
    del config["trunk"]["head_kernel_px"]
    tensors, file = task.network.state_dict(), tmp_path / "w.safetensors"
    write_weights(file, tensors, task="depth-completion", config=config, provenance={})
    started = DepthCompletion(NETWORK, LOSS, OptimizerConfig(), initial_weights=file)
    for name, tensor in started.network.state_dict().items():
        assert torch.equal(tensor, tensors[name])


def test_tensorboard_gets_losses_scores_and_pictures(task, example, tmp_path):
    train(task, example, tmp_path, steps=1)
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    scalars = set(events.Tags()["scalars"])
    assert {"training/total", "training/l1", "validation/rmse_mm"} <= scalars
    assert events.Tags()["images"] == ["validation/0"]


def test_a_picture_shows_every_map_that_there_is(task, example):
    output = task.eval()(example)
    picture = training_picture(example, output)
    maps = 3 + 2 + 1  # image, sparse, E-Point; depth, uncertainty; error
    row_px = 256 + 22  # with its title
    assert picture.shape == (maps * row_px, 512, 3)
    without = training_picture(replace(example, depth_m=None), output._replace(e_point_m=None))
    assert without.shape == ((maps - 2) * row_px, 512, 3)


def test_examples_without_the_completion_that_the_network_needs_are_refused(task, example):
    with pytest.raises(ValueError, match="set filled to true"):
        task(replace(example, filled_depth_m=None))


def test_predictors_complete_more_than_the_scored_crop_and_this_is_told(task):
    assert "predictors complete whole images, with keep_measured" in task.difference_in_use()
