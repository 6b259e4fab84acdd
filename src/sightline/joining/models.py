"""Logistic models that turn evidence into scores, and their file."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
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
"""Models fitted on simulated frames, which the file describes."""
CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""Classes of the models."""
COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {
    "sweep": SWEEP_COLUMNS,
    "image": IMAGE_COLUMNS,
    "alone": ALONE_COLUMNS,
    "lifted": LIFTED_COLUMNS,
}
"""Evidence of each model, by the kind of box."""

_MAX_BYTES: Final = 2**20
_REMEDY: Final = "fit the models again by `python -m benchmarks.fit_joined`"


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
    provenance: Mapping[str, Any]
    """Origin of the models: weights of both detectors with their SHA-256, frames, seed."""

    def fits(self, sha256_2d: str, sha256_3d: str) -> bool:
        """Whether the models were fitted with these weights of the two detectors."""
        digests: object = self.provenance.get("sha256")
        return isinstance(digests, dict) and digests == {
            "detection2d": sha256_2d,
            "detection3d": sha256_3d,
        }

    def write(self, path: Path) -> None:
        """Write the models as JSON, atomically."""
        models = {
            kind: {name: asdict(each) for name, each in getattr(self, kind).items()}
            for kind in COLUMNS
        }
        content = {"provenance": dict(self.provenance), "columns": COLUMNS, **models}
        atomic_write_text(path, json.dumps(content, indent=1) + "\n")


def read_models(path: Path = SHIPPED) -> JoinModels:
    """Read the models of a file, by default the included ones.

    Raises:
        FileError: The file cannot be read, or holds other models.
    """
    data = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    try:
        content = json.loads(data)
        kinds = {
            kind: {name: _model(content[kind][name], len(columns)) for name in CLASSES}
            for kind, columns in COLUMNS.items()
        }
        return JoinModels(**kinds, provenance=dict(content["provenance"]))
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(
            path,
            "holds no models of this version, expected weights and bias of each kind and class",
            _REMEDY,
        ) from error


def _model(plain: Mapping[str, Any], num_columns: int) -> LogisticModel:
    model = LogisticModel(
        weights=tuple(float(each) for each in plain["weights"]), bias=float(plain["bias"])
    )
    numbers = (*model.weights, model.bias)
    if len(numbers) != num_columns + 1 or not all(map(math.isfinite, numbers)):
        raise ValueError("other columns")
    return model
