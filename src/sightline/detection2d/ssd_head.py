"""SSD's head: a convolution on each map that predicts the content of each prior."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.config import CLASSES, DgfnConfig
from sightline.detection2d.initialization import start_small
from sightline.detection2d.priors import decode_boxes, make_priors, prior_shapes
from sightline.detection2d.readings import HeadReading


class SsdHead(nn.Module):
    """3x3 convolution on each map for its priors' classes and offsets: Liu et al. 2016, sec. 2.1.

    Class 0 is the background.

    Args:
        channels: Channels of each map, the finest first.
        config: Shapes of the priors.
    """

    def __init__(self, channels: Sequence[int], config: DgfnConfig) -> None:
        super().__init__()
        self.shapes = prior_shapes(config.prior_sizes_px, config.prior_ratios)
        self.values = len(CLASSES) + 1 + 4  # values of each prior
        self.convs = nn.ModuleList(
            start_small(nn.Conv2d(count, len(shapes) * self.values, 3, padding=1))
            for count, shapes in zip(channels, self.shapes, strict=True)
        )

    def forward(
        self,
        maps: Sequence[Float[Tensor, "batch _channels _rows _columns"]],
        image_size: tuple[int, int],
    ) -> HeadReading:
        """Compute the outputs for the maps of an image of (height, width) [px]."""
        values, places = [], []
        for conv, shapes, features in zip(self.convs, self.shapes, maps, strict=True):
            rows, columns = features.shape[-2:]
            said = conv(features).float().permute(0, 2, 3, 1)
            values.append(said.reshape(said.shape[0], rows * columns * len(shapes), self.values))
            places.append(make_priors(shapes, rows, columns, image_size, values[-1]))
        class_logits, box_logits = torch.split(
            torch.cat(values, dim=1), [self.values - 4, 4], dim=2
        )
        return HeadReading(class_logits, box_logits, torch.cat(places))

    def decode(
        self, reading: HeadReading
    ) -> tuple[Float[Tensor, "batch places classes"], Float[Tensor, "batch places 4"]]:
        """Compute class probabilities without the background, and boxes (corners, px)."""
        scores = reading.class_logits.softmax(dim=2)[..., 1:]
        return scores, decode_boxes(reading.box_logits, reading.places)
