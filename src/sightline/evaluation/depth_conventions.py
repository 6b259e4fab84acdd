"""Doubts about predicted depth maps, compared with ground truth: units, scales and orientations.

`compare_depths` keeps a few numbers of an image, `doubts_about_depths` judges those of a set.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32, Float64, Int64

from sightline.data.formats.map_png import (
    MAX_DEPTH_M,
    MIN_HIGHEST_PX,
    MIN_HIGHEST_SHARE,
    NO_VALUE_REMEDY,
)
from sightline.evaluation.ray_distances import fit_rays, ring_sums

_UNITS: Final = {"metres": 1, "centimetres": 100, "millimetres": 1000}
_STEPS_PER_M: Final = 256  # of KITTI's files
_WRONG_RATIOS: Final = {
    **{steps / _STEPS_PER_M: f"predictions in {unit}" for unit, steps in _UNITS.items()},
    **{_STEPS_PER_M / steps: f"ground truth in {unit}" for unit, steps in _UNITS.items()},
    _STEPS_PER_M / 100: "ground truth in centimetres, or of predictions with 65535 for 100 m",
}
"""Ratios of predicted to true depth that a wrong unit gives, with the causes."""
_RATIO_TOLERANCE: Final = 0.1
_FAR_RATIO: Final = 4.0
"""Ratio of most depths, or its inverse, that no error of a method explains."""
_SCALE_RATIO: Final = 1.25
"""Smallest common ratio, or its inverse, that is doubted where the others spread little."""
_MAX_SPREAD: Final = 0.25
"""Largest spread of the logarithms of the ratios about a common one, as a share of its own."""
_INVERSE_CORRELATION: Final = -0.5
"""Correlation of the logarithms of predicted and true depths below which they are inverse."""
_OWN_RATIO, _OWN_CORRELATION = 1.5, 0.9
"""Smallest geometric mean of the ratios, or its inverse, and correlation of these logarithms of
depths with a scale and offset of their own."""
_BETTER: Final = 0.5
"""Largest error of turned predictions, as a share of that as written, for a doubt."""
_MIN_WRONG_MAPS, _WRONG_SHARE = 2, 0.25
"""Number of maps of a wrong unit, or share in a small set, that no bad map explains."""
_MIN_PIXELS: Final = 100
"""Minimum number of compared pixels for a doubt; fewer agree by chance."""
_CONSTANT: Final = 1e-9
"""Largest product of standard deviations that is rounding."""
_ORIENTATIONS: Final[dict[str, tuple[slice, slice]]] = {
    "mirrored from left to right": np.s_[:, ::-1],
    "upside down": np.s_[::-1, :],
    "rotated by 180 degrees": np.s_[::-1, ::-1],
}
_AS_KITTI: Final = f"write metres times {_STEPS_PER_M}, as KITTI does"


@dataclass(frozen=True, kw_only=True, slots=True)
class ComparedDepths:
    """Numbers of one image, or the sums of several, from which wrong conventions are recognised."""

    pixels: int
    """Number of pixels with both ground truth and prediction."""
    predicted: int
    """Number of pixels with a prediction."""
    wrong_ratios: Int64[np.ndarray, " ratios"]
    """Number of these pixels with about each ratio of `_WRONG_RATIOS`, none of them 65535."""
    far: int
    """Number of these pixels with a ratio beyond `_FAR_RATIO` either way."""
    highest: Int64[np.ndarray, "2"]
    """Number of these pixels at which the prediction, or the ground truth, is 65535."""
    log_sums: Float64[np.ndarray, "5"]
    """Sums over these pixels of p, t, p p, t t and p t, the logarithms of predicted and true
    depth."""
    errors: Float64[np.ndarray, "orientations 2"]
    """Number of pixels with both, and sum of the absolute differences of their logarithms, for
    predictions as written, then in each of `_ORIENTATIONS`."""
    rings: Float64[np.ndarray, "half_rings 2"]
    """Sums by the distance from the image's centre; see `ring_sums`."""

    @property
    def mean_error(self) -> float:
        """Mean absolute difference of the logarithms as written; 0 without a pixel."""
        count, error = self.errors[0]
        return float(error / max(count, 1))

    def wrong_unit(self) -> tuple[float, str] | None:
        """Ratio that most pixels have by a wrong unit, with the cause; None: there is none."""
        if self.pixels < _MIN_PIXELS:
            return None
        half = (self.pixels - self.highest.sum()) / 2
        counts = zip(_WRONG_RATIOS.items(), self.wrong_ratios, strict=True)
        return next((each for each, count in counts if count > half), None)

    def __add__(self, other: "ComparedDepths") -> "ComparedDepths":
        """Sum the numbers of two sets of images."""
        return ComparedDepths(
            **{name: getattr(self, name) + getattr(other, name) for name in self.__slots__}
        )


