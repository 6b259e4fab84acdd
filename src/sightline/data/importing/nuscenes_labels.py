"""Conversion of nuScenes' annotations to KITTI labels of one camera's image."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float32, Float64
from torch import Tensor

from sightline.data.checks.label_checks import class_of_word
from sightline.data.formats.kitti_boxes import ImageBox, box_corners, project_box
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import (
    NO_ALPHA,
    NO_LOCATION,
    NO_ROTATION,
    NO_SIZE,
    UNKNOWN,
    KittiObjects,
)
from sightline.data.importing.frames import Rigid
from sightline.data.importing.nuscenes import Annotation, plain_word
from sightline.files.plain_text import shortened
from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d
from sightline.geometry.mount import MAX_RANGE_M

_CLASSES: Final = {
    # nuScenes
    "vehicle.car": "Car",
    "vehicle.emergency.police": "Car",
    "vehicle.emergency.ambulance": "Van",
    "vehicle.truck": "Truck",
    "vehicle.trailer": "Truck",
    "vehicle.construction": "Truck",
    "vehicle.bus": "Truck",
    "human.pedestrian": "Pedestrian",
    "vehicle.bicycle": "Cyclist",
    "vehicle.motorcycle": "Cyclist",
    # Lyft
    "car": "Car",
    "truck": "Truck",
    "bus": "Truck",
    "other_vehicle": "Misc",
    "emergency_vehicle": "Van",
    "pedestrian": "Pedestrian",
    "bicycle": "Cyclist",
    "motorcycle": "Cyclist",
    # TIER IV
    "vehicle.police": "Car",
    "vehicle.police_car": "Car",
    "police_car": "Car",
    "vehicle.ambulance": "Van",
    "ambulance": "Van",
    "vehicle.emergency": "Van",
    "vehicle.fire": "Truck",
    "vehicle.fire_truck": "Truck",
    "fire_truck": "Truck",
    "semi_trailer": "Truck",
    "tractor": "Truck",
    "tractor_unit": "Truck",
    "construction_worker": "Pedestrian",
    "police_officer": "Pedestrian",
    "other_pedestrian": "Pedestrian",
    "personal_mobility": "Pedestrian",
    "stroller": "Pedestrian",
    "wheelchair": "Pedestrian",
    "vehicle.motorbike": "Cyclist",
    "motorbike": "Cyclist",
    # Argoverse, Waymo and others
    "vehicle": "Car",
    "regular_vehicle": "Car",
    "van": "Van",
    "large_vehicle": "Truck",
    "box_truck": "Truck",
    "truck_cab": "Truck",
    "trailer": "Truck",
    "vehicular_trailer": "Truck",
    "construction_vehicle": "Truck",
    "school_bus": "Truck",
    "articulated_bus": "Truck",
    "person": "Pedestrian",
    "human": "Pedestrian",
    "cyclist": "Cyclist",
    "bicyclist": "Cyclist",
    "motorcyclist": "Cyclist",
}
"""KITTI's class of each category, including its subcategories; others are left out."""
_ROAD_USERS: Final = ("Car", "Van", "Truck", "Tram", "Pedestrian", "Cyclist")
_IGNORED_CATEGORIES: Final = ("vehicle.ego",)
_CYCLES_WITHOUT_RIDER_INFO: Final = ("bicycle", "motorcycle", "motorbike")
"""Last words of cycle categories that do not distinguish riders."""
_DONT_CARE: Final = "DontCare"
_MAX_LEAN_DEG: Final = 20.0  # of an object on a slope against the LiDAR
_MIN_COUNTED_POINTS: Final = 5  # by the tables, of an object whose box is compared with the sweep
_OFF_ROAD: Final = np.array((0, 0, 0.3, 0.6, 0.6, 0, 0))
"""Change of a box [m] that leaves the road out and allows for motion during the sweep."""
_MIN_FOUND_SHARE: Final = 0.05  # of the tables' count, which may be of several sweeps
_MIN_EMPTY: Final = 2  # and a quarter of what is compared


