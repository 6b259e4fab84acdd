"""Logistic models that turn evidence into scores, maps that calibrate these, and their file."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from sightline.files.atomic import atomic_write_text
from sightline.files.plain_file import read_bytes
from sightline.files.problem import FileError
from sightline.files.weights_header import WEIGHTS_FOLDER
from sightline.joining.evidence import ALONE_COLUMNS, IMAGE_COLUMNS, SWEEP_COLUMNS
from sightline.joining.lifting import LIFTED_COLUMNS

JOINED: Final = "joined"
"""Name of the joined predictor; see `sightline.load`."""
SHIPPED: Final = WEIGHTS_FOLDER / "joined.json"
"""Models for the default weights, fitted on simulated frames, which the file describes."""
CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""Classes of the models."""
COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "sweep": SWEEP_COLUMNS,
    "image": IMAGE_COLUMNS,
    "alone": ALONE_COLUMNS,
    "lifted": LIFTED_COLUMNS,
}
"""Evidence of each model, by the kind of box."""

CALIBRATED: Final = ("image", "alone", "image_3d", "alone_3d")
"""Calibrated scores: of objects beside a sweep and without a LiDAR, and of their 3D boxes."""

_LEAST: Final = 1e-9  # of a score's distance to 0 and 1, so that its logarithms are finite
_LARGEST: Final = 1e6  # number of a model
_MAX_BYTES: Final = 2**20
_REMEDY: Final = "name a file from `sightline fit-joined` or adapt"


