"""Depth completion scores without ground truth: some LiDAR rings are held out as the truth.

This is the protocol of all our tables on raw frames; `sightline.evaluation.held_out_frame` defines
the rings. Simulated frames can also be scored on their dense depth, with the same input rings.
"""

import statistics
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float, Float32
from scipy import ndimage
from torch import Tensor

from sightline.data.formats.lidar_origin import vehicle_frame_doubt
from sightline.data.formats.rings import NUM_RINGS
from sightline.evaluation.held_out_frame import (
    CROP_SIZE,
    HeldOutFrame,
    TruthChoice,
    check_rings,
    densities,
    split_rings,
)
from sightline.geometry.arguments import plain_size, plain_wholes, wrong_type
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.progress import track
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample, copy_of_sensors

if TYPE_CHECKING:
    from rich.table import Table

_TRUTHS: Final[dict[TruthChoice, str]] = {
    "rings": "held-out rings",
    "depth": "dense truth up to 80 m",
    "depth_in_reach": "dense truth up to 80 m below the highest ring",
}

_MIN_RING_SHARE: Final = 0.8  # of a sensor's beams, with returns in a whole sweep

Complete = Callable[[CameraLidarSample], DepthMap]
"""Depth completion method: from image, calibration and its input rings to dense depth."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutErrors:
    """Errors over the pixels with truth of one frame."""

    rmse_mm: float
    mae_mm: float
    median_mm: float
    """Median of the absolute errors."""
    coverage: float
    """Share of the truth's pixels with a depth from the method; the others were filled."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutScore:
    """Scores of a method at one number of beams, over one frame or many."""

    beams: int
    rmse_mm: float
    mae_mm: float
    median_mm: float
    """Median of the absolute errors."""
    coverage: float
    """Share of the truth's pixels with a depth from the method; the others were filled."""
    milliseconds: float
    """Wall-clock time of the method per frame: the median over several frames."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOutReport:
    """Scores of one method, by density."""

    scores: tuple[HeldOutScore, ...]
    """Mean over the frames, one for each density."""
    frames: tuple[tuple[str, tuple[HeldOutScore, ...]], ...]
    """Sample ids with their scores, one for each density."""
    sensor_beams: int = NUM_RINGS
    """Number of beams of the sensor of all frames."""
    image_sizes: tuple[tuple[int, int], ...] = (CROP_SIZE,)
    """Heights and widths of the scored images, without duplicates."""
    truth: TruthChoice = "rings"
    """Source of the truth."""

    def to_json(self) -> dict[str, object]:
        """Convert the report to its file's content; frames of one name are numbered."""
        return {
            "frames": len(self.frames),
            "sensor_beams": self.sensor_beams,
            "image_sizes": [list(size) for size in self.image_sizes],
            "truth": self.truth,
            "beams": {str(score.beams): _to_json(score) for score in self.scores},
            "per_frame": {
                name: {str(score.beams): _to_json(score) for score in scores}
                for name, (_, scores) in zip(self._frame_names(), self.frames, strict=True)
            },
        }

    def _frame_names(self) -> list[str]:
        """Name each frame differently: the second "sample" is "sample (2)"."""
        given = {sample_id for sample_id, _ in self.frames}
        names: dict[str, None] = {}
        repeats: Counter[str] = Counter()
        for sample_id, _ in self.frames:
            name = sample_id
            while name in names or (name != sample_id and name in given):
                repeats[sample_id] += 1
                name = f"{sample_id} ({repeats[sample_id] + 1})"
            names[name] = None
        return list(names)

    def table(self) -> "Table":
        """Make a table with one row for each density."""
        from rich.table import Table

        sizes = ", ".join(f"{width}x{height}" for height, width in self.image_sizes[:3])
        more = ", .." if len(self.image_sizes) > 3 else ""
        title = (
            f"depth on {_TRUTHS[self.truth]}, mean of {len(self.frames):,} frames: a sensor of "
            f"{self.sensor_beams} beams, images of {sizes}{more}"
        )
        table = Table(title=title, title_justify="left")
        for column in ("beams", "RMSE mm", "MAE mm", "median mm", "coverage", "time ms"):
            table.add_column(column, justify="right", no_wrap=True)
        for score in self.scores:
            table.add_row(
                str(score.beams),
                f"{score.rmse_mm:.0f}",
                f"{score.mae_mm:.0f}",
                f"{score.median_mm:.0f}",
                f"{score.coverage:.1%}",
                f"{score.milliseconds:.1f}",
            )
        return table


