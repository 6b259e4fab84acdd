"""Errors of one depth map by the rules of KITTI's depth completion benchmark.

The rules follow the evaluation program of the benchmark's development kit (Uhrig et al. 2017,
arXiv:1708.06500), but in float64 instead of float32. Depth maps here are metres with 0 = none.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

import numpy as np
from jaxtyping import Float, Float64

UNFILLED_M = -1.0
"""Depth of a pixel that stays without a value after the fill."""

_MM_PER_M = 1e3
_M_PER_KM = 1e3


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthScores:
    """Errors over pixels of one image, or the means of such errors over images.

    An undefined number is NaN: `silog`, if a pixel stays `UNFILLED_M`.
    """

    mae_mm: float
    rmse_mm: float
    imae_per_km: float
    """Mean absolute error of the inverse depth."""
    irmse_per_km: float
    """Root mean squared error of the inverse depth."""
    silog: float
    """Standard deviation of the log depth error, times 100: independent of a common scale."""
    abs_rel: float
    """Mean ratio of error to true depth."""
    sq_rel: float
    """Mean ratio of squared error to squared true depth."""
    coverage: float
    """Share of the pixels with ground truth that have a prediction, before the fill."""

    def to_json(self) -> dict[str, float | None]:
        """Map names to scores; undefined ones become None, as JSON has no NaN."""
        return {name: None if math.isnan(value) else value for name, value in asdict(self).items()}


def mean_scores(scores: Sequence[DepthScores]) -> DepthScores:
    """Compute the mean of each score; NaN if one is undefined, or there are none."""
    means = {
        field.name: statistics.fmean(getattr(score, field.name) for score in scores)
        if scores
        else math.nan
        for field in fields(DepthScores)
    }
    return DepthScores(**means)


def score_depth(
    prediction_m: Float[np.ndarray, "height width"],
    truth_m: Float[np.ndarray, "truth_height truth_width"],
) -> DepthScores:
    """Score a prediction over all pixels with ground truth, after `fill_gaps`.

    A pixel that stays `UNFILLED_M` has the depth -1 m and the inverse depth -1/m, and `silog` is
    undefined (the program prints nan).

    Raises:
        ValueError: The sizes differ, a depth is negative or not finite, or there is no truth.
    """
    _check(prediction_m, truth_m)
    scored = truth_m > 0
    predicted = prediction_m[scored]
    coverage = float(np.mean(predicted > 0))
    if coverage < 1:
        predicted = fill_gaps(prediction_m)[scored]
    return _score_pixels(predicted.astype(np.float64), truth_m[scored].astype(np.float64), coverage)


def score_predicted_pixels(
    prediction_m: Float[np.ndarray, "height width"],
    truth_m: Float[np.ndarray, "truth_height truth_width"],
) -> DepthScores | None:
    """Score only the pixels with both ground truth and a prediction; None if there is none.

    This is not the benchmark's score: pixels without a prediction have no cost here. `coverage`,
    as in `score_depth`, is the share of pixels with one.

    Raises:
        ValueError: The sizes differ, a depth is negative or not finite, or there is no truth.
    """
    _check(prediction_m, truth_m)
    scored = (truth_m > 0) & (prediction_m > 0)
    if not scored.any():
        return None
    coverage = float(np.count_nonzero(scored) / np.count_nonzero(truth_m > 0))
    return _score_pixels(
        prediction_m[scored].astype(np.float64), truth_m[scored].astype(np.float64), coverage
    )


def fill_gaps(depth_m: Float[np.ndarray, "height width"]) -> Float64[np.ndarray, "height width"]:
    """Fill pixels without depth like the program does before scoring.

    Within a row a gap takes the nearer (smaller) of the depths at its two ends; pixels before the
    first or after the last depth of the row take that depth. Then rows above the first and below
    the last row with depths become copies of it. Empty rows in between stay `UNFILLED_M`, like a
    map without any depth.
    """
    depths = np.where(depth_m > 0, depth_m.astype(np.float64), np.inf)
    filled: np.ndarray = np.minimum(_carry_right(depths), _carry_right(depths[:, ::-1])[:, ::-1])
    has_depths = np.isfinite(filled).all(axis=1)
    filled[~has_depths] = UNFILLED_M
    if has_depths.any():
        rows = np.flatnonzero(has_depths)
        filled[: rows[0]] = filled[rows[0]]
        filled[rows[-1] + 1 :] = filled[rows[-1]]
    return filled


def _carry_right(
    depths: Float64[np.ndarray, "height width"],
) -> Float64[np.ndarray, "height width"]:
    """Fill each pixel with the last finite depth at or left of it; infinite if there is none."""
    columns = np.where(np.isfinite(depths), np.arange(depths.shape[1]), 0)
    carried: np.ndarray = np.take_along_axis(depths, np.maximum.accumulate(columns, axis=1), axis=1)
    return carried


def _score_pixels(
    predicted: Float64[np.ndarray, " num_pixels"],
    truth: Float64[np.ndarray, " num_pixels"],
    coverage: float,
) -> DepthScores:
    error = np.abs(predicted - truth)
    inverse_error = np.abs(1 / predicted - 1 / truth)
    with np.errstate(invalid="ignore"):  # NaN for an unfilled pixel, as documented
        log_error = np.log(predicted) - np.log(truth)
    relative_error = error / truth
    return DepthScores(
        mae_mm=float(np.mean(error)) * _MM_PER_M,
        rmse_mm=float(np.sqrt(np.mean(error**2))) * _MM_PER_M,
        imae_per_km=float(np.mean(inverse_error)) * _M_PER_KM,
        irmse_per_km=float(np.sqrt(np.mean(inverse_error**2))) * _M_PER_KM,
        # The mean is subtracted first: the difference of mean square and squared mean loses digits.
        silog=float(np.sqrt(np.mean((log_error - np.mean(log_error)) ** 2))) * 100,
        abs_rel=float(np.mean(relative_error)),
        sq_rel=float(np.mean(relative_error**2)),
        coverage=coverage,
    )


def _check(
    prediction_m: Float[np.ndarray, "height width"],
    truth_m: Float[np.ndarray, "truth_height truth_width"],
) -> None:
    if prediction_m.shape != truth_m.shape:
        sizes = [f"{height}x{width}" for height, width in (prediction_m.shape, truth_m.shape)]
        raise ValueError(
            f"the prediction is {sizes[0]} but the ground truth is {sizes[1]} (height x width); "
            "predict at the size of the ground truth"
        )
    for name, depth_m in (("prediction", prediction_m), ("ground truth", truth_m)):
        # Written so that NaN, for which all comparisons are false, is refused.
        if not ((depth_m >= 0) & (depth_m < np.inf)).all():
            raise ValueError(
                f"the {name} holds depths that are negative or not finite; use 0 for no value"
            )
    if not (truth_m > 0).any():
        raise ValueError("the ground truth holds no depth at all; leave the image out")
