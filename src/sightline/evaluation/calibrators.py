"""Calibrators of a detector's scores, fitted on detections with known outcomes.

No calibrator reverses the order of two scores. Average precision is unchanged unless scores become
equal: isotonic ones make them equal in steps, the others if the scores carry no information.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64
from scipy.optimize import isotonic_regression, minimize
from scipy.special import expit, logit

from sightline.geometry.wrong_types import named_arguments

CalibratorName = Literal["temperature", "platt", "isotonic"]
CALIBRATORS: tuple[CalibratorName, ...] = ("temperature", "platt", "isotonic")

_MIN_SCORE = 1e-6  # logits of 0 and 1 are kept finite
_TOLERANCE = 1e-10


@dataclass(frozen=True, kw_only=True, slots=True)
class LogisticCalibrator:
    """sigmoid(slope * logit(score) + intercept): temperature scaling if the intercept is 0."""

    slope: float
    """Slope, not negative; 1 over the temperature."""
    intercept: float

    def __call__(
        self, scores: Float64[np.ndarray, " num_scores"]
    ) -> Float64[np.ndarray, " num_scores"]:
        """Calibrate scores."""
        calibrated: Float64[np.ndarray, " num_scores"]
        calibrated = expit(self.slope * _logits(scores) + self.intercept)
        return calibrated

    def to_json(self) -> dict[str, Any]:
        """Convert the parameters to JSON types."""
        return {"slope": self.slope, "intercept": self.intercept}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class IsotonicCalibrator:
    """Piecewise linear function between knots, constant beyond the ends."""

    scores: Float64[np.ndarray, " num_knots"]
    """Scores of the knots, ascending."""
    values: Float64[np.ndarray, " num_knots"]
    """Calibrated values, not descending."""

    def __call__(
        self, scores: Float64[np.ndarray, " num_scores"]
    ) -> Float64[np.ndarray, " num_scores"]:
        """Calibrate scores."""
        calibrated: Float64[np.ndarray, " num_scores"]
        calibrated = np.interp(scores, self.scores, self.values)
        return calibrated

    def to_json(self) -> dict[str, Any]:
        """Convert the knots to JSON types."""
        return {"scores": self.scores.tolist(), "values": self.values.tolist()}


Calibrator = LogisticCalibrator | IsotonicCalibrator


@named_arguments
def fit_calibrator(
    name: CalibratorName,
    scores: Float64[np.ndarray, " num_detections"],
    targets: Float64[np.ndarray, " num_detections"],
) -> Calibrator:
    """Fit a calibrator.

    temperature: Guo et al. 2017, "On calibration of modern neural networks". platt: Platt 1999,
    "Probabilistic outputs for support vector machines", his targets of section 2.2 included, for
    both; here on the logit of the score, with a slope that is not negative, and the targets may
    lie between 0 and 1. isotonic: Zadrozny and Elkan 2002, by least squares.

    Args:
        name: Name of the calibrator.
        scores: In [0, 1], at least one.
        targets: In [0, 1]: 1 for a true detection, or its overlap, and 0 for a false one.

    Raises:
        ValueError: There is no such calibrator, or no detection to fit on.
    """
    if not len(scores):
        raise ValueError("there is no detection that counts to fit a calibrator on")
    if name == "isotonic":
        return _fit_isotonic(scores, targets)
    return _fit_logistic(scores, targets, with_intercept=name == "platt")


def logistic_loss(
    calibrated_logits: Float64[np.ndarray, " num_detections"],
    targets: Float64[np.ndarray, " num_detections"],
) -> float:
    """Compute the mean cross entropy of logits against Platt's softened targets."""
    soft = _softened(targets)
    return float(np.mean(np.logaddexp(0, calibrated_logits) - soft * calibrated_logits))


def _fit_logistic(
    scores: Float64[np.ndarray, " num_detections"],
    targets: Float64[np.ndarray, " num_detections"],
    *,
    with_intercept: bool,
) -> LogisticCalibrator:
    x, soft = _logits(scores), _softened(targets)

    def loss_and_gradient(
        parameters: Float64[np.ndarray, "2"],
    ) -> tuple[float, Float64[np.ndarray, "2"]]:
        z = parameters[0] * x + parameters[1]
        residual = expit(z) - soft
        gradient = np.array([np.mean(residual * x), np.mean(residual)])
        return logistic_loss(z, targets), gradient

    free = (None, None) if with_intercept else (0.0, 0.0)
    fit = minimize(
        loss_and_gradient,
        np.array([1.0, 0.0]),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0.0, None), free],
        options={"ftol": _TOLERANCE, "gtol": _TOLERANCE, "maxiter": 1000},
    )
    return LogisticCalibrator(slope=float(fit.x[0]), intercept=float(fit.x[1]))


def _fit_isotonic(
    scores: Float64[np.ndarray, " num_detections"],
    targets: Float64[np.ndarray, " num_detections"],
) -> IsotonicCalibrator:
    knots, place, counts = np.unique(scores, return_inverse=True, return_counts=True)
    means = np.bincount(place, weights=targets) / counts
    values = np.asarray(isotonic_regression(means, weights=counts).x, dtype=np.float64)
    # the two ends of a run of equal values define it
    inner = np.zeros(len(knots), dtype=np.bool_)
    inner[1:-1] = (values[1:-1] == values[:-2]) & (values[1:-1] == values[2:])
    return IsotonicCalibrator(scores=knots[~inner], values=np.clip(values[~inner], 0, 1))


def _logits(
    scores: Float64[np.ndarray, " num_scores"],
) -> Float64[np.ndarray, " num_scores"]:
    logits: Float64[np.ndarray, " num_scores"]
    logits = logit(np.clip(scores, _MIN_SCORE, 1 - _MIN_SCORE))
    return logits


def _softened(
    targets: Float64[np.ndarray, " num_detections"],
) -> Float64[np.ndarray, " num_detections"]:
    """Soften targets, Platt 1999, section 2.2: a prior of one detection of each kind."""
    num_true = float(targets.sum())
    high = (num_true + 1) / (num_true + 2)
    low = 1 / (len(targets) - num_true + 2)
    return low + (high - low) * targets