def compare_depths(
    prediction_m: Float32[np.ndarray, "height width"],
    truth_m: Float32[np.ndarray, "height width"],
) -> ComparedDepths:
    """Compare an image's predicted depths with the true ones [m], 0 = none."""
    rows, columns = np.nonzero(truth_m > 0)
    true_m = truth_m[rows, columns]
    true_logs = np.log(true_m)
    predicted_m = prediction_m[rows, columns]
    has_both = predicted_m > 0
    ratios = predicted_m[has_both] / true_m[has_both]
    logs = np.stack([np.log(predicted_m[has_both]), true_logs[has_both]]).astype(np.float64)
    is_highest = np.stack([each_m[has_both] == MAX_DEPTH_M for each_m in (predicted_m, true_m)])
    others = ratios[~is_highest.any(axis=0)]
    turned = (prediction_m[turn][rows, columns] for turn in _ORIENTATIONS.values())
    return ComparedDepths(
        pixels=len(ratios),
        predicted=int((prediction_m > 0).sum()),
        wrong_ratios=np.array(
            [(abs(others / each - 1) < _RATIO_TOLERANCE).sum() for each in _WRONG_RATIOS]
        ),
        far=int((abs(logs[0] - logs[1]) > np.log(_FAR_RATIO)).sum()),
        highest=is_highest.sum(axis=1),
        log_sums=np.array([*logs.sum(axis=1), *(logs**2).sum(axis=1), logs.prod(axis=0).sum()]),
        errors=np.array([log_error(each_m, true_logs) for each_m in (predicted_m, *turned)]),
        rings=ring_sums(logs[0] - logs[1], rows[has_both], columns[has_both], truth_m.shape),
    )


def doubts_about_sparse_maps(
    images: Iterable[ComparedDepths], sparse: Path, truth: Path
) -> Iterator[str]:
    """Say why sparse depth maps are probably not the measured ones; see `doubts_about_depths`."""
    summed = reduce(add, images)
    if not summed.predicted:
        yield (
            f"{sparse}: every map is empty, as of a LiDAR without returns, so no lost returns are "
            "counted: if it had some, name the sparse maps of these images"
        )
    elif not summed.pixels:
        yield (
            f"{sparse}: no map has a value at a pixel with ground truth in {truth}, so no lost "
            "returns are counted: name the sparse maps of these images, unless the truth leaves "
            "their pixels out"
        )
    elif summed.pixels >= _MIN_PIXELS:
        doubts = list(_doubts_about_highest(summed, sparse, truth))
        yield from doubts or _doubts_about_values(summed, sparse, truth)


def doubts_about_depths(
    images: Iterable[ComparedDepths], predictions: Path, truth: Path
) -> Iterator[str]:
    """Say which convention the depths of a set probably follow in place of KITTI's.

    Args:
        images: Numbers of each image, at least one.
        predictions: Prediction file or folder, for the messages.
        truth: Ground-truth file or folder.

    Yields:
        One line each, with a remedy.
    """
    every = list(images)
    summed = reduce(add, every)
    if summed.pixels < _MIN_PIXELS:
        return
    if not summed.errors[0, 1]:
        yield (
            f"{predictions}: every depth is exactly that of {truth}: they are copies; name the "
            "predictions of a method"
        )
    doubts = list(_doubts_about_highest(summed, predictions, truth))
    doubts = doubts or list(_doubts_about_mixture(every, summed, predictions, truth))
    yield from doubts or _doubts_about_values(summed, predictions, truth)


def _doubts_about_mixture(
    images: Sequence[ComparedDepths], summed: ComparedDepths, predictions: Path, truth: Path
) -> Iterator[str]:
    """Doubt a set of which some maps are in another unit than the others."""
    if summed.wrong_unit() is not None:
        return
    wrong = [unit for each in images if (unit := each.wrong_unit()) is not None]
    if len(wrong) >= min(_MIN_WRONG_MAPS, _WRONG_SHARE * len(images)) and wrong:
        ratio, cause = Counter(wrong).most_common(1)[0][0]
        yield (
            f"{predictions}: {len(wrong):,} of {len(images):,} maps have most depths about "
            f"{ratio:.3g} times those of {truth}, the others have not, probably because of {cause} "
            f"in these maps alone: {_AS_KITTI}, in all maps"
        )


def _doubts_about_highest(summed: ComparedDepths, predictions: Path, truth: Path) -> Iterator[str]:
    """Doubt pixels with the largest number, which other programs write for no value.

    Depths in a wrong unit may end there, too, but most others are then wrong as well.
    """
    num_others = summed.pixels - summed.highest.sum()
    num_far = summed.far - summed.highest.sum()
    if 2 * max(num_far, summed.wrong_ratios.max()) >= num_others:
        return
    for folder, count in zip((predictions, truth), summed.highest, strict=True):
        if count >= max(MIN_HIGHEST_PX, MIN_HIGHEST_SHARE * summed.pixels):
            yield (
                f"{folder}: {count:,} of {summed.pixels:,} compared pixels hold 65535, probably "
                f"for no value, and were taken for {MAX_DEPTH_M:.0f} m: {NO_VALUE_REMEDY}"
            )