@named_arguments
def evaluate_held_out(
    samples: Iterable[CameraLidarSample],
    complete: Complete,
    *,
    beams: Sequence[int] | None = None,
    truth: TruthChoice = "rings",
    crop_size: tuple[int, int] = CROP_SIZE,
    total: int | None = None,
) -> HeldOutReport:
    """Score a method on the held-out rings of samples with points, or on their depth maps.

    RMSE, MAE and median are taken per image and averaged, as in KITTI's depth benchmark. Pixels
    without a prediction take the nearest one (Euclidean, in the image). Samples are drawn one at a
    time.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> predictor = sightline.load("depth-fast-cpu")
        >>> report = sightline.evaluate_held_out([sample], predictor, beams=(16,))
        >>> [score.beams for score in report.scores]
        [16]

    Args:
        samples: Frames with a sweep in KITTI's order, or with rings that their elevations separate.
        complete: The method. It gets a cropped sample with its input rings, without truth.
        beams: Densities to score. None: all of the sensor's beams, half of them, a quarter and an
            eighth.
        truth: Source of the truth.
        crop_size: Height and width [px] of the bottom-centre crop that is completed and scored;
            images larger than KITTI's are scored whole.
        total: Number of samples, for the progress bar, if `samples` has no length.

    Raises:
        ValueError: A frame has no points, no held-out return in view, or is from another sensor
            than the previous ones; a density does not divide the sensor's beams; or the method
            returns a map of another size, a depth that is not finite, or no depth at all.
    """
    beams = None if beams is None else plain_wholes("beams", beams)
    if beams == ():
        raise ValueError("beams is empty; name at least one density, e.g. 64")
    height, width = crop_size = plain_size("crop_size", crop_size)
    if height > width:
        raise ValueError(
            f"crop_size is ({height}, {width}), taller than wide: give height, width, such as "
            f"({width}, {height})"
        )
    frames: list[tuple[str, tuple[HeldOutScore, ...]]] = []
    sizes: dict[tuple[int, int], None] = {}
    sensor_beams = sensor_rings = 0
    for sample in track(samples, description="scoring", total=total):
        frame = split_rings(sample, truth=truth, crop_size=crop_size)
        if not frames:
            sensor_beams, sensor_rings = frame.sensor_beams, frame.sensor_rings
            _warn_of_vehicle_frame(sample)
            _warn_of_few_rings(frame)
        _check_sensor(frame, sensor_beams, sensor_rings)
        num_beams = densities(sensor_beams) if beams is None else beams
        scores = tuple(_score_frame(frame, complete, number) for number in num_beams)
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
        truth=truth,
    )


def _warn_of_vehicle_frame(sample: CameraLidarSample) -> None:
    """Warn of points whose frame has its origin on the road, where no LiDAR is."""
    doubt = vehicle_frame_doubt(sample)
    if doubt is not None:
        warn_user(
            f"{doubt}, by which rings are counted and returns hidden from the camera are found, so "
            "scores differ by some percent from those of sweeps in the LiDAR's own frame; give "
            "these",
        )


def _warn_of_few_rings(frame: HeldOutFrame) -> None:
    """Warn of a sensor with far fewer rings than the beams that it is counted as."""
    if frame.sensor_rings < _MIN_RING_SHARE * frame.sensor_beams:
        warn_user(
            f"the sweep of {frame.sample.sample_id} has {frame.sensor_rings} rings with returns "
            f"and is counted as of {frame.sensor_beams} beams: numbers of beams are shares of "
            f"{frame.sensor_beams}, so a half keeps every second ring; if it has fewer beams, give "
            "sweeps in the LiDAR's own frame",
        )


