"""Boxes of the classes that KITTI scores, for checks of results."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from sightline.data.kitti_labels import NO_LOCATION, KittiObjects

_SCORED: Final = ("Car", "Pedestrian", "Cyclist")  # they stand on the road


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ScoredBoxes:
    """Boxes of the scored classes of one frame or of all."""

    names: Shaped[np.ndarray, " num_boxes"]
    """Class names, capitalised."""
    scores: Float64[np.ndarray, " num_boxes"]
    """Zeros of labels."""
    boxes2d: Float64[np.ndarray, "num_boxes 4"]
    sizes_hwl: Float64[np.ndarray, "num_boxes 3"]
    """NaN without a 3D part, as the locations."""
    locations: Float64[np.ndarray, "num_boxes 3"]
    rotations_y: Float64[np.ndarray, " num_boxes"]
    alphas: Float64[np.ndarray, " num_boxes"]
    """Angles as in the file, with KITTI's placeholders."""

    @property
    def has_3d(self) -> Bool[np.ndarray, " num_boxes"]:
        """Mask of the boxes with a 3D part."""
        return np.asarray(np.isfinite(self.locations).all(axis=1))

    def num_repeated(self) -> int:
        """Number of boxes equal to an earlier one, if they are of one frame."""
        rows = np.column_stack((self.scores, self.boxes2d, self.locations))
        named = zip(self.names.tolist(), rows, strict=True)
        return len(rows) - len({(name, row.tobytes()) for name, row in named})


def scored_boxes(objects: KittiObjects) -> ScoredBoxes:
    """Select the objects of scored classes."""
    names = np.array([name.capitalize() for name in objects.class_names], dtype=object)
    kept = np.isin(names, _SCORED)
    lacks = (objects.dimensions_hwl <= 0).any(axis=1)
    lacks |= (objects.locations == NO_LOCATION).any(axis=1)
    scores = np.zeros(len(names)) if objects.scores is None else objects.scores
    return ScoredBoxes(
        names=names[kept],
        scores=scores[kept],
        boxes2d=objects.boxes2d[kept],
        sizes_hwl=np.where(lacks[:, None], np.nan, objects.dimensions_hwl)[kept],
        locations=np.where(lacks[:, None], np.nan, objects.locations)[kept],
        rotations_y=objects.rotation_y[kept],
        alphas=objects.alpha[kept],
    )


def joined(frames: Sequence[ScoredBoxes]) -> ScoredBoxes:
    """Concatenate the boxes of frames, at least one."""
    return ScoredBoxes(
        **{
            field.name: np.concatenate([getattr(each, field.name) for each in frames])
            for field in fields(ScoredBoxes)
        }
    )
