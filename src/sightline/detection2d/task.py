"""Training and scoring of the 2D detectors."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
import torch
from jaxtyping import UInt8
from lightning.pytorch.utilities import rank_zero_only
from torch import Tensor

from sightline.data.formats.kitti_conversion import kitti_from_detections2d
from sightline.detection2d.config import Detection2DConfig
from sightline.detection2d.dgfn.weights import fold_batch_norm, load_vgg_weights
from sightline.detection2d.fusion import DetectorOutput
from sightline.detection2d.loss import DetectionLossConfig, DetectionLosses, detection_loss
from sightline.detection2d.model import Detector
from sightline.detection2d.placement import to_detections
from sightline.detection2d.results import training_picture
from sightline.detection2d.targets import DetectionBatch
from sightline.detection2d.views import LEAST_STEP
from sightline.evaluation.kitti_object_metric import KittiObjectMetric
from sightline.files.weights import Weights, fill_network, read_weights
from sightline.training.initial_weights import choose_settings
from sightline.training.module import TrainingModule
from sightline.training.optimizer import OptimizerConfig


def load_stream_weights(network: Detector, sources: Mapping[str, Path], *, task_name: str) -> None:
    """Copy the weights of streams from other networks to the streams of the same name.

    A stream's own head, if it is used at inference (`CompactConfig.own_heads`), is copied too.

    Args:
        network: Network to change; its other weights stay.
        sources: Name of shipped weights, file or checkpoint for each stream (camera, lidar or
            both).
        task_name: Task that the weights must be for.

    Raises:
        ValueError: The network has no such stream, or the weights cannot be read, are for another
            task, or contain no such stream or one of another size.
    """
    for sensor, source in sources.items():
        if sensor not in network.streams:
            raise ValueError(
                f"initial_streams names {sensor}, but the network's streams are "
                f"{', '.join(network.streams)}; name those"
            )
        weights = read_weights(source)
        if weights.task != task_name:
            raise ValueError(
                f"{source} is of task {weights.task}, expected {task_name}; name another"
            )
        parts = [("stream", network.streams[sensor], "streams")]
        if network.mixes_heads:
            parts.append(("head", network.auxiliary[sensor], "heads"))
        for part, filled, group in parts:
            try:
                fill_network(filled, _within(weights.tensors, f"{group}.{sensor}."))
            except ValueError as error:
                raise ValueError(
                    f"{source} has no {part} {sensor} that fits the network's ({error}); name "
                    f"weights of a network with the same {part}"
                ) from error


def _within(tensors: Mapping[str, Tensor], start: str) -> dict[str, Tensor]:
    """Select the tensors of one part, by their names in it."""
    return {
        name.removeprefix(start): tensor
        for name, tensor in tensors.items()
        if name.startswith(start)
    }


_LOSS, _OPTIMIZER = DetectionLossConfig(), OptimizerConfig()


class Detection2D(TrainingModule):
    """2D detection in training: scored by KITTI's rules, AP over 40 recall positions in percent."""

    task_name: ClassVar[str] = "detection2d"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = (
        "validation/Car/bbox/moderate",
        "max",
    )
    monitored_beside: ClassVar[tuple[str, ...]] = ("validation/Car/bbox/moderate_all_points",)
    network: Detector

    def __init__(
        self,
        network: Detection2DConfig | None = None,
        loss: DetectionLossConfig = _LOSS,
        optimizer: OptimizerConfig = _OPTIMIZER,
        initial_weights: Path | None = None,
        initial_streams: dict[str, Path] | None = None,
        vgg_weights: str | None = None,
    ) -> None:
        """Build the network.

        Args:
            network: Settings of the network. None: the network of the initial weights; without
                those, the default.
            loss: Settings of the losses.
            optimizer: Settings of the optimizer.
            initial_weights: Weights of the whole network to start from: name of shipped ones, file
                or checkpoint.
            initial_streams: Networks whose streams it starts from, over initial_weights: camera and
                lidar, each from a network that was trained with that sensor alone.
            vgg_weights: VGG16's weights that its streams start from, unless there are initial
                weights: imagenet, which torchvision downloads, or a file of torchvision's VGG16.
                None: the streams start at random.

        Raises:
            ValueError: The initial weights cannot be read or are another network's.
        """
        settings = choose_settings(
            network, Detection2DConfig, initial_weights, task_name=self.task_name
        )
        super().__init__(
            Detector(settings),
            KittiObjectMetric(),
            optimizer=optimizer,
            initial_weights=initial_weights,
        )
        self.loss = loss
        self.initial_streams = initial_streams or {}
        self.vgg_weights = vgg_weights
        self._initial_weights = initial_weights
        self._is_start_loaded = False

    def network_config(self) -> Detection2DConfig:
        """Return the network's settings."""
        config: Detection2DConfig = self.network.config
        return config

    def final_weights(self, weights: Weights) -> Weights:
        """Fold batch normalisation into the convolutions of the paper's network."""
        return fold_batch_norm(weights)

    def setup(self, stage: str) -> None:
        """Load what a training starts from; a resumed one has it in its checkpoint.

        Raises:
            ValueError: See `load_start`.
        """
        if stage == "fit" and not self.is_resumed:
            self.load_start()

    def load_start(self) -> None:
        """Load VGG16's weights, unless there are initial weights, and other networks' streams.

        Raises:
            ValueError: They are not available.
        """
        if self._is_start_loaded:
            return
        self._is_start_loaded = True
        if self.vgg_weights is not None and self._initial_weights is None:
            load_vgg_weights(self.network, self.vgg_weights)
        elif self.vgg_weights is not None:
            rank_zero_only(print)(
                f"the training starts from {self._initial_weights}, not from VGG16's weights "
                f"({self.vgg_weights})",
                file=sys.stderr,
            )
        load_stream_weights(self.network, self.initial_streams, task_name=self.task_name)

    def losses(self, batch: DetectionBatch) -> DetectionLosses:
        """Compute the losses of a batch."""
        outputs = self.network.run_heads(
            **self._inputs(batch), auxiliary=self.loss.auxiliary_weight > 0
        )
        is_compact = self.network.config.compact is not None
        return detection_loss(outputs, batch, self.loss, compact=is_compact)

    def score(self, batch: DetectionBatch) -> DetectorOutput:
        """Score a batch."""
        assert batch.frames is not None, "examples to score hold the frames' truth"
        output: DetectorOutput = self.network(**self._inputs(batch))
        found = [
            to_detections(scores, boxes, frame.placement, self.network.config.postprocess)
            for scores, boxes, frame in zip(output.scores, output.boxes, batch.frames, strict=True)
        ]
        self.metric.update(
            [
                kitti_from_detections2d(each, frame.placement.image_size)
                for each, frame in zip(found, batch.frames, strict=True)
            ],
            [frame.objects for frame in batch.frames],
        )
        return output

    def scores(self) -> Mapping[str, Tensor]:
        """Compute the 2D AP of each class and difficulty."""
        return {name: value for name, value in super().scores().items() if "/bbox/" in name}

    def score_notes(self) -> tuple[str, ...]:
        """Notes on classes with too few objects for R40."""
        assert isinstance(self.metric, KittiObjectMetric), "as the constructor made it"
        return self.metric.notes(self.monitored[0])

    def difference_in_use(self) -> str | None:
        """Name the frames of which predictors search bands; networks of one input size do not."""
        settings = self.network.config.input
        if settings.size is not None:
            return None
        longest_px = settings.longest_focal_px
        rows = settings.rows_above_horizon + settings.rows_below_horizon
        return (
            f"frames are scored whole; those from {LEAST_STEP * longest_px:g} px of focal length, "
            f"or of more than {rows} rows once shrunk to {longest_px:g} px, predictors search in "
            "bands along the horizon"
        )

    def picture(
        self, batch: DetectionBatch, output: DetectorOutput
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Draw the first sample of a batch with its boxes, the LiDAR's image and the gates."""
        return training_picture(batch, output, self.network.config.postprocess)

    def _inputs(self, batch: DetectionBatch) -> dict[str, Tensor]:
        images = {"image": batch.image, "lidar": batch.lidar}
        return {
            name: images[name].contiguous(memory_format=torch.channels_last)
            for name in self.network.input_names
        }
