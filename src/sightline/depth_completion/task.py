"""Training and scoring of the depth completion networks."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.examples import DepthBatch, DepthExamples
from sightline.depth_completion.loss import DepthLossConfig, DepthLosses, depth_completion_loss
from sightline.depth_completion.model import DepthCompletionNet, DepthCompletionOutput
from sightline.depth_completion.pictures import training_picture
from sightline.depth_completion.postprocess import FARTHEST_M, NEAREST_M
from sightline.depth_completion.unet import UNet, start_from_detector
from sightline.evaluation.depth_metric import DepthCompletionScores
from sightline.training.initial_weights import choose_settings
from sightline.training.module import TrainingModule
from sightline.training.optimizer import OptimizerConfig

_LOGGED_SCORES = ("rmse_mm", "mae_mm", "irmse_per_km", "imae_per_km")  # the benchmark's scores
_LOSS, _OPTIMIZER = DepthLossConfig(), OptimizerConfig()


class DepthCompletion(TrainingModule):
    """Training of depth completion, with the scores of KITTI's benchmark."""

    task_name: ClassVar[str] = "depth-completion"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = ("validation/rmse_mm", "min")
    network: DepthCompletionNet

    def __init__(
        self,
        network: DepthCompletionConfig | None = None,
        loss: DepthLossConfig = _LOSS,
        optimizer: OptimizerConfig = _OPTIMIZER,
        initial_weights: Path | None = None,
        detector_weights: Path | None = None,
    ) -> None:
        """Build the network.

        Args:
            network: Settings of the network. None: those of the initial weights; without them, the
                paper's.
            loss: Weights of the losses.
            optimizer: Settings of the optimiser.
            initial_weights: Weights of such a network to start from: name of shipped ones, file or
                checkpoint.
            detector_weights: Weights of an image detector whose camera stream a U-Net starts from,
                unless there are initial weights.

        Raises:
            ValueError: The weights cannot be read or belong to another network.
        """
        settings = choose_settings(
            network, DepthCompletionConfig, initial_weights, task_name=self.task_name
        )
        untrained = DepthCompletionNet(settings)
        untrained.start_at_constant_depth()
        super().__init__(
            untrained,
            DepthCompletionScores(),
            optimizer=optimizer,
            initial_weights=initial_weights,
        )
        self.loss = loss
        self.detector_weights = None if initial_weights is not None else detector_weights

    def network_config(self) -> DepthCompletionConfig:
        """The network's settings."""
        config: DepthCompletionConfig = self.network.config
        return config

    def forward(self, batch: DepthBatch) -> DepthCompletionOutput:
        """Run the network on a batch.

        Raises:
            ValueError: The network starts from a classical completion, which the batch lacks.
        """
        if self.network.takes_filled_depth and batch.filled_depth_m is None:
            raise ValueError(
                "the network starts from a classical completion, but the examples hold none; set "
                "filled to true in the examples' config"
            )
        output: DepthCompletionOutput = self.network(
            batch.image, batch.sparse_depth_m, batch.filled_depth_m
        )
        return output

    def setup(self, stage: str) -> None:
        """Check the examples, and load the detector's stream when a training starts.

        Raises:
            ValueError: The examples have another completion or focal length than the network, or
                the detector's weights cannot be loaded.
        """
        super().setup(stage)
        if stage == "fit" and not self.is_resumed and self.detector_weights is not None:
            if not isinstance(self.network.trunk, UNet):
                raise ValueError("detector_weights start a U-Net: set network.unet")
            start_from_detector(self.network.trunk, self.detector_weights)
        preparation = getattr(getattr(self.trainer, "datamodule", None), "preparation", None)
        if not isinstance(preparation, DepthExamples) or not self.network.takes_filled_depth:
            return
        for name in ("filling", "focal_px"):
            given = getattr(preparation.settings, name)
            needed = getattr(self.network.config, name)
            if given != needed:
                raise ValueError(
                    f"the preparation's settings.{name} is {given}, expected the network's "
                    f"{needed}; set both to the same "
                    f"(--data.init_args.preparation.init_args.settings.{name} and "
                    f"--model.init_args.network.{name})"
                )

    def losses(self, batch: DepthBatch) -> DepthLosses:
        """Compute the loss of a batch and its terms."""
        return depth_completion_loss(
            self(batch),
            _truth(batch),
            self.loss,
            step=self.global_step,
            dense_truth_m=batch.dense_depth_m,
            weight=batch.weight,
        )

    def score(self, batch: DepthBatch) -> DepthCompletionOutput:
        """Score a batch."""
        output: DepthCompletionOutput = self(batch)
        clamped = output.depth_m.float().clamp(NEAREST_M, FARTHEST_M)
        self.metric.update(clamped[:, 0], _truth(batch)[:, 0])
        return output

    def scores(self) -> Mapping[str, Tensor]:
        """Return the benchmark's scores."""
        means = super().scores()
        return {name: means[name] for name in _LOGGED_SCORES}

    def difference_in_use(self) -> str | None:
        """Name the crop and the truth, and what predictors use beside the network."""
        return (
            "scored are the crop and the truth of the preparation's settings; predictors complete "
            "whole images, with keep_measured, flip_test and smoothing where the network's "
            "settings have them"
        )

    def picture(
        self, batch: DepthBatch, prediction: DepthCompletionOutput
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Draw the maps of the first sample, one below the other."""
        return training_picture(batch, prediction)


def _truth(batch: DepthBatch) -> Tensor:
    assert batch.depth_m is not None, "examples hold the truth"
    return batch.depth_m