def _doubts_about_values(summed: ComparedDepths, predictions: Path, truth: Path) -> Iterator[str]:
    """Name the first of several wrong conventions that explains the depths."""
    unit = summed.wrong_unit()
    if unit is not None:
        ratio, cause = unit
        yield (
            f"{predictions}: most depths are about {ratio:.3g} times those of {truth}, "
            f"probably because of {cause}: {_AS_KITTI}"
        )
        return
    rays = fit_rays(summed.rings)
    if rays is not None:
        focal, is_predicted = rays
        near, far = (truth, predictions) if is_predicted else (predictions, truth)
        yield (
            f"{far}: depths grow against those of {near} with the distance r from the image's "
            f"centre, as sqrt(1 + r^2 / f^2) does with f of {focal:.2g} times the longer side, so "
            "they are probably distances along each pixel's ray: divide them by this root, with "
            f"the camera's own f in pixels and r from its principal point; {_AS_KITTI}"
        )
        return
    half = (summed.pixels - summed.highest.sum()) / 2
    counts, errors = summed.errors.T
    mean_errors = np.where(counts >= _MIN_PIXELS, errors / np.maximum(counts, 1), np.inf)
    best = int(mean_errors[1:].argmin())
    bias, spread, correlation, inverse_spread = _log_moments(summed)
    is_inverse = correlation < _INVERSE_CORRELATION and inverse_spread < mean_errors[1 + best]
    if mean_errors[1 + best] < _BETTER * mean_errors[0] and not is_inverse:
        yield (
            f"{predictions}: depths fit those of {truth} better {[*_ORIENTATIONS][best]}: mean "
            f"absolute difference of their logarithms {mean_errors[1 + best]:.3g}, as written "
            f"{mean_errors[0]:.3g}: write rows from top to bottom and columns from left to right"
        )
        return
    if correlation < _INVERSE_CORRELATION:
        yield (
            f"{predictions}: depths fall where those of {truth} rise (correlation of their "
            f"logarithms {correlation:.2f}), probably because of inverse depths or disparities: "
            f"convert them to depths; {_AS_KITTI}"
        )
    elif abs(bias) > np.log(_SCALE_RATIO) and spread < _MAX_SPREAD * abs(bias):
        yield (
            f"{predictions}: depths are {np.exp(bias):.3g} times those of {truth}, with a spread "
            f"of {np.expm1(spread):.1%} only, probably because of a scale of their own: {_AS_KITTI}"
        )
    elif abs(bias) > np.log(_OWN_RATIO) and correlation > _OWN_CORRELATION:
        yield (
            f"{predictions}: depths rise with those of {truth} (correlation of their logarithms "
            f"{correlation:.2f}), but are {np.exp(bias):.3g} times as large (geometric mean), "
            "probably because of a scale or an offset of their own, as of maps stretched to "
            f"0..65535: {_AS_KITTI}"
        )
    elif summed.far > half:
        yield (
            f"{predictions}: most depths are over {_FAR_RATIO:g} times those of {truth}, or less "
            f"than 1/{_FAR_RATIO:g}: {_AS_KITTI}"
        )


def log_error(
    predicted_m: Float32[np.ndarray, " pixels"], true_logs: Float32[np.ndarray, " pixels"]
) -> tuple[int, float]:
    """Count the predicted pixels, and sum the absolute differences of their logarithms."""
    has_both = predicted_m > 0
    return int(has_both.sum()), float(
        abs(np.log(predicted_m[has_both]) - true_logs[has_both]).sum()
    )


def _log_moments(summed: ComparedDepths) -> tuple[float, float, float, float]:
    """Compute moments of the logarithms of predicted and true depths.

    Returns:
        Mean and standard deviation of the logarithms of their ratios; the correlation of their
        logarithms, 0 if either is constant; the standard deviation of the logarithms of their
        products, which is small for inverse depths.
    """
    predicted, true, predicted_2, true_2, product = summed.log_sums / summed.pixels
    variances = max(predicted_2 - predicted**2, 0.0), max(true_2 - true**2, 0.0)
    covariance = product - predicted * true
    spread, inverse_spread = (
        np.sqrt(max(variances[0] + variances[1] + sign * 2 * covariance, 0.0)) for sign in (-1, 1)
    )
    scale = np.sqrt(variances[0] * variances[1])
    correlation = covariance / scale if scale > _CONSTANT else 0.0
    return predicted - true, spread, correlation, inverse_spread
