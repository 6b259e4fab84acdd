"""Predictions of the tasks."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from jaxtyping import Bool, Float, Float32, Int64
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.checked import checked
from sightline.geometry.wrong_types import named_arguments


def _surer_than(detections: Any, min_score: float) -> Any:  # noqa: ANN401 - any of the classes
    """Deprecated name of `filter_by_score`."""
    warnings.warn("surer_than is now filter_by_score", DeprecationWarning, stacklevel=2)
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
        """Checks that the columns have equal lengths."""
        _check_lengths(self.class_names, self.boxes, self.scores)

    def select(self, kept: Int64[Tensor, " num_kept"]) -> "Detections2D":
        """Selects detections by indices, in their order."""
        return Detections2D(
            class_names=tuple(self.class_names[index] for index in kept.tolist()),
            boxes=self.boxes[kept],
            scores=self.scores[kept],
        )

    def filter_by_score(self, min_score: float) -> "Detections2D":
        """Selects detections with a score of at least `min_score`, in their order."""
        return self.select((self.scores >= min_score).nonzero()[:, 0])

    surer_than = _surer_than


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
        """Checks that the columns have equal lengths."""
        _check_lengths(self.class_names, self.boxes, self.scores)

    def select(self, kept: Int64[Tensor, " num_kept"]) -> "Detections3D":
        """Selects detections by indices, in their order."""
        return Detections3D(
            class_names=tuple(self.class_names[index] for index in kept.tolist()),
            boxes=self.boxes[kept],
            scores=self.scores[kept],
        )

    def filter_by_score(self, min_score: float) -> "Detections3D":
        """Selects detections with a score of at least `min_score`, in their order."""
        return self.select((self.scores >= min_score).nonzero()[:, 0])

    surer_than = _surer_than


@dataclass(frozen=True, kw_only=True, slots=True)
class Perception:
    """Predictions of all tasks for one frame; None: no task has predicted it.

    Examples:
        >>> from sightline import Perception
        >>> nothing = Perception()
        >>> nothing.detections3d is None, nothing.depth is None
        (True, True)
    """

    detections2d: Detections2D | None = None
    """Detections in pixels of the frame's image."""
    detections3d: Detections3D | None = None
    depth: DepthMap | None = None
    """Depth map of the frame's image size."""

    @classmethod
    @named_arguments
    def joined(cls, parts: "Iterable[Perception]") -> "Perception":
        """Joins several perceptions; the first one with a prediction wins."""
        joined = cls()
        for part in parts:
            joined = cls(
                detections2d=joined.detections2d or part.detections2d,
                detections3d=joined.detections3d or part.detections3d,
                depth=joined.depth or part.depth,
            )
        return joined

    def filter_by_score(self, min_score: float) -> "Perception":
        """Removes detections with scores below `min_score`."""
        return replace(
            self,
            detections2d=self.detections2d and self.detections2d.filter_by_score(min_score),
            detections3d=self.detections3d and self.detections3d.filter_by_score(min_score),
        )

    surer_than = _surer_than


def _check_lengths(class_names: tuple[str, ...], boxes: Boxes2D | Boxes3D, scores: Tensor) -> None:
    if not len(class_names) == len(boxes) == len(scores):
        raise ValueError(
            f"detections need one class, box and score each, got {len(class_names)} classes, "
            f"{len(boxes)} boxes and {len(scores)} scores"
        )
