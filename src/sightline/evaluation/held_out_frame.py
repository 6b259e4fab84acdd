"""Frame of the held-out-rings protocol: input of the methods, and the truth.

Rings are numbered by `ring_numbers` (`data/formats/rings.py`) after the sweep is cut to the image,
so that whole sweeps and KITTI's reduced ones have equal scores. Every eighth ring, from number 4,
is never an input. The input is, of the other rings, all ("64 beams"), every second ("32"), every
fourth ("16") or every eighth ("8"); the truth is the same for all.

For another sensor than KITTI's, whole sweeps give the number of beams. Its rings are numbered by
laser, before the cut, and the densities are all of its beams, half of them and so on. Sweeps in
another order than KITTI's are sorted into it by their points' elevations, and numbered alike.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
import torch
from beartype import beartype
from jaxtyping import Bool, Float32, Int64, jaxtyped
from torch import Tensor

from sightline.augmentation.sample_changes import crop, keep_rings, points_in_view
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.sample_dataset import NamedSubset, SampleDataset
from sightline.data.datasets.sample_files import describe_sparse_maps
from sightline.data.formats.rings import (
    NUM_RINGS,
    beams_of_sensor,
    check_spacing,
    count_rings,
    cut_in_kitti_order,
    is_whole_turn,
    ring_numbers,
    rings_of_any_order,
)
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import sparse_depth_map
from sightline.ops.parallax import Parallax, hidden_by_parallax
from sightline.structures.sample import CameraLidarSample

BEAMS = (64, 32, 16, 8)
"""Beams of the tables."""
CROP_SIZE = (352, 1216)
"""Height and width of the bottom-centre crop, as in the depth benchmark's own selection."""
_LARGEST_CROPPED = (376, 1242)  # KITTI's largest images; larger ones are not cropped

HELD_OUT_EVERY = 8
FIRST_HELD_OUT = 4
"""First held-out ring in the tables; training may hold out others."""

TruthChoice = Literal["rings", "depth", "depth_in_reach"]
"""Source of the truth. `rings`: the returns of the held-out rings. `depth`: the sample's own depth
map, dense from the simulator, up to 80 m. `depth_in_reach`: only its pixels below the highest
return of the sweep, all beams; above, every method guesses."""
_FARTHEST_DENSE_M = 80.0
_REACH_COLUMNS = 31  # number of columns with a common highest return


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutFrame:
    """Frame, split into the input of methods and the truth."""

    sample: CameraLidarSample
    """Cropped sample; its points are the returns in view from rings that are not held out."""
    rings: Int64[Tensor, " num_points"]
    """Ring number of each point of `sample`."""
    truth_m: Float32[Tensor, "height width"]
    """Depths of the held-out returns visible to the camera, or dense ones; 0 = none."""
    first_held_out: int = FIRST_HELD_OUT
    sensor_beams: int = NUM_RINGS
    """Number of beams of the sensor; see `beams_of_sensor`."""
    sensor_rings: int = NUM_RINGS
    """Number of rings with returns of a whole sweep; of a cut one `sensor_beams`."""
    are_beams_assumed: bool = True
    """Whether `sensor_beams` is assumed: true for a sweep cut to the image in KITTI's order."""

    def with_beams(self, beams: int, *, start: int = 0) -> CameraLidarSample:
        """Simulate the sample of a sensor with fewer beams.

        Args:
            beams: Number of the sensor's beams to keep.
            start: Number of rings to skip at the top, of those not held out, for a sensor that
                looks a little lower than in the tables.

        Raises:
            ValueError: The sensor's number is not a multiple of `beams`.
        """
        if beams < 1 or self.sensor_beams % beams:
            choices = ", ".join(map(str, densities(self.sensor_beams)))
            raise ValueError(
                f"beams must divide the sensor's {self.sensor_beams} evenly ({choices}, ..), got "
                f"{beams}"
            )
        rings = torch.arange(self.sensor_beams + 1)  # the last ring of a cut sweep may be in halves
        given = rings[~_is_held_out(rings, self.first_held_out)]
        step = self.sensor_beams // beams
        return keep_rings(self.sample, self.rings, given[start::step].tolist())


