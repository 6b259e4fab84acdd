"""Predictions of the tasks."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import Rows, selected_rows
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.lidar_turn import LidarTurn
from sightline.structures.objects import Objects

if TYPE_CHECKING:
    from sightline.structures.sample import CameraLidarSample

JsonValue = dict[str, Any] | list[Any] | str | float | int | None
"""Content of JSON: numbers are finite."""

_PX: Final = 2
_M: Final = 3
_RAD: Final = 4
_SCORE: Final = 4
_SHARE: Final = 4
"""Decimals in JSON, by unit."""


def _surer_than(detections: Any, min_score: float) -> Any:  # noqa: ANN401 - any of the classes
    """Deprecated name of `filter_by_score`."""
    warn_user("surer_than is now filter_by_score", DeprecationWarning)
    return detections.filter_by_score(min_score)


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class DepthMap:
    """Dense depth map with a validity mask.

    Examples:
        >>> import torch
        >>> from sightline import DepthMap
        >>> depth_m = torch.tensor([[0.0, 12.5], [8.0, 8.25]])
        >>> dense = DepthMap(depth_m=depth_m, valid=depth_m > 0)
        >>> float(dense.depth_m[dense.valid].min()), dense.uncertainty_m
        (8.0, None)
    """

    depth_m: Float32[Tensor, "height width"]
    """Metres along the camera's optical axis; 0 = no value."""
    valid: Bool[Tensor, "height width"]
    """Mask of the trusted values; other values are guesses."""
    uncertainty_m: Float32[Tensor, "height width"] | None = None
    """Expected absolute error, infinite where there is no value; None if the method has no
    estimate."""
    guessed: Bool[Tensor, "height width"] | None = None
    """Mask of the values that come from the image, as the LiDAR saw nothing there; they are not
    trusted. None: no value."""

    @property
    def shown_m(self) -> Float32[Tensor, "height width"]:
        """Trusted values and guesses from the image, for pictures; 0 elsewhere."""
        is_shown = self.valid if self.guessed is None else self.valid | self.guessed
        return self.depth_m.where(is_shown, 0.0)

    def to_json(self) -> dict[str, float | None]:
        """Summarize the trusted values; None: there are none, or there is no estimate.

        The share of guesses stands beside; they are in no other number.
        """
        trusted = self.depth_m[self.valid]
        summary: dict[str, float | None] = {
            "valid_share": round(float(self.valid.float().mean()), _SHARE),
            "guessed_share": (
                0.0 if self.guessed is None else round(float(self.guessed.float().mean()), _SHARE)
            ),
            "nearest_m": None,
            "median_m": None,
            "farthest_m": None,
            "median_expected_error_m": None,
        }
        if len(trusted):
            summary["nearest_m"] = round(float(trusted.min()), _M)
            summary["median_m"] = round(float(trusted.median()), _M)
            summary["farthest_m"] = round(float(trusted.max()), _M)
        if len(trusted) and self.uncertainty_m is not None:
            error_m = float(self.uncertainty_m[self.valid].median())
            summary["median_expected_error_m"] = round(error_m, _M)
        return summary


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class Detections2D:
    """2D detections in one image.

    Examples:
        >>> import torch
        >>> from sightline import Boxes2D, Detections2D
        >>> found = Detections2D(
        ...     class_names=("Car", "Pedestrian"),
        ...     boxes=Boxes2D(torch.tensor([[10.0, 20.0, 60.0, 50.0], [80.0, 15.0, 90.0, 45.0]])),
        ...     scores=torch.tensor([0.9, 0.4]),
        ... )
        >>> [name for name, score in zip(found.class_names, found.scores) if score > 0.5]
        ['Car']
    """

    class_names: tuple[str, ...]
    boxes: Boxes2D
    scores: Float[Tensor, " num_detections"]
    """Confidence; higher is more certain."""

    def __post_init__(self) -> None:
        """Check that the columns have equal lengths."""
        _check_lengths(self.class_names, self.boxes, self.scores)

    def select(self, kept: Rows) -> "Detections2D":
        """Select detections by indices, in their order, or by a mask."""
        kept = selected_rows(kept, len(self.scores))
        return Detections2D(
            class_names=tuple(self.class_names[index] for index in kept.tolist()),
            boxes=self.boxes[kept],
            scores=self.scores[kept],
        )

    def filter_by_score(self, min_score: float) -> "Detections2D":
        """Select detections with a score of at least `min_score`, in their order.

        Warns of a threshold above 1 for scores from 0 to 1.

        Raises:
            ValueError: The threshold is NaN.
        """
        _check_threshold(min_score, self.scores)
        return self.select((self.scores >= min_score).nonzero()[:, 0])

    surer_than = _surer_than

    def to_json(self) -> list[dict[str, Any]]:
        """List the detections: class, score, corners of the box [px]."""
        columns = zip(
            self.class_names, self.scores.tolist(), self.boxes.tensor.tolist(), strict=True
        )
        return [
            {"class": name, "score": round(score, _SCORE), "box_px": [round(x, _PX) for x in box]}
            for name, score, box in columns
        ]


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class Detections3D:
    """3D detections in one sweep.

    Examples:
        >>> import torch
        >>> from sightline import Boxes3D, Detections3D
        >>> box = Boxes3D(torch.tensor([[12.0, -2.0, -0.9, 4.2, 1.8, 1.5, 0.0]]))
        >>> found = Detections3D(class_names=("Car",), boxes=box, scores=torch.tensor([0.8]))
        >>> found.boxes.centers.tolist()
        [[12.0, -2.0, -0.8999999761581421]]
    """

    class_names: tuple[str, ...]
    boxes: Boxes3D
    """Boxes in the LiDAR frame."""
    scores: Float[Tensor, " num_detections"]
    """Confidence; higher is more certain."""

    def __post_init__(self) -> None:
        """Check that the columns have equal lengths."""
        _check_lengths(self.class_names, self.boxes, self.scores)

    def select(self, kept: Rows) -> "Detections3D":
        """Select detections by indices, in their order, or by a mask."""
        kept = selected_rows(kept, len(self.scores))
        return Detections3D(
            class_names=tuple(self.class_names[index] for index in kept.tolist()),
            boxes=self.boxes[kept],
            scores=self.scores[kept],
        )

    def filter_by_score(self, min_score: float) -> "Detections3D":
        """Select detections with a score of at least `min_score`, in their order.

        Warns of a threshold above 1 for scores from 0 to 1.

        Raises:
            ValueError: The threshold is NaN.
        """
        _check_threshold(min_score, self.scores)
        return self.select((self.scores >= min_score).nonzero()[:, 0])

    surer_than = _surer_than

    def to_json(self) -> list[dict[str, Any]]:
        """List the detections: class, score, center and size [m] and yaw [rad] of the box."""
        columns = zip(
            self.class_names, self.scores.tolist(), self.boxes.tensor.tolist(), strict=True
        )
        return [
            {
                "class": name,
                "score": round(score, _SCORE),
                "center_m": [round(x, _M) for x in box[:3]],
                "size_m": [round(x, _M) for x in box[3:6]],
                "yaw_rad": round(box[6], _RAD),
            }
            for name, score, box in columns
        ]


