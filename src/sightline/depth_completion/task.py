"""Training and scoring of the depth completion networks."""

from pathlib import Path
from typing import ClassVar, Literal

from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor

from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.loss import DepthLossConfig, depth_completion_loss
from sightline.depth_completion.model import DepthCompletionNet, DepthCompletionOutput
from sightline.depth_completion.pictures import training_picture
from sightline.depth_completion.postprocess import FARTHEST_M, NEAREST_M
from sightline.evaluation.depth_metric import DepthCompletionScores
from sightline.structures.batch import CameraLidarBatch
from sightline.training.module import OptimizerConfig, TrainingModule

_PICTURES = 4  # validation samples that are drawn
_NETWORK, _LOSS, _OPTIMIZER = DepthCompletionConfig(), DepthLossConfig(), OptimizerConfig()


class DepthCompletion(TrainingModule):
    """Depth completion in training.

    Logs each part of the loss, the benchmark's scores on validation samples, and pictures of the
    first few of those.
    """

    task_name: ClassVar[str] = "depth-completion"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = ("validation/rmse_mm", "min")
    network: DepthCompletionNet

    def __init__(
        self,
        network: DepthCompletionConfig = _NETWORK,
        loss: DepthLossConfig = _LOSS,
        optimizer: OptimizerConfig = _OPTIMIZER,
        initial_weights: Path | None = None,
    ) -> None:
        """Builds the network.

        Args:
            network: What is trained.
            loss: What it is told.
            optimizer: How its weights are updated.
            initial_weights: Such a network's weights to start from: name of shipped ones, file or
                checkpoint.

        Raises:
            ValueError: The initial weights cannot be read or are another network's.
        """
        super().__init__(
            DepthCompletionNet(network), optimizer=optimizer, initial_weights=initial_weights
        )
        self.loss = loss
        self.scores = DepthCompletionScores()

    def network_config(self) -> DepthCompletionConfig:
        """The network's settings."""
        config: DepthCompletionConfig = self.network.config
        return config

    def forward(self, batch: CameraLidarBatch) -> DepthCompletionOutput:
        """What the network gives for a batch."""
        if self.network.takes_filled_depth and batch.filled_depth_m is None:
            raise ValueError(
                "the network starts from a classical completion, but the examples hold none; set "
                "filled to true in the examples' config"
            )
        output: DepthCompletionOutput = self.network(
            batch.image, batch.sparse_depth_m, batch.filled_depth_m
        )
        return output

    def training_step(self, batch: CameraLidarBatch, batch_idx: int) -> Tensor:
        """The loss of a batch."""
        del batch_idx
        losses = depth_completion_loss(self(batch), _truth(batch), self.loss, step=self.global_step)
        self.log_dict(
            {f"training/{name}": value for name, value in losses._asdict().items()},
            batch_size=len(batch),
        )
        self.log("loss", losses.total, prog_bar=True, logger=False, batch_size=len(batch))
        return losses.total

    def validation_step(self, batch: CameraLidarBatch, batch_idx: int) -> None:
        """Scores a batch, and draws the first few."""
        output = self._score(batch)
        if batch_idx < _PICTURES and isinstance(self.logger, TensorBoardLogger):
            self.logger.experiment.add_image(
                f"validation/{batch_idx}",
                training_picture(batch, output),
                self.global_step,
                dataformats="HWC",
            )

    def on_validation_epoch_end(self) -> None:
        """Logs the scores."""
        self._log_scores("validation")

    def test_step(self, batch: CameraLidarBatch, batch_idx: int) -> None:
        """Scores a batch."""
        del batch_idx
        self._score(batch)

    def on_test_epoch_end(self) -> None:
        """Logs the scores."""
        self._log_scores("test")

    def _score(self, batch: CameraLidarBatch) -> DepthCompletionOutput:
        output: DepthCompletionOutput = self(batch)
        clamped = output.depth_m.float().clamp(NEAREST_M, FARTHEST_M)
        self.scores.update(clamped[:, 0], _truth(batch)[:, 0])
        return output

    def _log_scores(self, stage: str) -> None:
        means = self.scores.compute()
        self.scores.reset()
        names = ("rmse_mm", "mae_mm", "irmse_per_km", "imae_per_km")
        # float32: not every accelerator has more
        values = {f"{stage}/{name}": means[name].float() for name in names}
        self.log_dict(values, prog_bar=stage == "validation")


def _truth(batch: CameraLidarBatch) -> Tensor:
    assert batch.depth_m is not None, "examples hold the truth"
    return batch.depth_m
