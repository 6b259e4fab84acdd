"""Scores of the depth completion benchmark as a torchmetrics metric for training."""

from dataclasses import asdict, fields

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric

from sightline.evaluation.depth_scores import DepthScores, score_depth
from sightline.geometry.wrong_types import named_arguments


class DepthCompletionScores(Metric):
    """Means over images of `sightline.evaluation.depth_scores.score_depth`.

    The metric sums each image's scores in float64 and may run on any number of processes:
    torchmetrics combines the sums.
    """

    is_differentiable = False
    higher_is_better = None  # a higher coverage is better, but lower errors
    full_state_update = False

    sums: Tensor
    num_images: Tensor

    def __init__(self) -> None:
        """Start without images."""
        super().__init__()
        zeros = torch.zeros(len(fields(DepthScores)), dtype=torch.float64)
        self.add_state("sums", default=zeros, dist_reduce_fx="sum")
        self.add_state("num_images", default=torch.tensor(0), dist_reduce_fx="sum")

    @named_arguments
    def update(
        self,
        prediction_m: Float[Tensor, "batch height width"],
        truth_m: Float[Tensor, "batch height width"],
    ) -> None:
        """Add a batch of predicted depth maps and their ground truth [m], 0 = none.

        Raises:
            ValueError: As for `score_depth`.
        """
        predictions, truths = (  # NumPy has no bfloat16
            each.to(torch.promote_types(each.dtype, torch.float32)).numpy(force=True)
            for each in (prediction_m, truth_m)
        )
        for prediction, truth in zip(predictions, truths, strict=True):
            scores = asdict(score_depth(prediction, truth))
            self.sums += self.sums.new_tensor(list(scores.values()))
            self.num_images += 1

    def compute(self) -> dict[str, Float[Tensor, ""]]:
        """Compute each score's mean by name, in torchmetrics' form for several values.

        NaN before the first image.
        """
        means = self.sums / self.num_images
        names = [field.name for field in fields(DepthScores)]
        return dict(zip(names, means.unbind(), strict=True))