def densities(sensor_beams: int) -> tuple[int, ...]:
    """Compute the tables' densities for a sensor: all beams, half, a quarter, an eighth."""
    return tuple(sensor_beams * beams // NUM_RINGS for beams in BEAMS)


def split_rings(
    sample: CameraLidarSample,
    *,
    first_held_out: int = FIRST_HELD_OUT,
    truth: TruthChoice = "rings",
    crop_size: tuple[int, int] = CROP_SIZE,
) -> HeldOutFrame:
    """Split a frame: held-out rings become the truth, the others the methods' input.

    Both are cropped at the bottom centre; an image that is smaller, or larger than KITTI's, is kept
    whole. Labels and depth are removed from the sample.

    Args:
        sample: The frame.
        first_held_out: The first held-out ring; every eighth from there is held out.
        truth: Source of the truth.
        crop_size: Height and width of the crop [px].

    Raises:
        ValueError: The sample has no points, neither their order nor their elevation shows rings,
            no held-out ring is in view, or there is no depth map although it is the truth.
    """
    if sample.points is None or len(sample.points) == 0:
        raise ValueError(
            f"sample {sample.sample_id} has no points, but held-out rings need a sweep; leave the "
            "sample out"
        )
    try:
        points, rings, sensor_rings, are_beams_assumed = _rings_in_view(sample, sample.points)
    except ValueError as error:
        raise ValueError(f"sample {sample.sample_id}: {error}") from error
    sensor_beams = beams_of_sensor(sensor_rings)
    held_out = _is_held_out(rings, first_held_out)
    everything = sparse_depth_map(points, sample.calibration, sample.image_size)
    if truth == "rings":
        returns = sparse_depth_map(points[held_out], sample.calibration, sample.image_size)
        truth_m = _without_hidden(returns, everything, sample.calibration)
    else:
        is_partial = truth == "depth_in_reach"
        truth_m = dense_truth_in_reach(sample) if is_partial else _dense_truth(sample)
    top, left, height, width = _crop(sample.image_size, crop_size)
    truth_m = truth_m[top : top + height, left : left + width].contiguous()
    if not truth_m.any():
        lacking = "return of a held-out ring in view" if truth == "rings" else "true depth"
        raise ValueError(
            f"sample {sample.sample_id} has no {lacking}, so there is nothing to score; leave the "
            "sample out"
        )
    given = replace(sample, points=points[~held_out], depth=None)
    cropped = crop(given, top=top, left=left, height=height, width=width)
    return HeldOutFrame(
        sample=cropped,
        rings=rings[~held_out],
        truth_m=truth_m,
        first_held_out=first_held_out,
        sensor_beams=sensor_beams,
        sensor_rings=sensor_rings if is_whole_turn(sample.points.numpy()) else sensor_beams,
        are_beams_assumed=are_beams_assumed,
    )


def split_depth(
    sample: CameraLidarSample, *, crop_size: tuple[int, int] = CROP_SIZE
) -> tuple[CameraLidarSample, Float32[Tensor, "height width"]]:
    """Split a frame without rings: the whole sweep is the input, `depth_in_reach` the truth.

    Both are cropped as by `split_rings`. Labels stay in the sample, depth does not.

    Raises:
        ValueError: The sample has no points or depth map, or no depth below the highest return.
    """
    top, left, height, width = _crop(sample.image_size, crop_size)
    in_reach = replace(sample, depth=dense_truth_in_reach(sample))
    cropped = crop(in_reach, top=top, left=left, height=height, width=width)
    assert cropped.depth is not None, "set above"
    if not cropped.depth.any():
        raise ValueError(
            f"sample {sample.sample_id} has no depth up to {_FARTHEST_DENSE_M:g} m below the "
            "highest return in the image, so there is nothing to score: check that camera and "
            "LiDAR see the same part of the scene, or leave the sample out"
        )
    return replace(cropped, depth=None), cropped.depth.contiguous()


def _rings_in_view(
    sample: CameraLidarSample, sweep: Float32[Tensor, "num_points 4"]
) -> tuple[Float32[Tensor, "num_in_view 4"], Int64[Tensor, " num_in_view"], int, bool]:
    """Select points in view, ring by ring, their rings and the sweep's number; True if assumed."""
    is_in_view = points_in_view(sample)
    numbers, is_ring_by_ring = rings_of_any_order(sweep.numpy())
    num_rings = count_rings(sweep.numpy()) if is_ring_by_ring else int(numbers.max()) + 1
    points, rings = sweep[is_in_view], torch.from_numpy(numbers)[is_in_view]
    # of 64 beams: numbered after the cut, like sweeps that are already cut
    is_as_cut = beams_of_sensor(num_rings) == NUM_RINGS and not is_whole_turn(points.numpy())
    if is_ring_by_ring:
        is_assumed = is_as_cut and not is_whole_turn(sweep.numpy())
        rings = torch.from_numpy(ring_numbers(points.numpy())) if is_as_cut else rings
        return points, rings, num_rings, is_assumed
    if is_as_cut:
        by_ring, cut_numbers = cut_in_kitti_order(points.numpy(), rings.numpy())
        return points[by_ring], torch.from_numpy(cut_numbers), num_rings, False
    rings, order = torch.sort(rings, stable=True)
    return points[order], rings, num_rings, False


def check_for_sweeps(dataset: SampleDataset) -> None:
    """Refuse a depth completion tree: its sparse depth maps have no rings.

    Raises:
        ValueError: The data set is one.
    """
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if isinstance(whole, KittiDepthDataset):
        raise ValueError(
            f"{describe_sparse_maps(whole, whole.root)}; they have no rings: give sweeps, such as "
            "a raw drive's, or score depth maps by the tree's truth (`sightline evaluate depth`)"
        )


def check_rings(frame: HeldOutFrame) -> None:
    """Refuse a frame cut to the image whose rings are not those of 64 beams, as is assumed.

    Raises:
        ValueError: Its rings are too far apart.
    """
    if not frame.are_beams_assumed:
        return
    points = frame.sample.points
    assert points is not None, "split_rings leaves points"
    try:
        check_spacing(points.numpy(), frame.rings.numpy())
    except ValueError as error:
        raise ValueError(f"sample {frame.sample.sample_id}: {error}") from error


def _is_held_out(rings: Int64[Tensor, " count"], first: int) -> Bool[Tensor, " count"]:
    return rings % HELD_OUT_EVERY == first


def _without_hidden(
    returns_m: Float32[Tensor, "height width"],
    everything_m: Float32[Tensor, "height width"],
    calibration: Calibration,
) -> Float32[Tensor, "height width"]:
    """Remove returns that the camera cannot see: they are not the truth for their pixels."""
    depths_m = returns_m.numpy()
    pixels = np.argwhere(depths_m > 0)
    pixel_depths_m = depths_m[*pixels.T]
    parallax = Parallax.from_calibration(calibration)
    is_hidden = hidden_by_parallax(everything_m.numpy(), pixels, pixel_depths_m, parallax)
    seen_m = returns_m.clone()
    seen_m[*pixels[is_hidden].T] = 0
    return seen_m


def _dense_truth(sample: CameraLidarSample) -> Float32[Tensor, "height width"]:
    if sample.depth is None:
        raise ValueError(
            f"sample {sample.sample_id} has no depth map to be scored on; open the data set with "
            "its depth maps (parts), take simulated frames, or take held-out rings for truth"
        )
    return torch.where(sample.depth <= _FARTHEST_DENSE_M, sample.depth, 0.0)


def dense_truth_in_reach(sample: CameraLidarSample) -> Float32[Tensor, "height width"]:
    """Compute the truth of `depth_in_reach`, for the whole image; 0 = none.

    Raises:
        ValueError: The sample has no points, or no depth map.
    """
    if sample.points is None:
        raise ValueError(f"sample {sample.sample_id} has no points, by which reach is determined")
    everything = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return torch.where(_is_in_reach(everything), _dense_truth(sample), 0.0)


def _is_in_reach(
    everything_m: Float32[Tensor, "height width"],
) -> Bool[Tensor, "height width"]:
    """Test which pixels are at or below the highest return of the columns around them."""
    is_hit = (everything_m > 0).numpy().astype(np.uint8)
    highest = cv2.dilate(is_hit, np.ones((1, _REACH_COLUMNS), np.uint8))
    return torch.from_numpy(np.maximum.accumulate(highest, axis=0) > 0)


def _crop(image_size: tuple[int, int], crop_size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Compute top, left, height and width of the bottom-centre crop, or of the whole image."""
    height, width = image_size
    if height <= _LARGEST_CROPPED[0] and width <= _LARGEST_CROPPED[1]:
        height, width = min(height, crop_size[0]), min(width, crop_size[1])
    return image_size[0] - height, (image_size[1] - width) // 2, height, width
