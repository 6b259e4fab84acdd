"""The training losses of the depth completion networks."""

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, get_args

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import pad

from sightline.depth_completion.model import DepthCompletionOutput
from sightline.depth_completion.targets import ExpansionConfig, expand_depth

EmdKind = Literal["tiles", "global"]

_RISE_M, _RISE_ENDS_M = 3.0, 10.0  # parameters of rising_l1
_MIN_RATIO = 0.01  # smallest ratio of predicted to true depth: predictions may be zero or less


@dataclass(frozen=True, kw_only=True)
class DepthLossConfig:
    """The losses of Yu and Kee 2021, section 4.1, and further ones. A weight of 0 disables one."""

    mse: float = 1.0
    """Weight of the mean squared error of the depth."""
    rmse: float = 1.0
    """Weight of the root of each image's mean squared error."""
    l1: float = 0.0
    """Weight of the mean absolute error of the depth."""
    rising_l1: float = 0.0
    """Weight of the mean of |e| + e^2 / (3 + 0.3 |e|), e in metres: an absolute error whose weight
    grows with its size, up to fourfold; an error of 10 m matters more than ten of 1 m."""
    dense_l1: float = 0.0
    """Weight of the mean absolute error against the dense truth of `truth: both`."""
    dense_relative: float = 0.0
    """Weight of the mean absolute error of the depth's logarithm against the dense truth; keeps
    near surfaces accurate to the centimetre."""
    emd: float = 0.1
    """Weight of the earth mover's distance from the E-Point to the expanded ground truth."""
    uncertainty: float = 0.0
    """Weight of the Laplace likelihood that calibrates the uncertainty."""
    emd_kind: EmdKind = "tiles"
    """tiles: distance within each tile, so that depth stays near its place; global: distance over
    whole images, as the paper states, which ignores positions."""
    emd_tile_px: int = 64
    """Side of a tile [px]; in every other step all tiles are shifted half a side up and left."""
    unit_m: float = 85.0
    """Unit of the errors [m]."""
    expansion: ExpansionConfig = field(default_factory=ExpansionConfig)
    """Settings of the E-Point's ground truth."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in DepthLosses._fields[1:]:
            weight = getattr(self, name)
            if not 0 <= weight < math.inf:
                raise ValueError(
                    f"the weight of {name} must be finite and not negative, got {weight}"
                )
        if self.emd_kind not in get_args(EmdKind):
            raise ValueError(f"emd_kind must be tiles or global, got {self.emd_kind!r}")
        if self.emd_tile_px < 2:
            raise ValueError(f"emd_tile_px must be at least 2, got {self.emd_tile_px}")
        if not 0 < self.unit_m < math.inf:
            raise ValueError(f"unit_m must be positive and finite, got {self.unit_m}")


class DepthLosses(NamedTuple):
    """Loss and its unweighted terms, in units of `unit_m` (mse: its square).

    A term is 0 if its weight is 0, the network lacks the output or no image has ground truth.
    """

    total: Float[Tensor, ""]
    """Weighted sum of the terms."""
    mse: Float[Tensor, ""]
    rmse: Float[Tensor, ""]
    l1: Float[Tensor, ""]
    rising_l1: Float[Tensor, ""]
    dense_l1: Float[Tensor, ""]
    dense_relative: Float[Tensor, ""]
    emd: Float[Tensor, ""]
    uncertainty: Float[Tensor, ""]


def depth_completion_loss(
    output: DepthCompletionOutput,
    truth_m: Float[Tensor, "batch 1 height width"],
    config: DepthLossConfig = DepthLossConfig(),
    *,
    step: int,
    dense_truth_m: Float[Tensor, "batch 1 height width"] | None = None,
    weight: Float[Tensor, "batch 1 height width"] | None = None,
) -> DepthLosses:
    """Compute the loss: depth against ground truth, E-Point against expanded ground truth.

    Only pixels with ground truth count. Each term is averaged per image, then over the images with
    ground truth, as KITTI scores; so the RMSE is a mean of roots. A batch without ground truth has
    loss 0 and gradient 0.

    Uncertainty: |error| / b + log b, the negative log-likelihood of a Laplace distribution up to a
    constant. The error is detached: b learns the expected absolute error and the depth does not
    change. The dense truth is used if there is one. Outputs that the network lacks cost nothing.

    Args:
        output: Output of the network.
        truth_m: Ground truth; 0 = none.
        config: Weights and variants of the losses.
        step: Number of the training step; odd steps shift the tiles of the EMD.
        weight: Weight of each pixel, in all terms against `truth_m` except the EMD.
        dense_truth_m: Additional dense truth, if `truth_m` contains only a few rings; 0 = none.
    """
    truth = truth_m / config.unit_m
    is_valid = truth > 0
    error = torch.where(is_valid, _in_units(output.depth_m, config) - truth, 0.0)
    pixel_weights = (
        is_valid.to(error.dtype) if weight is None else torch.where(is_valid, weight, 0.0)
    )
    zero = error.sum() * 0  # part of the graph, so that `backward` works on any batch
    mse = rmse = l1 = rising_l1 = dense_l1 = dense_relative = emd = uncertainty = zero
    if config.mse or config.rmse:
        per_image = _image_means(error.square(), pixel_weights)
        mse = _mean_over_images(per_image, is_valid) if config.mse else zero
        rmse = _mean_over_images(_root(per_image), is_valid) if config.rmse else zero
    if config.l1:
        l1 = _mean_over_images(_image_means(error.abs(), pixel_weights), is_valid)
    if config.rising_l1:
        metres = error.abs() * config.unit_m
        rising = metres + metres.square() / (_RISE_M + metres * _RISE_M / _RISE_ENDS_M)
        rising_l1 = _mean_over_images(_image_means(rising / config.unit_m, pixel_weights), is_valid)
    if dense_truth_m is not None:
        is_dense = dense_truth_m > 0
        if config.dense_relative:
            # Avoids 0 / 0 where there is no truth: its gradient would be NaN.
            divisor = torch.where(is_dense, dense_truth_m, 1.0)
            ratio = torch.where(is_dense, output.depth_m, 1.0) / divisor
            distance = ratio.clamp(min=_MIN_RATIO).log().abs()
            means = _image_means(distance, is_dense.to(distance.dtype))
            dense_relative = _mean_over_images(means, is_dense)
        dense_error = torch.where(is_dense, _in_units(output.depth_m - dense_truth_m, config), 0.0)
        if config.dense_l1:
            means = _image_means(dense_error.abs(), is_dense.to(error.dtype))
            dense_l1 = _mean_over_images(means, is_dense)
    if config.emd and output.e_point_m is not None:
        expanded = expand_depth(truth, config.expansion)
        emd = _earth_movers_distance(_in_units(output.e_point_m, config), expanded, config, step)
    if config.uncertainty and output.uncertainty_m is not None:
        scale = _in_units(output.uncertainty_m, config)
        if dense_truth_m is not None:
            is_valid, error, pixel_weights = is_dense, dense_error, is_dense.to(error.dtype)
        likelihood_loss = torch.where(is_valid, error.detach().abs() / scale + scale.log(), 0.0)
        uncertainty = _mean_over_images(_image_means(likelihood_loss, pixel_weights), is_valid)
    terms = (mse, rmse, l1, rising_l1, dense_l1, dense_relative, emd, uncertainty)
    weights = (getattr(config, name) for name in DepthLosses._fields[1:])
    total = sum((weight * term for weight, term in zip(weights, terms, strict=True)), start=zero)
    return DepthLosses(total, *terms)


def _earth_movers_distance(
    e_point: Float[Tensor, "batch 1 height width"],
    expanded: Float[Tensor, "batch 1 height width"],
    config: DepthLossConfig,
    step: int,
) -> Float[Tensor, ""]:
    """Wasserstein-1 distance between the sets of depths of two images, per tile or globally.

    For sets of equal size it is the mean of |sort p - sort q|. Pixels without expanded ground truth
    are left out of both sets. Tiles at the border may be smaller; tiles are weighted by their
    number of pixels.
    """
    is_valid = expanded > 0
    # Infinity sorts the left-out pixels to the same places at the end of both sets.
    p = torch.where(is_valid, e_point, torch.inf)
    q = torch.where(is_valid, expanded, torch.inf)
    if config.emd_kind == "global":
        p, q = p.flatten(1)[:, None], q.flatten(1)[:, None]
    else:
        offset_px = config.emd_tile_px // 2 if step % 2 else 0
        p = _tiles(p, config.emd_tile_px, offset_px)
        q = _tiles(q, config.emd_tile_px, offset_px)
    p, q = p.sort(dim=-1).values, q.sort(dim=-1).values
    distances = torch.where(q.isfinite(), p - q, 0.0).abs()
    pixels = is_valid.sum(dim=(1, 2, 3))
    return _mean_over_images(distances.sum(dim=(1, 2)) / pixels.clamp(min=1), is_valid)


def _tiles(
    depth: Float[Tensor, "batch 1 height width"], tile_px: int, offset_px: int
) -> Float[Tensor, "batch num_tiles tile_pixels"]:
    """Cut a map into square tiles, the first `offset_px` before the map; infinity around it."""
    below, right = (-(size + offset_px) % tile_px for size in depth.shape[2:])
    padded = pad(depth[:, 0], (offset_px, right, offset_px, below), value=torch.inf)
    rows, columns = (size // tile_px for size in padded.shape[1:])
    cells = padded.reshape(-1, rows, tile_px, columns, tile_px).transpose(2, 3)
    return cells.reshape(-1, rows * columns, tile_px * tile_px)


def _in_units(
    depth_m: Float[Tensor, "batch 1 height width"], config: DepthLossConfig
) -> Float[Tensor, "batch 1 height width"]:
    # bfloat16 has three digits: too few for sums over an image
    return depth_m.to(torch.promote_types(depth_m.dtype, torch.float32)) / config.unit_m


def _image_means(
    values: Float[Tensor, "batch 1 height width"], weights: Float[Tensor, "batch 1 height width"]
) -> Float[Tensor, " batch"]:
    """Weighted mean over each image's pixels; 0 if all its weights are 0."""
    total = weights.sum(dim=(1, 2, 3))
    sums = (values * weights).sum(dim=(1, 2, 3))
    return sums / torch.where(total > 0, total, 1.0)


def _mean_over_images(
    values: Float[Tensor, " batch"], is_valid: Bool[Tensor, "batch 1 height width"]
) -> Float[Tensor, ""]:
    """Mean over the images with ground truth; the other images must have the value 0."""
    return values.sum() / is_valid.flatten(1).any(dim=1).sum().clamp(min=1)


def _root(squares: Float[Tensor, " batch"]) -> Float[Tensor, " batch"]:
    """Square root with gradient 0 at 0, instead of an infinite one."""
    is_positive = squares > 0
    return torch.where(is_positive, torch.where(is_positive, squares, 1.0).sqrt(), 0.0)
