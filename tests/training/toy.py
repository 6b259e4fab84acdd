"""Smallest possible task: predicts the depth of points by two convolutions."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import lightning
import numpy as np
import torch
from beartype import beartype
from jaxtyping import Float32, jaxtyped
from torch import Tensor, nn
from torchmetrics import Metric

from sightline.geometry.projection import sparse_depth_map
from sightline.structures.batch import FieldwiseBatch
from sightline.structures.sample import CameraLidarSample
from sightline.training.data import CameraLidarData, SamplePreparation
from sightline.training.module import TrainingModule
from sightline.training.optimizer import OptimizerConfig
from sightline.training.sources import SourceConfig
from tests.data import trees


@dataclass(frozen=True, kw_only=True)
class ToyConfig:
    """Settings of the toy network."""

    channels: int = 2
    """Number of channels between its two layers."""
    dropout: float = 0.5
    """Dropout rate; its draws come from the global generator."""


class ToyNet(nn.Module):
    """Two convolutions, with batch normalisation and dropout between them."""

    def __init__(self, config: ToyConfig) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(4, config.channels, 3, padding=1),
            nn.BatchNorm2d(config.channels),
            nn.Dropout(config.dropout),
            nn.Conv2d(config.channels, 1, 1),
        )

    def forward(self, image: Tensor, sparse_depth_m: Tensor) -> Tensor:
        return self.layers(torch.cat((image, sparse_depth_m), dim=1))


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class ToyBatch(FieldwiseBatch):
    """Images and their sparse depth maps."""

    sample_ids: tuple[str, ...]
    image: Float32[Tensor, "batch 3 height width"]
    sparse_depth_m: Float32[Tensor, "batch 1 height width"]


class ToyLosses(NamedTuple):
    """Losses with one term."""

    total: Tensor
    mse: Tensor


class ToyScores(Metric):
    """Mean over samples of their mean squared error."""

    full_state_update = False

    def __init__(self) -> None:
        super().__init__()
        self.add_state("sum", torch.tensor(0.0, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("count", torch.tensor(0), dist_reduce_fx="sum")

    def update(self, errors: Tensor) -> None:
        self.sum += errors.double().sum()
        self.count += len(errors)

    def compute(self) -> dict[str, Tensor]:
        return {"mse": self.sum / self.count}


class ToyModule(TrainingModule):
    """Training of the toy network with the points as targets."""

    task_name: ClassVar[str] = "toy"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = ("validation/mse", "min")

    def __init__(
        self,
        network: ToyConfig = ToyConfig(),
        optimizer: OptimizerConfig = OptimizerConfig(),  # noqa: B008 - frozen
        initial_weights: Path | None = None,
    ) -> None:
        self.config = network
        super().__init__(
            ToyNet(network), ToyScores(), optimizer=optimizer, initial_weights=initial_weights
        )
        self.seen: list[tuple[str, ...]] = []
        self.images: list[float] = []

    def network_config(self) -> ToyConfig:
        return self.config

    def losses(self, batch: ToyBatch) -> ToyLosses:
        self.seen.append(batch.sample_ids)
        self.images.append(float(batch.image.sum()))
        mse = self._errors(batch).mean()
        return ToyLosses(mse, mse)

    def score(self, batch: ToyBatch) -> None:
        self.metric.update(self._errors(batch).flatten(1).mean(dim=1))

    def _errors(self, batch: ToyBatch) -> Tensor:
        predicted = self.network(batch.image, batch.sparse_depth_m)
        return (predicted - batch.sparse_depth_m).square()


class ToyPreparation(SamplePreparation):
    """Preparation that adds noise to the image in training."""

    def __init__(self, noise: float = 0.1) -> None:
        self.noise = noise

    def prepare(
        self, sample: CameraLidarSample, rng: np.random.Generator, *, training: bool
    ) -> ToyBatch:
        image = sample.image.float() / 255
        if training:
            image = image + torch.from_numpy(rng.normal(0, self.noise, image.shape)).float()
        depth = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        return ToyBatch(
            sample_ids=(sample.sample_id,), image=image[None], sparse_depth_m=depth[None, None]
        )


def write_frames(root: Path, count: int = 9) -> Path:
    """Write an object tree of several frames with different images."""
    names = [f"{number:06}" for number in range(count)]
    trees.write_object_tree(root, *names)
    for number, name in enumerate(names):
        trees.write_rgb(root / "training" / "image_2" / f"{name}.png", trees.picture(number))
    return root


def data(root: Path, **settings: object) -> CameraLidarData:
    """Data of two frames per batch; 4 batches in an epoch of 9 frames."""
    sources = (SourceConfig(path=Path()),)
    defaults = {"batch_size": 2, "workers": 0, "root": root, "training": sources}
    return CameraLidarData(ToyPreparation(), **(defaults | settings))


def module(seed: int = 0, *, dropout: float = 0.5, **optimizer: object) -> ToyModule:
    """Module with weights drawn from the seed."""
    lightning.seed_everything(seed, verbose=False)
    settings = {"learning_rate": 0.05, "schedule": "one_cycle", "warm_up_share": 0.3} | optimizer
    return ToyModule(ToyConfig(dropout=dropout), OptimizerConfig(**settings))


def trainer(folder: Path, **settings: object) -> lightning.Trainer:
    """Silent Trainer that writes only checkpoints of given callbacks."""
    defaults = {
        "accelerator": "cpu",
        "devices": 1,
        "logger": False,
        "enable_checkpointing": bool(settings.get("callbacks")),
        "enable_progress_bar": False,
        "enable_model_summary": False,
        "use_distributed_sampler": False,
        "default_root_dir": folder,
        "max_epochs": 2,
    }
    return lightning.Trainer(**(defaults | settings))
