"""Similarity of the features that both sensors' streams have learned.

Kim et al. 2018, section IV-B, says that the network without gates "learns somewhat similar features
from both camera and Lidar images", and that those of the network with gates "look distinct". Here
it is the linear centred kernel alignment (Kornblith et al. 2019, arXiv:1905.00414, Eq. 5): 0 for
unrelated features, 1 for features that are equal up to rotation and scale.
"""

from collections.abc import Iterable

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from sightline.detection2d.model import Detector
from sightline.detection2d.placement import (
    camera_image,
    lidar_image,
    padded,
    place,
    whole_strides,
)
from sightline.structures.sample import CameraLidarSample

_ROUNDING = 1e-12  # variance of constant features in relation to their square


class LinearCka:
    """Linear CKA of two sets of features of the same pixels, from sums over parts of the pixels."""

    def __init__(self) -> None:
        """Start without pixels."""
        self._count = 0
        self._sums: Float64[Tensor, " channels"] | None = None
        self._products: Float64[Tensor, "channels channels"] | None = None
        self._first = 0  # number of channels of the first set

    def add(self, first: Float[Tensor, "pixels a"], second: Float[Tensor, "pixels b"]) -> None:
        """Add pixels."""
        both = torch.cat((first, second), dim=1).double()
        sums, products = both.sum(dim=0), both.T @ both
        self._first = first.shape[1]
        self._count += len(both)
        self._sums = sums if self._sums is None else self._sums + sums
        self._products = products if self._products is None else self._products + products

    def value(self) -> float | None:
        """Compute the alignment; None without pixels, or if one set's features are constant."""
        if self._sums is None or self._products is None:
            return None
        mean = self._sums / self._count
        covariance = self._products / self._count - torch.outer(mean, mean)
        first, second = slice(None, self._first), slice(self._first, None)
        moments = self._products.diagonal() / self._count
        for part in (first, second):
            if covariance.diagonal()[part].sum() <= _ROUNDING * moments[part].sum():
                return None
        own = covariance[first, first].norm() * covariance[second, second].norm()
        return float(covariance[first, second].square().sum() / own)


@torch.inference_mode()
def stream_similarity(
    network: Detector, samples: Iterable[CameraLidarSample]
) -> tuple[float | None, ...]:
    """Compute the similarity of both streams' features at each fused map, the finest first.

    Args:
        network: Network of fusion gated or ones, on the CPU.
        samples: Frames with image and sweep.
    """
    config = network.config.input
    alignments: list[LinearCka] = []
    for sample in samples:
        given, _ = place(sample, config)
        size = whole_strides(given.image_size, network.stride)
        images = {"image": camera_image(given), "lidar": lidar_image(given, config)}
        planes = network.planes({name: padded(each, size)[None] for name, each in images.items()})
        maps = [network.streams[sensor](planes[sensor]) for sensor in ("camera", "lidar")]
        alignments = alignments or [LinearCka() for _ in maps[0]]
        for alignment, camera, lidar in zip(alignments, *maps, strict=True):
            alignment.add(*(each[0].flatten(1).T for each in (camera, lidar)))
    return tuple(alignment.value() for alignment in alignments)
