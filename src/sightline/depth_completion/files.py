"""Depth maps of whole data sets as files in KITTI's format."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from sightline.data.formats.map_png import MAX_DEPTH_M, read_depth_png, write_depth_png
from sightline.depth_completion.postprocess import TRUSTED_SHARE
from sightline.depth_completion.sparse_map import inside_hull
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap, Perception
from sightline.structures.sample import CameraLidarSample

_MAX_FAR_SHARE: Final = 0.5  # of the depths, beyond the format's range


def write_depth(path: Path, sample: CameraLidarSample, depth_map: DepthMap) -> None:
    """Write the depths as a 16-bit PNG; depths beyond its range of 256 m become 0 (none).

    Raises:
        ValueError: The map does not have the image's size, or most depths are beyond the range.
    """
    depth_m = depth_map.depth_m[depth_map.depth_m.isfinite()]  # others are refused below
    num_far, num_depths = int((depth_m > MAX_DEPTH_M).sum()), int((depth_m > 0).sum())
    if num_far > _MAX_FAR_SHARE * num_depths:
        raise ValueError(
            f"{num_far} of {num_depths} depths are above {MAX_DEPTH_M:.0f} m, which a depth PNG "
            "cannot hold; let the predictor give metres, and 0 for no value"
        )
    _write(path, sample, depth_map.depth_m)


def describe_guess(depth_map: DepthMap) -> str:
    """Describe guessed depths, which their file does not mark; empty: there are none."""
    if depth_map.guessed is None or not depth_map.guessed.any():
        return ""
    return "hold depth guessed from the image, where the sweep has no points"


def write_uncertainty(path: Path, sample: CameraLidarSample, depth_map: DepthMap) -> None:
    """Write the expected absolute errors in the same format; infinite ones become 0.

    Raises:
        ValueError: The map has no expected errors, or does not have the image's size.
    """
    if depth_map.uncertainty_m is None:
        raise ValueError("the depth map has no expected errors; leave the uncertainty out")
    _write(path, sample, torch.where(depth_map.uncertainty_m.isinf(), 0.0, depth_map.uncertainty_m))


def read_depth(path: Path, sample: CameraLidarSample, perception: Perception) -> Perception:
    """Add the depth map of a PNG, valid among the sample's measurements.

    Without a sweep, or without returns in view, it is guessed from the image.

    Raises:
        ValueError: The file is no depth map or does not have the sample's image size.
    """
    depth_m = _read(path, sample)
    has_value = depth_m > 0
    is_measured = np.zeros(sample.image_size, np.bool_)
    if sample.points is not None:
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        is_measured = sparse.numpy(force=True) > 0
    if not is_measured.any():
        depth = DepthMap(depth_m=depth_m, valid=torch.zeros_like(has_value), guessed=has_value)
        return replace(perception, depth=depth)
    valid = has_value & torch.from_numpy(inside_hull(is_measured))
    return replace(perception, depth=DepthMap(depth_m=depth_m, valid=valid))


def read_uncertainty(path: Path, sample: CameraLidarSample, perception: Perception) -> Perception:
    """Add the expected errors of a PNG to the depth map; pixels with large errors become invalid.

    Raises:
        ValueError: There is no depth map, or the file holds no errors or has another size.
    """
    if perception.depth is None:
        raise ValueError(
            f"{path} holds expected errors of a depth map; name the folder of the depths too"
        )
    error_m = _read(path, sample)
    error_m = torch.where(error_m > 0, error_m, torch.inf)
    valid = perception.depth.valid & (error_m < TRUSTED_SHARE * perception.depth.depth_m)
    return replace(perception, depth=replace(perception.depth, valid=valid, uncertainty_m=error_m))


def _read(path: Path, sample: CameraLidarSample) -> Float32[Tensor, "height width"]:
    values_m = torch.from_numpy(read_depth_png(path))
    _check_size(path, sample, values_m, "name the results of this data set")
    return values_m


def _check_size(
    path: Path, sample: CameraLidarSample, values_m: Float32[Tensor, "height width"], remedy: str
) -> None:
    if tuple(values_m.shape) != sample.image_size:
        raise ValueError(
            f"{path} is {values_m.shape[0]}x{values_m.shape[1]} (height x width), expected "
            f"{sample.image_size[0]}x{sample.image_size[1]} like sample {sample.sample_id}; "
            f"{remedy}"
        )


def _write(
    path: Path, sample: CameraLidarSample, values_m: Float32[Tensor, "height width"]
) -> None:
    _check_size(path, sample, values_m, "let the predictor resize its maps to the image")
    values = values_m.detach().cpu().numpy()
    # One stray return beyond the format's reach must not end the job of a whole data set.
    too_far = np.isfinite(values) & (values > MAX_DEPTH_M)
    write_depth_png(path, np.where(too_far, np.float32(0), values))
