"""Objects of a frame, each once, joined from the detections of all sensors."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import Rows, selected_rows
from sightline.geometry.ranges import check_range

Origin = Literal["measured", "refined", "lifted", "none"]
"""Source of a 3D box: the sweep's detector, an image box refined by the sweep, an image box and the
road, or no box."""

_PX: Final = 2
_M: Final = 3
_RAD: Final = 4
_SCORE: Final = 4
"""Decimals in JSON, by unit."""


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class Objects:
    """Objects of one frame, by descending score: one entry for each road user.

    Examples:
        >>> import torch
        >>> from sightline import Boxes2D, Boxes3D, Objects
        >>> found = Objects(
        ...     class_names=("Car",),
        ...     boxes2d=Boxes2D(torch.tensor([[10.0, 20.0, 60.0, 50.0]], dtype=torch.float64)),
        ...     boxes3d=Boxes3D(torch.zeros(1, 7, dtype=torch.float64)),
        ...     origins=("none",),
        ...     scores=torch.tensor([0.9], dtype=torch.float64),
        ...     scores3d=torch.tensor([0.0], dtype=torch.float64),
        ...     image_support=torch.tensor([0.8], dtype=torch.float64),
        ...     lidar_support=torch.tensor([0.0], dtype=torch.float64),
        ...     num_points=torch.tensor([3]),
        ... )
        >>> found.has_box3d.tolist(), found.to_json()[0]["box_3d"]
        ([False], None)

    Raises:
        ValueError: Columns differ in length, or an origin is unknown.
    """

    class_names: tuple[str, ...]
    boxes2d: Boxes2D
    """Boxes in the image [px]; NaN for an object outside the image."""
    boxes3d: Boxes3D
    """Boxes in the LiDAR frame; zeros for objects without one."""
    origins: tuple[str, ...]
    """Source of each 3D box: measured, refined, lifted or none."""
    scores: Float64[Tensor, " num_objects"]
    """Probability that the object exists and its image box fits, in [0, 1]."""
    scores3d: Float64[Tensor, " num_objects"]
    """Probability that the object exists and its 3D box fits, in [0, 1]; 0 without a 3D box."""
    image_support: Float64[Tensor, " num_objects"]
    """Score of the image detector's own box; 0: it has none for the object."""
    lidar_support: Float64[Tensor, " num_objects"]
    """Score of the sweep detector's own box; 0: it has none for the object."""
    num_points: Int64[Tensor, " num_objects"]
    """Number of LiDAR returns in the 3D box, with a margin of 5 cm, or else in the image box."""

    def __post_init__(self) -> None:
        """Check lengths and origins."""
        lengths = {name: len(getattr(self, name)) for name in self.__dataclass_fields__}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"objects of one frame need columns of one length, got {lengths}")
        unknown = set(self.origins) - set(get_args(Origin))
        if unknown:
            raise ValueError(
                f"origins may be {', '.join(get_args(Origin))}, got {', '.join(sorted(unknown))}"
            )

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.class_names)

    @property
    def has_box2d(self) -> Bool[Tensor, " num_objects"]:
        """Mask of the objects inside the image."""
        return ~self.boxes2d.tensor.isnan().any(dim=1)

    @property
    def has_box3d(self) -> Bool[Tensor, " num_objects"]:
        """Mask of the objects with a 3D box."""
        return (self.boxes3d.sizes > 0).all(dim=1)

    def select(self, kept: Rows) -> "Objects":
        """Select objects by indices, in their order, or by a mask."""
        kept = selected_rows(kept, len(self))
        indices = kept.tolist()
        return Objects(
            class_names=tuple(self.class_names[index] for index in indices),
            boxes2d=self.boxes2d[kept],
            boxes3d=self.boxes3d[kept],
            origins=tuple(self.origins[index] for index in indices),
            scores=self.scores[kept],
            scores3d=self.scores3d[kept],
            image_support=self.image_support[kept],
            lidar_support=self.lidar_support[kept],
            num_points=self.num_points[kept],
        )

    def filter_by_score(self, min_score: float) -> "Objects":
        """Select objects with a score of at least `min_score`, in their order.

        Raises:
            ValueError: The threshold is not from 0 to 1, as the scores are.
        """
        check_range("min_score", min_score, 0, 1)
        return self.select((self.scores >= min_score).nonzero()[:, 0])

    def to_json(self) -> list[dict[str, Any]]:
        """List the objects, with null for a missing box.

        Each has its class, score, image box [px], 3D box with center, size [m], yaw [rad], score
        and origin, and its support: scores of both detectors and the number of returns.
        """
        has_box2d, has_box3d = self.has_box2d.tolist(), self.has_box3d.tolist()
        return [
            {
                "class": name,
                "score": round(float(self.scores[index]), _SCORE),
                "box_px": _rounded(self.boxes2d.tensor[index], _PX) if has_box2d[index] else None,
                "box_3d": self._box3d_json(index) if has_box3d[index] else None,
                "support": {
                    "image": round(float(self.image_support[index]), _SCORE),
                    "lidar": round(float(self.lidar_support[index]), _SCORE),
                    "points": int(self.num_points[index]),
                },
            }
            for index, name in enumerate(self.class_names)
        ]

    @classmethod
    def from_json(cls, rows: Sequence[Mapping[str, Any]]) -> "Objects":
        """Convert the list of `to_json` back; numbers stay rounded."""

        def column(values: Iterable[float]) -> Float64[Tensor, " num_objects"]:
            return torch.tensor(list(values), dtype=torch.float64)

        boxes = [_box3d_row(row["box_3d"]) for row in rows]
        seen = [row["box_px"] or [math.nan] * 4 for row in rows]
        return cls(
            class_names=tuple(row["class"] for row in rows),
            boxes2d=Boxes2D(torch.tensor(seen, dtype=torch.float64).reshape(-1, 4)),
            boxes3d=Boxes3D(torch.tensor(boxes, dtype=torch.float64).reshape(-1, 7)),
            origins=tuple(row["box_3d"]["origin"] if row["box_3d"] else "none" for row in rows),
            scores=column(row["score"] for row in rows),
            scores3d=column(row["box_3d"]["score"] if row["box_3d"] else 0.0 for row in rows),
            image_support=column(row["support"]["image"] for row in rows),
            lidar_support=column(row["support"]["lidar"] for row in rows),
            num_points=torch.tensor([row["support"]["points"] for row in rows]).long(),
        )

    def _box3d_json(self, index: int) -> dict[str, Any]:
        box = self.boxes3d.tensor[index]
        return {
            "center_m": _rounded(box[:3], _M),
            "size_m": _rounded(box[3:6], _M),
            "yaw_rad": round(float(box[6]), _RAD),
            "score": round(float(self.scores3d[index]), _SCORE),
            "origin": self.origins[index],
        }


def _box3d_row(box: Mapping[str, Any] | None) -> list[float]:
    """Columns of `Boxes3D`; zeros without a box."""
    if box is None:
        return [0.0] * 7
    return [*box["center_m"], *box["size_m"], box["yaw_rad"]]


def _rounded(values: Tensor, digits: int) -> list[float]:
    return [round(each, digits) for each in values.tolist()]