@dataclass(frozen=True, kw_only=True, slots=True)
class LogisticModel:
    """Logistic regression: the logit of a score is linear in the evidence."""

    weights: tuple[float, ...]
    """Weight of each column of the evidence."""
    bias: float

    def score(
        self, evidence: Float64[np.ndarray, "num_boxes columns"]
    ) -> Float64[np.ndarray, " num_boxes"]:
        """Compute scores in [0, 1]."""
        logits = evidence @ np.array(self.weights) + self.bias
        return np.asarray(1 / (1 + np.exp(-np.clip(logits, -50, 50))))


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoreMap:
    """Calibration of scores that keeps their order: Kull et al. 2017 (beta calibration), eq. 5.

    The logit of the calibrated score is low * log(s) - high * log(1 - s) + bias.

    Raises:
        ValueError: A number is not finite, or a slope not positive, so the order would change.
    """

    low: float = 1.0
    """Slope near 0."""
    high: float = 1.0
    """Slope near 1."""
    bias: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers."""
        is_finite = all(map(math.isfinite, (self.low, self.high, self.bias)))
        if not (is_finite and self.low > 0 and self.high > 0):
            raise ValueError(
                f"a calibration must have finite numbers and positive slopes, got {self}"
            )

    def __call__(
        self, scores: Float64[np.ndarray, " num_scores"]
    ) -> Float64[np.ndarray, " num_scores"]:
        """Calibrate scores in [0, 1]."""
        limited = np.clip(scores, _LEAST, 1 - _LEAST)
        logits = self.low * np.log(limited) - self.high * np.log1p(-limited) + self.bias
        return np.asarray(1 / (1 + np.exp(-np.clip(logits, -50, 50))))


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinModels:
    """Models of each class and kind of box."""

    sweep: Mapping[str, LogisticModel]
    """Boxes of the sweep detector."""
    image: Mapping[str, LogisticModel]
    """Boxes of the image detector beside a sweep."""
    alone: Mapping[str, LogisticModel]
    """Boxes of the image detector without a LiDAR."""
    lifted: Mapping[str, LogisticModel]
    """3D boxes lifted from the image."""
    calibrators: Mapping[str, Mapping[str, ScoreMap]]
    """Calibration of the final scores, by `CALIBRATED` and class."""
    provenance: Mapping[str, Any]
    """Origin of the models: weights of both detectors with their SHA-256, frames, seed."""

    @property
    def identity(self) -> dict[str, Any]:
        """Origin of the models, and a checksum of their numbers."""
        numbers = json.dumps(self._plain(), sort_keys=True)
        return {**self.provenance, "numbers_sha256": hashlib.sha256(numbers.encode()).hexdigest()}

    def fits(self, sha256_2d: str, sha256_3d: str) -> bool:
        """Whether the models were fitted with these weights of the two detectors."""
        digests: object = self.provenance.get("sha256")
        return isinstance(digests, dict) and digests == {
            "detection2d": sha256_2d,
            "detection3d": sha256_3d,
        }

    def check_fit(self, weights_2d: tuple[str, str], weights_3d: tuple[str, str]) -> None:
        """Check that the models were fitted with the weights of the two detectors.

        Args:
            weights_2d: Name and SHA-256 of the image detector's weights.
            weights_3d: Name and SHA-256 of the sweep detector's weights.

        Raises:
            ValueError: They were fitted with others.
        """
        (name_2d, sha256_2d), (name_3d, sha256_3d) = weights_2d, weights_3d
        if not self.fits(sha256_2d, sha256_3d):
            raise ValueError(
                f"the models of joined scores were not fitted for {name_2d} and {name_3d}; give "
                "the weights that their file names, or fit models by `sightline fit-joined`"
            )

    def write(self, path: Path) -> None:
        """Write the models as JSON, atomically."""
        content = {"provenance": dict(self.provenance), "columns": COLUMNS, **self._plain()}
        atomic_write_text(path, json.dumps(content, indent=1) + "\n")

    def _plain(self) -> dict[str, Any]:
        """Convert the numbers to JSON."""
        models = {
            kind: {name: asdict(each) for name, each in getattr(self, kind).items()}
            for kind in COLUMNS
        }
        calibrators = {
            kind: {name: asdict(each) for name, each in maps.items()}
            for kind, maps in self.calibrators.items()
        }
        return {**models, "calibrators": calibrators}


def read_models(path: Path = SHIPPED) -> JoinModels:
    """Read the models of a file, by default the included ones.

    Raises:
        FileError: The file cannot be read, or holds other models.
    """
    data = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    try:
        content = json.loads(data)
        if content["columns"] != {kind: list(columns) for kind, columns in COLUMNS.items()}:
            raise ValueError("other columns")
        kinds = {
            kind: {name: _model(content[kind][name], len(columns)) for name in CLASSES}
            for kind, columns in COLUMNS.items()
        }
        calibrators = {
            kind: {name: _score_map(content["calibrators"][kind][name]) for name in CLASSES}
            for kind in CALIBRATED
        }
        return JoinModels(**kinds, calibrators=calibrators, provenance=dict(content["provenance"]))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(
            path,
            "holds no models of this version, expected weights and bias of each kind and class",
            _REMEDY,
        ) from error


@cache
def fitted_models(sha256_2d: str, sha256_3d: str) -> JoinModels | None:
    """Read the included models that were fitted with these weights of the two detectors, if any.

    Raises:
        FileError: A file of models cannot be read.
    """
    every = map(read_models, sorted(WEIGHTS_FOLDER.glob(f"{JOINED}*.json")))
    return next((models for models in every if models.fits(sha256_2d, sha256_3d)), None)


def _model(plain: Mapping[str, Any], num_columns: int) -> LogisticModel:
    weights = tuple(map(_number, plain["weights"]))
    if len(weights) != num_columns:
        raise ValueError("other columns")
    return LogisticModel(weights=weights, bias=_number(plain["bias"]))


def _score_map(plain: Mapping[str, Any]) -> ScoreMap:
    return ScoreMap(
        low=_number(plain["low"]), high=_number(plain["high"]), bias=_number(plain["bias"])
    )


def _number(value: object) -> float:
    """Check a number of a model: finite, and small enough for sums of products."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < _LARGEST:
        raise ValueError("no number of a model")
    return float(value)


def identity_maps() -> dict[str, dict[str, ScoreMap]]:
    """Make calibrators that leave all scores nearly as they are."""
    return {kind: {name: ScoreMap() for name in CLASSES} for kind in CALIBRATED}