class FurtherPrediction(ABC):
    """Prediction of a kind of its own: the base class for tasks beyond boxes and depth.

    docs/adding.md shows how a task uses it.
    """

    __slots__ = ()
    title: ClassVar[str]
    """Title of its panel in pictures."""

    @abstractmethod
    def to_json(self) -> JsonValue:
        """Summarize it for the line of its frame."""

    @abstractmethod
    def draw(self, sample: "CameraLidarSample") -> UInt8[np.ndarray, "height width 3"]:
        """Draw it as an RGB picture, which panels scale to their size."""

    def filter_by_score(self, min_score: float) -> "FurtherPrediction":
        """Remove entries with scores below `min_score`, for pictures; by default there are none."""
        del min_score
        return self


@dataclass(frozen=True, kw_only=True, slots=True)
class Perception:
    """Predictions of all tasks for one frame; None: no task has predicted it.

    Examples:
        >>> from sightline import Perception
        >>> nothing = Perception()
        >>> nothing.detections3d is None, nothing.depth is None
        (True, True)
    """

    objects: Objects | None = None
    """Objects joined from the detections of all sensors."""
    detections2d: Detections2D | None = None
    """Detections in pixels of the frame's image."""
    detections3d: Detections3D | None = None
    depth: DepthMap | None = None
    """Depth map of the frame's image size."""
    further: Mapping[str, FurtherPrediction] = field(default_factory=dict)
    """Predictions of other kinds, by the key that their task declares (`Output.further`)."""
    undone_turn: LidarTurn | None = None
    """Rotation of the LiDAR by which the calibration was corrected before; None: not corrected."""

    @classmethod
    @named_arguments
    def joined(cls, parts: "Iterable[Perception]") -> "Perception":
        """Join several perceptions; the first one with a prediction wins."""
        joined = cls()
        for part in parts:
            joined = cls(
                objects=part.objects if joined.objects is None else joined.objects,
                detections2d=joined.detections2d or part.detections2d,
                detections3d=joined.detections3d or part.detections3d,
                depth=joined.depth or part.depth,
                further={**part.further, **joined.further},
                undone_turn=joined.undone_turn or part.undone_turn,
            )
        return joined

    def filter_by_score(self, min_score: float) -> "Perception":
        """Remove detections with scores below `min_score`."""
        return replace(
            self,
            objects=None if self.objects is None else self.objects.filter_by_score(min_score),
            detections2d=self.detections2d and self.detections2d.filter_by_score(min_score),
            detections3d=self.detections3d and self.detections3d.filter_by_score(min_score),
            further={key: each.filter_by_score(min_score) for key, each in self.further.items()},
        )

    surer_than = _surer_than

    def to_json(self) -> dict[str, JsonValue]:
        """Convert to JSON, by name; None: no task has predicted it."""
        return {
            "objects": None if self.objects is None else self.objects.to_json(),
            "detections2d": None if self.detections2d is None else self.detections2d.to_json(),
            "detections3d": None if self.detections3d is None else self.detections3d.to_json(),
            "depth": None if self.depth is None else self.depth.to_json(),
            **{key: each.to_json() for key, each in self.further.items()},
            **({"undone_turn": self.undone_turn.to_json()} if self.undone_turn else {}),
        }


def _check_threshold(min_score: float, scores: Float[Tensor, " num_detections"]) -> None:
    """Refuse NaN, and warn of probable percent; detectors of others may have any scores."""
    if math.isnan(min_score):
        raise ValueError("min_score must be a number, got nan; give a share such as 0.3")
    if min_score > 1 and len(scores) and bool(((scores >= 0) & (scores <= 1)).all()):
        warn_user(
            f"min_score is {min_score:g}, but the scores are from 0 to 1: no detection is left; "
            "give a share such as 0.3",
        )


def _check_lengths(class_names: tuple[str, ...], boxes: Boxes2D | Boxes3D, scores: Tensor) -> None:
    if not len(class_names) == len(boxes) == len(scores):
        raise ValueError(
            f"detections need one class, box and score each, got {len(class_names)} classes, "
            f"{len(boxes)} boxes and {len(scores)} scores"
        )