def _check_sensor(frame: HeldOutFrame, expected_beams: int, expected_rings: int) -> None:
    if frame.sensor_beams != expected_beams:
        raise ValueError(
            f"sample {frame.sample.sample_id} was taken by a sensor of {frame.sensor_beams} beams "
            f"({frame.sensor_rings} rings), the frames before it by one of {expected_beams} "
            f"({expected_rings} rings); score the sensors one by one, or if they are one, give "
            "sweeps in its own frame"
        )
    check_rings(frame)


def _score_frame(frame: HeldOutFrame, complete: Complete, beams: int) -> HeldOutScore:
    given = copy_of_sensors(frame.with_beams(beams))
    start = time.perf_counter()
    prediction = complete(given)
    if not isinstance(prediction, DepthMap):
        raise wrong_type("the method's prediction", prediction, "DepthMap")
    prediction.depth_m.cpu()  # copied inside the timing, so that a GPU has really finished
    milliseconds = (time.perf_counter() - start) * 1e3
    place = f"sample {given.sample_id} with {beams} beams"
    errors = depth_map_errors(frame.truth_m, prediction, place)
    return HeldOutScore(
        beams=beams,
        rmse_mm=errors.rmse_mm,
        mae_mm=errors.mae_mm,
        median_mm=errors.median_mm,
        coverage=errors.coverage,
        milliseconds=milliseconds,
    )


def _mean_score(scores: Sequence[HeldOutScore]) -> HeldOutScore:
    return HeldOutScore(
        beams=scores[0].beams,
        rmse_mm=statistics.fmean(score.rmse_mm for score in scores),
        mae_mm=statistics.fmean(score.mae_mm for score in scores),
        median_mm=statistics.fmean(score.median_mm for score in scores),
        coverage=statistics.fmean(score.coverage for score in scores),
        milliseconds=statistics.median(score.milliseconds for score in scores),
    )


def _to_json(score: HeldOutScore) -> dict[str, float]:
    return {
        "rmse_mm": score.rmse_mm,
        "mae_mm": score.mae_mm,
        "median_mm": score.median_mm,
        "coverage": score.coverage,
        "milliseconds": score.milliseconds,
    }


def depth_map_errors(
    true_depth_m: Float32[Tensor, "height width"],
    prediction: DepthMap,
    place: str,
    *,
    zero_where_nothing: bool = False,
) -> HeldOutErrors:
    """Score a method's depth map on a frame's truth.

    Pixels without a prediction take the nearest one (Euclidean, in the image).

    Args:
        true_depth_m: The frame's truth; 0 = none.
        prediction: Depth map of the same size.
        place: Name of the frame in error messages, e.g. "sample 000001 with 64 beams".
        zero_where_nothing: Whether a map without any depth counts as 0 m everywhere, so that its
            error is the truth itself; otherwise it is refused.

    Raises:
        ValueError: The map is of another size, or has a depth that is not finite, or none at all.
    """
    depth_m = prediction.depth_m.numpy(force=True).astype(np.float64)
    size = true_depth_m.shape
    if depth_m.shape != size:
        raise ValueError(
            f"the method gave a depth map of {depth_m.shape[0]}x{depth_m.shape[1]} for {place}, "
            f"expected {size[0]}x{size[1]} (height x width)"
        )
    if not np.isfinite(depth_m).all():
        raise ValueError(f"the method gave depths that are not finite for {place}; use 0 for none")
    is_predicted = depth_m > 0
    truth_m = true_depth_m.numpy().astype(np.float64)
    scored = truth_m > 0
    if is_predicted.any():
        if not is_predicted[scored].all():
            depth_m = _fill_by_nearest(depth_m)
    elif not zero_where_nothing:
        raise ValueError(f"the method gave no depth at all for {place}; leave the sample out")
    error_mm = 1e3 * (depth_m - truth_m)[scored]
    return HeldOutErrors(
        rmse_mm=float(np.sqrt(np.mean(error_mm**2))),
        mae_mm=float(np.mean(np.abs(error_mm))),
        median_mm=float(np.median(np.abs(error_mm))),
        coverage=float(is_predicted[scored].mean()),
    )


def _fill_by_nearest(depth_m: Float[np.ndarray, "height width"]) -> np.ndarray:
    rows, columns = ndimage.distance_transform_edt(
        depth_m <= 0, return_distances=False, return_indices=True
    )
    filled: np.ndarray = depth_m[rows, columns]
    return filled
