"""Constants of KITTI's object evaluation: classes, difficulties, overlaps.

They are from the official C++ program in its version with 40 recall positions. Everything else of
the evaluation follows from them: pairs of truths and detections (`kitti_object_pairs`), their
matching (`kitti_object_matching`), the scores (`kitti_object_scores`).
"""

import functools
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int8

from sightline.data.formats.kitti_labels import MAX_OCCLUSION, MAX_TRUNCATION

ClassName = Literal["Car", "Pedestrian", "Cyclist"]
Metric = Literal["bbox", "bev", "3d"]
Difficulty = Literal["easy", "moderate", "hard"]

CLASSES: tuple[ClassName, ...] = ("Car", "Pedestrian", "Cyclist")
METRICS: tuple[Metric, ...] = ("bbox", "bev", "3d")
"""Overlaps of boxes in the image, of bird's-eye rectangles, of upright boxes."""
DIFFICULTIES: tuple[Difficulty, ...] = ("easy", "moderate", "hard")
"""Cumulative difficulties: objects that count at one level count at the next."""

MIN_HEIGHT_PX = (40, 25, 25)
MAX_OCCLUSIONS = (0, 1, MAX_OCCLUSION)
MAX_TRUNCATIONS = (0.15, 0.30, MAX_TRUNCATION)

NEVER = len(DIFFICULTIES)
"""Level of objects that count at no difficulty."""
OTHER_CLASS = -1
DONT_CARE = -2

_CODES = {name.lower(): code for code, name in enumerate(CLASSES)} | {"dontcare": DONT_CARE}
_NEIGHBOURS = {"van": CLASSES.index("Car"), "person_sitting": CLASSES.index("Pedestrian")}


@dataclass(frozen=True, kw_only=True)
class ClassOverlaps:
    """Overlaps that a match must exceed, for one class; an equal overlap is not a match."""

    bbox: float
    """Intersection over union in the image."""
    bev: float
    """Intersection over union of the rectangles on the ground."""
    box3d: float
    """Intersection over union of the upright boxes."""

    def __post_init__(self) -> None:
        """Check the range."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 <= value < 1:
                raise ValueError(
                    f"overlap {field.name} must be at least 0 and below 1, got {value}: a match "
                    "has to exceed it"
                )


@dataclass(frozen=True, kw_only=True)
class MinimumOverlaps:
    """Overlaps that a match must exceed, by class; by default the benchmark's own ("strict")."""

    car: ClassOverlaps = ClassOverlaps(bbox=0.7, bev=0.7, box3d=0.7)
    pedestrian: ClassOverlaps = ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5)
    cyclist: ClassOverlaps = ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5)

    def as_array(self) -> Float64[np.ndarray, "3 3"]:
        """Convert to an array with a row per class, a column per metric."""
        rows = (self.car, self.pedestrian, self.cyclist)
        return np.array([(row.bbox, row.bev, row.box3d) for row in rows])


STRICT = MinimumOverlaps()
LOOSE = MinimumOverlaps(
    car=ClassOverlaps(bbox=0.7, bev=0.5, box3d=0.5),
    pedestrian=ClassOverlaps(bbox=0.5, bev=0.25, box3d=0.25),
    cyclist=ClassOverlaps(bbox=0.5, bev=0.25, box3d=0.25),
)


def parse_overlaps(text: str) -> MinimumOverlaps:
    """Parse overlaps of the command line: `strict`, `loose`, or by class.

    By class: image, bird's-eye view and 3D, as in `car=0.5,0.25,0.25`; several classes are
    separated by semicolons or spaces, and other classes keep their strict overlaps.

    Raises:
        ValueError: The text is in none of these forms.
    """
    if text in ("strict", "loose"):
        return STRICT if text == "strict" else LOOSE
    chosen: dict[str, ClassOverlaps] = {}
    for part in text.replace(";", " ").split():
        name, _, numbers = part.lower().partition("=")
        try:
            bbox, bev, box3d = map(float, numbers.split(","))
        except ValueError:
            name = ""
        if name not in (field.name for field in fields(MinimumOverlaps)):
            raise ValueError(
                f"overlaps {part!r} are invalid: write strict, loose, or a class with "
                "its image, bird's-eye and 3D overlap, as in car=0.5,0.25,0.25"
            )
        chosen[name] = ClassOverlaps(bbox=bbox, bev=bev, box3d=box3d)
    if not chosen:
        raise ValueError("overlaps are empty: write strict, loose, or e.g. car=0.5,0.25,0.25")
    return MinimumOverlaps(**chosen)


@functools.lru_cache(maxsize=1024)
def class_code(name: str) -> int:
    """Find the index in `CLASSES`, `DONT_CARE` or `OTHER_CLASS`; case is ignored."""
    return _CODES.get(name.lower(), OTHER_CLASS)


@functools.lru_cache(maxsize=1024)
def neighbour_code(name: str) -> int:
    """Find the class that ignores this one (never missed, but may be found), or OTHER_CLASS."""
    return _NEIGHBOURS.get(name.lower(), OTHER_CLASS)


def truth_levels(
    truncation: Float64[np.ndarray, " num_objects"],
    occlusion: Float64[np.ndarray, " num_objects"],
    boxes2d: Float64[np.ndarray, "num_objects 4"],
) -> Int8[np.ndarray, " num_objects"]:
    """Compute the first difficulty at which each labelled object counts; `NEVER` if none."""
    height = boxes2d[:, 3] - boxes2d[:, 1]
    levels = np.zeros(len(height), dtype=np.int8)
    for max_truncation, max_occlusion, min_height in zip(
        MAX_TRUNCATIONS, MAX_OCCLUSIONS, MIN_HEIGHT_PX, strict=True
    ):
        levels += (
            (occlusion > max_occlusion) | (truncation > max_truncation) | (height <= min_height)
        )
    return levels


def detection_levels(
    boxes2d: Float64[np.ndarray, "num_objects 4"],
) -> Int8[np.ndarray, " num_objects"]:
    """Compute the first difficulty at which each detection is not small; `NEVER` if none.

    The official program first truncates the height to a whole number, which never changes its
    comparison with one.
    """
    height = np.abs(boxes2d[:, 1] - boxes2d[:, 3])
    levels = np.zeros(len(height), dtype=np.int8)
    for min_height in MIN_HEIGHT_PX:
        levels += height < min_height
    return levels
