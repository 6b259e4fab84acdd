"""Scores depth completion on frames without ground truth: some rings are held out as truth.

The protocol of all our tables on raw frames. Rings are numbered as
`sightline.data.rings.ring_numbers` does, after the sweep is cut to the image, so that whole sweeps
and KITTI's reduced ones score alike. Every eighth ring, from number 4, is never given to any
method: its returns are the truth. A method sees, of the other rings, all ("64 beams"), every
second ("32"), every fourth ("16") or every eighth ("8"); the truth is the same for all.

Of another sensor than KITTI's, whole sweeps tell how many beams it has. Its rings are numbered
by laser, before the cut, and the densities are all of its beams, half of them and so on.
"""

import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import torch
from beartype import beartype
from jaxtyping import Bool, Float32, Int64, jaxtyped
from scipy import ndimage
from torch import Tensor

from sightline.data.augmentation import crop, keep_rings, points_in_view
from sightline.data.progress import track
from sightline.data.rings import NUM_RINGS, check_spacing, count_beams, ring_numbers
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

if TYPE_CHECKING:
    from rich.table import Table

BEAMS = (64, 32, 16, 8)
"""Densities of the tables."""
CROP_SIZE = (352, 1216)
"""Height and width of the bottom-centre crop, as in the depth benchmark's own selection."""
_LARGEST_CROPPED = (376, 1242)  # KITTI's largest images: of others the crop would miss the scene

HELD_OUT_EVERY = 8
FIRST_HELD_OUT = 4
"""The tables' own; training may hold out others."""
# A return farther than this behind the nearest point around it is hidden from the camera, which
# sits elsewhere than the LiDAR: it is no truth for the pixel that it falls on.
_VISIBILITY_WINDOW = (15, 7)  # rows, columns
_VISIBILITY_FACTOR = 1.15
_VISIBILITY_MARGIN_M = 0.5

