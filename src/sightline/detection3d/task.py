"""Training and scoring of the 3D detectors."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor, nn

from sightline.data.formats.kitti_conversion import kitti_from_detections
from sightline.detection3d.config import Detection3DConfig, Detection3DLossConfig
from sightline.detection3d.detector import Detector3D, propose, refine
from sightline.detection3d.examples import (
    Detection3DBatch,
)
from sightline.detection3d.pictures import training_picture
from sightline.detection3d.proposal_cache import REMEDY, first_stage_identity
from sightline.detection3d.stages import Proposed
from sightline.detection3d.training import (
    ProposalRecallMetric,
    StageLosses,
    Stages,
    detection_losses,
    validation_losses,
)
from sightline.evaluation.kitti_object_metric import KittiObjectMetric
from sightline.evaluation.kitti_object_rules import LOOSE
from sightline.structures.batch import Batch
from sightline.structures.predictions import Detections3D
from sightline.training.initial_weights import choose_settings
from sightline.training.module import TrainingModule
from sightline.training.optimizer import OptimizerConfig

_LOSS, _OPTIMIZER = Detection3DLossConfig(), OptimizerConfig()


class Detection3D(TrainingModule):
    """3D detection in training: scored by KITTI's rules, AP over 40 recall positions in percent.

    `Car/3d/moderate` uses KITTI's overlap (0.7 for cars), `loose/Car/3d/moderate` a lower one (0.5
    for cars); `recall/0.5` is the first stage's recall.
    """

    task_name: ClassVar[str] = "detection3d"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = ("validation/Car/3d/moderate", "max")
    monitored_beside: ClassVar[tuple[str, ...]] = ("validation/Car/3d/moderate_all_points",)
    network: Detector3D

    def __init__(
        self,
        network: Detection3DConfig | None = None,
        loss: Detection3DLossConfig = _LOSS,
        optimizer: OptimizerConfig = _OPTIMIZER,
        stages: Stages = "both",
        initial_weights: Path | None = None,
        initial_part: str | None = None,
    ) -> None:
        """Build the network.

        Args:
            network: Settings of the network. None: the network of the initial weights; without
                those, the design that ships.
            loss: Settings of the losses.
            optimizer: Settings of the optimizer.
            stages: Whether to train both stages at once, the first alone, or the second on a frozen
                first stage, whose weights must then come from initial_weights.
            initial_weights: Weights to start from: name of shipped ones, file or checkpoint.
            initial_part: Stage that takes the initial weights, by the name of its settings, such as
                points. None: the whole network.

        Raises:
            ValueError: The initial weights cannot be read or are another network's, or there is no
                second stage to train.
        """
        settings = choose_settings(
            network, Detection3DConfig, initial_weights, task_name=self.task_name
        )
        super().__init__(
            Detector3D(replace(settings, alignment=())),
            KittiObjectMetric(),
            optimizer=optimizer,
            initial_weights=initial_weights,
            initial_part=initial_part,
        )
        if stages == "second" and self.network.second_name is None:
            raise ValueError(
                "the network has no second stage to train: set "
                "--model.init_args.network.refinement or --model.init_args.network.regions"
            )
        self.loss = loss
        self.stages: Stages = stages
        self.loose_metric = KittiObjectMetric(LOOSE)
        self.recall_metric = ProposalRecallMetric()
        self._has_first_stage = initial_weights is not None
        self._identity: str | None = None  # the frozen first stage's
        self._proposed: list[Proposed] = []  # of the batch scored last
        for stage in self._still:
            stage.requires_grad_(requires_grad=False).eval()

    @property
    def _still(self) -> list[nn.Module]:
        """Frozen stages."""
        frozen = {"both": None, "first": self.network.second, "second": self.network.first}
        stage = frozen[self.stages]
        return [] if stage is None else [stage]

    def network_config(self) -> Detection3DConfig:
        """Return the network's settings."""
        config: Detection3DConfig = self.network.config
        return config

    def setup(self, stage: str) -> None:
        """Check that a frozen first stage has weights.

        Raises:
            ValueError: The first stage is frozen, and neither initial weights nor a checkpoint are
                named.
        """
        has_first_stage = self._has_first_stage or self.is_resumed
        if stage == "fit" and self.stages == "second" and not has_first_stage:
            raise ValueError(
                "stages second trains on a first stage that is held still: name its weights by "
                "--model.init_args.initial_weights, with --model.init_args.initial_part "
                f"{self.network.first_name}"
            )

    def train(self, mode: bool = True) -> "Detection3D":  # noqa: FBT001 - as PyTorch's
        """Set the mode; frozen stages stay in evaluation mode."""
        super().train(mode)
        for stage in self._still:
            stage.eval()
        return self

    def losses(self, batch: Detection3DBatch) -> StageLosses:
        """Compute the losses of a batch."""
        self._check_records(batch)
        return detection_losses(self.network, batch, self.loss, self.stages)

    def score(self, batch: Detection3DBatch) -> list[Detections3D]:
        """Score a batch."""
        assert batch.frames is not None, "examples to score hold the frames' truth"
        self._check_records(batch)
        detections, self._proposed = [], []
        for number, points in enumerate(batch.points):
            if batch.records is not None:
                proposed = batch.records[number].proposed
            else:
                proposed = propose(self.network, points, in_use=False)[0]
            self._proposed.append(proposed)
            detections.append(refine(self.network, points, proposed, in_use=False))
        results = [
            kitti_from_detections(found, frame.calibration.to("cpu"), frame.image_size)
            for found, frame in zip(detections, batch.frames, strict=True)
        ]
        labels = [frame.objects for frame in batch.frames]
        self.metric.update(results, labels)
        self.loose_metric.update(results, labels)
        self.recall_metric.update(
            [each.boxes for each in self._proposed], [truth.boxes for truth in batch.truths]
        )
        return detections

    def validation_step(self, batch: Batch | None, batch_idx: int) -> None:
        """Score a batch, and log the plain second stage's losses over all its proposals."""
        super().validation_step(batch, batch_idx)
        if not isinstance(batch, Detection3DBatch):  # only other ranks have samples left
            return
        losses = validation_losses(self.network, batch, self._proposed, self.loss)
        if losses is not None:
            terms = {f"validation/second/{k}": value for k, value in losses._asdict().items()}
            self.log_dict(terms, batch_size=len(batch))

    def scores(self) -> Mapping[str, Tensor]:
        """Compute 3D and BEV AP by class and difficulty at both overlaps, and recall."""
        strict: Mapping[str, Tensor] = super().scores()
        loose = {f"loose/{name}": value for name, value in self.loose_metric.compute().items()}
        scores_3d = {
            name: value for name, value in {**strict, **loose}.items() if "/bbox/" not in name
        }
        return {**scores_3d, **self.recall_metric.compute()}

    def on_validation_epoch_end(self) -> None:
        """Log the scores."""
        super().on_validation_epoch_end()
        self._reset_metrics()

    def on_test_epoch_end(self) -> None:
        """Log the scores."""
        super().on_test_epoch_end()
        self._reset_metrics()

    def score_notes(self) -> tuple[str, ...]:
        """Notes on classes with too few objects for R40."""
        assert isinstance(self.metric, KittiObjectMetric), "as the constructor made it"
        return self.metric.notes(self.monitored[0])

    def difference_in_use(self) -> str | None:
        """Name what predictors use beside the network in one view."""
        around = "search whole turns of the LiDAR and " if self.network.config.pillars else ""
        return (
            f"only the camera's view is scored; predictors {around}use flip_test, axes and "
            "alignment where the network's settings have them"
        )

    def picture(
        self, batch: Detection3DBatch, output: list[Detections3D]
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Draw the first sweep of a batch from above, with detections and ground truth."""
        truth, points = batch.truths[0], batch.points[0]
        boxes, offset_m = truth.boxes, self.network.config.input.height_offset_m
        return training_picture(
            (points - points.new_tensor([0, 0, offset_m, 0])).cpu(),
            output[0],
            (boxes - boxes.new_tensor([0, 0, offset_m, 0, 0, 0, 0])).float().cpu(),
        )

    def _reset_metrics(self) -> None:
        with torch.inference_mode(mode=False):  # else training could not continue with its tensors
            self.loose_metric.reset()
            self.recall_metric.reset()

    def _check_records(self, batch: Detection3DBatch) -> None:
        if batch.records is None:
            return
        if self.stages != "second":
            raise ValueError(
                f"stages {self.stages} trains the first stage, whose cache would be out of date: "
                "set stages to second, or leave the cache out"
            )
        if self._identity is None:
            self._identity = first_stage_identity(self.network)
        if any(record.made_by != self._identity for record in batch.records):
            raise ValueError(
                "the cache was made by a first stage of other weights or settings than the "
                f"training's; train with those that made it (initial_weights, network), or {REMEDY}"
            )