@dataclass(frozen=True, kw_only=True, slots=True)
class LabelTally:
    """Counts of annotations by result; `+` adds the counts of several frames."""

    annotations: int = 0
    classes: Counter[str] = field(default_factory=Counter)
    """Labels of each class, including DontCare."""
    categories_left_out: Counter[str] = field(default_factory=Counter)
    """Annotations of categories without a class of KITTI."""
    outside: int = 0
    """Annotations of known categories outside the image."""
    far: int = 0
    """Annotations of known categories farther away than any LiDAR sees."""
    leaning: int = 0
    """Annotations of known categories that do not stand upright."""
    visibility_unknown: int = 0
    """Labels whose visibility is not in the tables."""
    compared: int = 0
    """Annotations inside the image that have several LiDAR points by the tables."""
    empty: int = 0
    """Compared annotations in whose box the sweep has far fewer points."""

    def __add__(self, other: "LabelTally") -> "LabelTally":
        """Return the sums."""
        return LabelTally(
            annotations=self.annotations + other.annotations,
            classes=self.classes + other.classes,
            categories_left_out=self.categories_left_out + other.categories_left_out,
            outside=self.outside + other.outside,
            far=self.far + other.far,
            leaning=self.leaning + other.leaning,
            visibility_unknown=self.visibility_unknown + other.visibility_unknown,
            compared=self.compared + other.compared,
            empty=self.empty + other.empty,
        )

    def lines(self) -> tuple[str, ...]:
        """Return the counts for the user, and a warning if no label is left."""
        if not self.annotations:
            return ("warning: the tables hold no annotation of these frames: no labels",)
        labels = sum(self.classes.values()) - self.classes[_DONT_CARE]
        lines = [
            f"labels: {self.annotations} annotations became {labels} labels "
            f"({_counted(self.classes - Counter({_DONT_CARE: self.classes[_DONT_CARE]}))}) and "
            f"{self.classes[_DONT_CARE]} DontCare regions; {self.outside} are outside the image"
        ]
        if self.categories_left_out:
            number = sum(self.categories_left_out.values())
            lines.append(
                f"left out {number} annotations of categories without a KITTI class: "
                f"{_counted(self.categories_left_out)}"
            )
        if self.visibility_unknown:
            lines.append(
                f"{self.visibility_unknown} of {labels} labels have no visibility in the tables "
                "and count as fully visible (occlusion 0)"
            )
        if self.leaning:
            lines.append(
                f"warning: {self.leaning} annotations lean by more than {_MAX_LEAN_DEG:g} degrees "
                "against the LiDAR, so their labels are probably wrong: rotations in "
                "sample_annotation, ego_pose and calibrated_sensor are quaternions w, x, y, z"
            )
        if self.empty >= max(_MIN_EMPTY, self.compared / 4):
            lines.append(
                f"warning: {self.empty} of {self.compared} annotations with at least "
                f"{_MIN_COUNTED_POINTS} LiDAR points by the tables have far fewer of the sweep "
                "in their boxes, so labels are probably misplaced: correct ego_pose and "
                "calibrated_sensor, or extract nuScenes' archives again"
            )
        if not labels and 2 * self.far > self.annotations:
            lines.append(
                f"warning: {self.far} of {self.annotations} annotations lie over {MAX_RANGE_M:g} m "
                "from the LiDAR, so none became a label: translations in sample_annotation and "
                "ego_pose are both in the world's frame"
            )
        elif not labels:
            lines.append(
                "warning: no annotation became a label; see the counts above, and name another "
                "camera by --camera-topic if its image shows other objects"
            )
        return tuple(lines)


def kitti_from_annotations(
    annotations: Sequence[Annotation],
    matrices: CalibrationMatrices,
    lidar_from_world: Rigid,
    image_size: tuple[int, int],
    points: Float32[np.ndarray, "num_points 4"],
) -> tuple[KittiObjects, LabelTally]:
    """Convert the annotations inside the image, in their order; also returns the counts.

    2D boxes bound the 3D box's edges within the image, as in KITTI. Buses and trailers are trucks,
    motorcycles are cycles; a cycle without a rider is Misc. An object without a LiDAR point, which
    cannot be detected, becomes a DontCare region.

    Args:
        annotations: Annotations in the world frame.
        matrices: Calibration of the frame.
        lidar_from_world: Pose of its sweep.
        image_size: Height, width [px].
        points: Sweep of the frame, used if the data set does not count points.
    """
    known = [(each, name) for each in annotations if (name := _class_of(each)) is not None]
    boxes = np.array([_box_in_lidar(each, lidar_from_world) for each, _ in known]).reshape(-1, 7)
    dimensions, locations, rotations = (
        column.numpy()
        for column in kitti_from_boxes3d(
            Boxes3D(torch.from_numpy(boxes)), torch.from_numpy(matrices.camera_from_lidar)
        )
    )
    image_boxes = [
        project_box(
            box_corners(locations[index], dimensions[index], float(rotations[index])),
            matrices.image_from_camera,
            image_size,
        )
        for index in range(len(known))
    ]
    kept = [index for index, each in enumerate(image_boxes) if _is_visible(each)]
    places = torch.from_numpy(points[:, :3].astype(np.float64))
    is_detectable = np.array(
        [_has_points(known[index][0], boxes[index], places) for index in kept], bool
    )
    bearing = np.arctan2(locations[kept, 0], locations[kept, 2])
    alpha = (rotations[kept] - bearing + np.pi) % (2 * np.pi) - np.pi
    # KITTI's "unknown" would leave the object out of every score.
    occlusion = [known[index][0].occlusion or 0 for index in kept]
    truncation = np.array([image_boxes[index].truncation for index in kept], dtype=np.float64)
    class_names = tuple(
        known[index][1] if has_label else _DONT_CARE
        for index, has_label in zip(kept, is_detectable.tolist(), strict=True)
    )
    objects = KittiObjects(
        class_names=class_names,
        truncation=np.where(is_detectable, truncation, UNKNOWN),
        occlusion=np.where(is_detectable, np.array(occlusion, dtype=np.float64), UNKNOWN),
        alpha=np.where(is_detectable, alpha, NO_ALPHA),
        boxes2d=np.array([image_boxes[index].box for index in kept]).reshape(-1, 4),
        dimensions_hwl=np.where(is_detectable[:, None], dimensions[kept], NO_SIZE),
        locations=np.where(is_detectable[:, None], locations[kept], NO_LOCATION),
        rotation_y=np.where(is_detectable, rotations[kept], NO_ROTATION),
    )
    counts = _tally(annotations, class_names, outside=len(known) - len(kept))
    leaning = sum(_lean_deg(each, lidar_from_world) > _MAX_LEAN_DEG for each, _ in known)
    compared = {
        index: count
        for index in kept
        if (count := known[index][0].num_lidar_points or 0) >= _MIN_COUNTED_POINTS and len(places)
    }
    empty = sum(
        _count_points(boxes[index] + _OFF_ROAD, places) < _MIN_FOUND_SHARE * count
        for index, count in compared.items()
    )
    unseen = sum(
        known[index][0].occlusion is None
        for index, has_label in zip(kept, is_detectable.tolist(), strict=True)
        if has_label
    )
    return objects, replace(
        counts,
        far=int(np.count_nonzero(np.hypot(boxes[:, 0], boxes[:, 1]) > MAX_RANGE_M)),
        leaning=leaning,
        visibility_unknown=unseen,
        compared=len(compared),
        empty=empty,
    )