Complete = Callable[[CameraLidarSample], DepthMap]
"""A depth completion method: image, calibration and the rings it may see, in; dense depth out."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutFrame:
    """One frame parted into what methods may see and what they are scored on."""

    sample: CameraLidarSample
    """Cropped; its points are the returns in view of the rings that are not held out."""
    rings: Int64[Tensor, " num_points"]
    """Ring number of each point of `sample`."""
    truth_m: Float32[Tensor, "height width"]
    """Depths of the held-out returns that the camera sees; 0 = none."""
    first_held_out: int = FIRST_HELD_OUT
    sensor_beams: int = NUM_RINGS
    """How many the sensor has that took the sweep."""

    def with_beams(self, beams: int, *, start: int = 0) -> CameraLidarSample:
        """The sample as a sensor of so many beams would have taken it.

        Args:
            beams: How many of the sensor's.
            start: How many of the rings that are not held out to pass over at the top, for a
                sensor that looks a little lower than the tables' one.

        Raises:
            ValueError: The sensor's number is no multiple of `beams`.
        """
        if beams < 1 or self.sensor_beams % beams:
            choices = ", ".join(map(str, densities(self.sensor_beams)))
            raise ValueError(
                f"beams must divide the sensor's {self.sensor_beams} evenly ({choices}, ..), got "
                f"{beams}"
            )
        rings = torch.arange(self.sensor_beams + 1)  # of a cut sweep the last one may be in halves
        given = rings[~_is_held_out(rings, self.first_held_out)]
        step = self.sensor_beams // beams
        return keep_rings(self.sample, self.rings, given[start::step].tolist())


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutScore:
    """How well a method did with so many beams, over one frame or many."""

    beams: int
    rmse_mm: float
    mae_mm: float
    coverage: float
    """Share of the truth's pixels for which the method had a depth; the rest were filled."""
    milliseconds: float
    """Wall-clock time of the method for a frame: the median over several frames."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutReport:
    """Scores of one method, per density."""

    scores: tuple[HeldOutScore, ...]
    """Mean over the frames, one for each density."""
    frames: tuple[tuple[str, tuple[HeldOutScore, ...]], ...]
    """Sample id and its scores, one for each density."""
    sensor_beams: int = NUM_RINGS
    """How many the sensor of all frames has."""
    image_sizes: tuple[tuple[int, int], ...] = (CROP_SIZE,)
    """Height and width of what was scored, each once."""

    def to_json(self) -> dict[str, object]:
        """What the report file holds."""
        return {
            "frames": len(self.frames),
            "sensor_beams": self.sensor_beams,
            "image_sizes": [list(size) for size in self.image_sizes],
            "beams": {str(score.beams): _to_json(score) for score in self.scores},
            "per_frame": {
                sample_id: {str(score.beams): _to_json(score) for score in scores}
                for sample_id, scores in self.frames
            },
        }

    def table(self) -> "Table":
        """One row for each density."""
        from rich.table import Table

        sizes = ", ".join(f"{width}x{height}" for height, width in self.image_sizes[:3])
        more = ", .." if len(self.image_sizes) > 3 else ""
        title = (
            f"depth on held-out rings, mean of {len(self.frames):,} frames: a sensor of "
            f"{self.sensor_beams} beams, images of {sizes}{more}"
        )
        table = Table(title=title, title_justify="left")
        for column in ("beams", "RMSE mm", "MAE mm", "coverage", "time ms"):
            table.add_column(column, justify="right", no_wrap=True)
        for score in self.scores:
            table.add_row(
                str(score.beams),
                f"{score.rmse_mm:.0f}",
                f"{score.mae_mm:.0f}",
                f"{score.coverage:.1%}",
                f"{score.milliseconds:.1f}",
            )
        return table


def evaluate_held_out(
    samples: Iterable[CameraLidarSample],
    complete: Complete,
    *,
    beams: Sequence[int] | None = None,
    total: int | None = None,
) -> HeldOutReport:
    """Scores a method on the held-out rings of samples that have points.

    RMSE and MAE are taken per image and averaged, as KITTI's depth benchmark does. Pixels without a
    prediction take the nearest one (Euclidean, in the image). Samples are drawn one at a time.

    Args:
        samples: Frames with a sweep in KITTI's order.
        complete: The method. It gets a cropped sample with the rings it may see, without truth.
        beams: Densities to score. None: all of the sensor's beams, half of them, a quarter and an
            eighth.
        total: Number of samples, for the progress bar, where `samples` does not know it.

    Raises:
        ValueError: A frame has no points, no held-out return in view, or was taken by another
            sensor than the ones before; a density does not part the sensor's beams evenly; or the
            method gives a map of another size, a depth that is not finite, or no depth at all.
    """
    if beams is not None and not beams:
        raise ValueError("beams is empty; name at least one density, e.g. 64")
    frames: list[tuple[str, tuple[HeldOutScore, ...]]] = []
    sizes: dict[tuple[int, int], None] = {}
    sensor_beams = 0
    for sample in track(samples, description="scoring", total=total):
        frame = split_rings(sample)
        sensor_beams = sensor_beams or frame.sensor_beams
        _check_sensor(frame, sensor_beams)
        wanted = densities(sensor_beams) if beams is None else beams
        scores = tuple(_score_frame(frame, complete, number) for number in wanted)
        frames.append((sample.sample_id, scores))
        sizes[frame.sample.image_size] = None
    if not frames:
        raise ValueError("there is no frame to score; name a folder or a list that holds some")
    by_density = zip(*(scores for _, scores in frames), strict=True)
    return HeldOutReport(
        scores=tuple(map(_mean_score, by_density)),
        frames=tuple(frames),
        sensor_beams=sensor_beams,
        image_sizes=tuple(sizes),
    )


def densities(sensor_beams: int) -> tuple[int, ...]:
    """Those of the tables, for a sensor of so many beams: all, half, a quarter, an eighth."""
    return tuple(sensor_beams * beams // NUM_RINGS for beams in BEAMS)


def split_rings(sample: CameraLidarSample, *, first_held_out: int = FIRST_HELD_OUT) -> HeldOutFrame:
    """Parts a frame: held-out rings to truth, the others to the sample that methods get.

    Both are cropped to `CROP_SIZE` at the bottom centre; an image that is smaller, or larger than
    KITTI's, is kept whole. Labels and depth are taken off the sample.

    Args:
        sample: The frame.
        first_held_out: The first ring that is held out; every eighth from there is.

    Raises:
        ValueError: The sample has no points, they are not in KITTI's order, or none of the
            held-out ones is in view.
    """
    if sample.points is None or len(sample.points) == 0:
        raise ValueError(
            f"sample {sample.sample_id} has no points, but held-out rings need a sweep; leave the "
            "sample out"
        )
    is_in_view = points_in_view(sample)
    points = sample.points[is_in_view]
    sensor_beams = count_beams(sample.points.numpy())
    try:
        if sensor_beams == NUM_RINGS:  # numbered after the cut: as sweeps that come cut
            rings = torch.from_numpy(ring_numbers(points.numpy()))
        else:
            rings = torch.from_numpy(ring_numbers(sample.points.numpy()))[is_in_view]
    except ValueError as error:
        raise ValueError(f"sample {sample.sample_id}: {error}") from error
    held_out = _is_held_out(rings, first_held_out)
    truth = sparse_depth_map(points[held_out], sample.calibration, sample.image_size)
    everything = sparse_depth_map(points, sample.calibration, sample.image_size)
    truth = torch.where(_is_visible(truth, everything), truth, 0.0)
    top, left, height, width = _crop(sample.image_size)
    truth = truth[top : top + height, left : left + width].contiguous()
    if not truth.any():
        raise ValueError(
            f"sample {sample.sample_id} has no return of a held-out ring in view, so there is "
            "nothing to score; leave the sample out"
        )
    given = replace(sample, points=points[~held_out], depth=None)
    cropped = crop(given, top=top, left=left, height=height, width=width)
    return HeldOutFrame(
        sample=cropped,
        rings=rings[~held_out],
        truth_m=truth,
        first_held_out=first_held_out,
        sensor_beams=sensor_beams,
    )


def _check_sensor(frame: HeldOutFrame, expected_beams: int) -> None:
    place = f"sample {frame.sample.sample_id}"
    if frame.sensor_beams != expected_beams:
        raise ValueError(
            f"{place} was taken by a sensor of {frame.sensor_beams} beams, the frames before it "
            f"by one of {expected_beams}; score the sensors one by one"
        )
    if frame.sensor_beams == NUM_RINGS:
        points = frame.sample.points
        assert points is not None, "split_rings leaves points"
        try:
            check_spacing(points.numpy(), frame.rings.numpy())
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from error


def _is_held_out(rings: Int64[Tensor, " count"], first: int) -> Bool[Tensor, " count"]:
    return rings % HELD_OUT_EVERY == first


def _is_visible(
    depth_m: Float32[Tensor, "height width"], everything_m: Float32[Tensor, "height width"]
) -> Bool[Tensor, "height width"]:
    """Which depths have no nearer point of the sweep around them that would hide them."""
    occupied = np.where(everything_m.numpy() > 0, everything_m.numpy(), np.inf)
    nearest = torch.from_numpy(cv2.erode(occupied, np.ones(_VISIBILITY_WINDOW, np.uint8)))
    return depth_m <= _VISIBILITY_FACTOR * nearest + _VISIBILITY_MARGIN_M


def _crop(image_size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Top, left, height and width of the bottom-centre crop, or of the whole image."""
    height, width = image_size
    if height <= _LARGEST_CROPPED[0] and width <= _LARGEST_CROPPED[1]:
        height, width = min(height, CROP_SIZE[0]), min(width, CROP_SIZE[1])
    return image_size[0] - height, (image_size[1] - width) // 2, height, width


