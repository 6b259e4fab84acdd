"""Training and scores of the toy task."""

from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torchmetrics import MeanMetric

from sightline.geometry.boxes2d import Boxes2D
from sightline.training.module import TrainingModule
from sightline.training.optimizer import OptimizerConfig
from tests.toy_task.config import FinderConfig
from tests.toy_task.examples import FinderBatch
from tests.toy_task.model import FinderNet

_NETWORK, _OPTIMIZER = FinderConfig(), OptimizerConfig()


class FinderLosses(NamedTuple):
    """Losses with a single term."""

    total: Tensor


class FinderScores(MeanMetric):
    """Mean over frames of the share of wrongly classified cells."""

    def compute(self) -> dict[str, Tensor]:
        return {"wrong_share": super().compute()}


class Finder(TrainingModule):
    """Training of the toy task."""

    task_name: ClassVar[str] = "toy-finder"
    monitored: ClassVar[tuple[str, Literal["min", "max"]]] = ("validation/wrong_share", "min")

    def __init__(
        self,
        network: FinderConfig = _NETWORK,
        optimizer: OptimizerConfig = _OPTIMIZER,
        initial_weights: Path | None = None,
    ) -> None:
        super().__init__(
            FinderNet(network), FinderScores(), optimizer=optimizer, initial_weights=initial_weights
        )

    def network_config(self) -> FinderConfig:
        return self.network.config

    def losses(self, batch: FinderBatch) -> FinderLosses:
        logits = self.network(batch.image, batch.sparse_depth_m).logits
        return FinderLosses(F.binary_cross_entropy_with_logits(logits, self._truth(batch, logits)))

    def score(self, batch: FinderBatch) -> Tensor:
        logits = self.network(batch.image, batch.sparse_depth_m).logits
        is_wrong = (logits > 0) != (self._truth(batch, logits) > 0)
        for share in is_wrong.flatten(1).float().mean(dim=1):
            self.metric.update(share)
        return logits

    def _truth(self, batch: FinderBatch, logits: Tensor) -> Tensor:
        truth = torch.zeros_like(logits)
        for cells, boxes in zip(truth, batch.boxes, strict=True):
            rows, columns = self._middles(boxes)
            cells[0, rows, columns] = 1.0
        return truth

    def _middles(self, boxes: Boxes2D) -> tuple[Tensor, Tensor]:
        """Rows and columns of the cells that hold the boxes' middles."""
        middles = (boxes.tensor[:, :2] + boxes.tensor[:, 2:]) / 2
        columns, rows = (middles / self.network.config.cell_px).long().unbind(dim=1)
        return rows, columns