def _tally(
    annotations: Sequence[Annotation], class_names: Sequence[str], *, outside: int
) -> LabelTally:
    return LabelTally(
        annotations=len(annotations),
        classes=Counter(class_names),
        categories_left_out=Counter(
            each.category for each in annotations if _class_of(each) is None
        ),
        outside=outside,
    )


def _class_of(annotation: Annotation) -> str | None:
    """Return KITTI's class of a category, ignoring case and remarks in (); None: there is none."""
    category = plain_word(re.sub(r"\(.*?\)", "", annotation.category))
    words = category.split(".")
    begins = [".".join(words[:count]) for count in range(len(words), 0, -1)]
    if any(begin in _IGNORED_CATEGORIES for begin in begins):
        return None
    found = next((begin for begin in begins if begin in _CLASSES), None)
    if found is None or (len(begins) > 1 and found == "vehicle"):
        return _class_of_last_word(words)
    may_be_parked = found.rpartition(".")[2] in _CYCLES_WITHOUT_RIDER_INFO
    return "Misc" if may_be_parked and annotation.is_ridden is False else _CLASSES[found]


def _class_of_last_word(words: Sequence[str]) -> str | None:
    """Return a road user's class by the words of labels, such as suv; None: vehicle.spaceship."""
    name = class_of_word(words[-1])
    is_other = len(words) > 1 and words[0] not in ("vehicle", "human")
    return name if name in _ROAD_USERS and not is_other else None


def _has_points(
    annotation: Annotation,
    box: Float64[np.ndarray, "7"],
    places: Float64[Tensor, "num_points 3"],
) -> bool:
    """Return whether the object has a LiDAR point, by the tables' count or else by the sweep."""
    if annotation.num_lidar_points is not None:
        return annotation.num_lidar_points > 0
    return _count_points(box, places) > 0


def _count_points(box: Float64[np.ndarray, "7"], places: Float64[Tensor, "num_points 3"]) -> int:
    return int(Boxes3D(torch.from_numpy(box[None])).contain(places).sum())


def _counted(counts: Counter[str]) -> str:
    """Return the names with their counts, the most frequent first, safe for a terminal."""
    return ", ".join(f"{count} {shortened(name)}" for name, count in counts.most_common()) or "none"


def _box_in_lidar(annotation: Annotation, lidar_from_world: Rigid) -> Float64[np.ndarray, "7"]:
    """Compute x, y, z, length, width, height, yaw; the small tilt of a box is neglected."""
    lidar_from_box = lidar_from_world @ annotation.world_from_box
    yaw = np.arctan2(lidar_from_box[1, 0], lidar_from_box[0, 0])
    return np.array((*lidar_from_box[:3, 3], *annotation.size_lwh, yaw))


def _lean_deg(annotation: Annotation, lidar_from_world: Rigid) -> float:
    """Compute the angle between a box's upright axis and the LiDAR's z axis."""
    upright = lidar_from_world[2, :3] @ annotation.world_from_box[:3, 2]
    return float(np.degrees(np.arccos(np.clip(upright, -1, 1))))


def _is_visible(image_box: ImageBox) -> bool:
    return bool(
        np.isfinite(image_box.box).all() and (image_box.box[2:] - image_box.box[:2] >= 1).all()
    )