def _score_frame(frame: HeldOutFrame, complete: Complete, beams: int) -> HeldOutScore:
    given = frame.with_beams(beams)
    start = time.perf_counter()
    prediction = complete(given).depth_m.cpu()  # fetched inside, so that a GPU has really finished
    milliseconds = (time.perf_counter() - start) * 1e3
    depth_m = prediction.numpy().astype(np.float64)
    place = f"sample {given.sample_id} with {beams} beams"
    if depth_m.shape != given.image_size:
        raise ValueError(
            f"the method gave a depth map of {depth_m.shape[0]}x{depth_m.shape[1]} for {place}, "
            f"expected {given.image_size[0]}x{given.image_size[1]} (height x width)"
        )
    if not np.isfinite(depth_m).all():
        raise ValueError(f"the method gave depths that are not finite for {place}; use 0 for none")
    is_predicted = depth_m > 0
    if not is_predicted.any():
        raise ValueError(f"the method gave no depth at all for {place}; leave the sample out")
    truth = frame.truth_m.numpy().astype(np.float64)
    scored = truth > 0
    if not is_predicted[scored].all():
        depth_m = _fill_by_nearest(depth_m)
    error_mm = 1e3 * (depth_m - truth)[scored]
    return HeldOutScore(
        beams=beams,
        rmse_mm=float(np.sqrt(np.mean(error_mm**2))),
        mae_mm=float(np.mean(np.abs(error_mm))),
        coverage=float(is_predicted[scored].mean()),
        milliseconds=milliseconds,
    )


def _fill_by_nearest(depth_m: np.ndarray) -> np.ndarray:
    rows, columns = ndimage.distance_transform_edt(
        depth_m <= 0, return_distances=False, return_indices=True
    )
    filled: np.ndarray = depth_m[rows, columns]
    return filled


def _mean_score(scores: Sequence[HeldOutScore]) -> HeldOutScore:
    return HeldOutScore(
        beams=scores[0].beams,
        rmse_mm=statistics.fmean(score.rmse_mm for score in scores),
        mae_mm=statistics.fmean(score.mae_mm for score in scores),
        coverage=statistics.fmean(score.coverage for score in scores),
        milliseconds=statistics.median(score.milliseconds for score in scores),
    )


def _to_json(score: HeldOutScore) -> dict[str, float]:
    return {
        "rmse_mm": score.rmse_mm,
        "mae_mm": score.mae_mm,
        "coverage": score.coverage,
        "milliseconds": score.milliseconds,
    }
