"""What the tasks answer."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Bool, Float, Float32, jaxtyped
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class DepthMap:
    """A dense depth map and where it may be believed."""

    depth_m: Float32[Tensor, "height width"]
    """Metres along the camera's optical axis; 0 = no value."""
    valid: Bool[Tensor, "height width"]
    """Where the method stands by its value; a value elsewhere is a guess."""
    uncertainty_m: Float32[Tensor, "height width"] | None = None
    """Expected absolute error, infinite where there is no value; None where the method has no
    estimate of it."""


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class Detections2D:
    """Objects found in one image."""

    class_names: tuple[str, ...]
    boxes: Boxes2D
    scores: Float[Tensor, " num_detections"]
    """Confidence; higher is surer."""

    def __post_init__(self) -> None:
        """Checks that the columns belong together."""
        _check_lengths(self.class_names, self.boxes, self.scores)


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class Detections3D:
    """Objects found in one sweep."""

    class_names: tuple[str, ...]
    boxes: Boxes3D
    """LiDAR frame."""
    scores: Float[Tensor, " num_detections"]
    """Confidence; higher is surer."""

    def __post_init__(self) -> None:
        """Checks that the columns belong together."""
        _check_lengths(self.class_names, self.boxes, self.scores)


def _check_lengths(class_names: tuple[str, ...], boxes: Boxes2D | Boxes3D, scores: Tensor) -> None:
    if not len(class_names) == len(boxes) == len(scores):
        raise ValueError(
            f"detections need one class, box and score each, got {len(class_names)} classes, "
            f"{len(boxes)} boxes and {len(scores)} scores"
        )
