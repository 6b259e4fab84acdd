"""A sweep for the networks, in range, in view and sampled, and its ground truth."""

from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float32, Float64, Int64, jaxtyped
from torch import Tensor

from sightline.augmentation.sample_changes import points_in_view
from sightline.detection3d.checks import check_numbers
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.ranges import check_range
from sightline.geometry.user_warning import warn_user
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.labels import LOOK_ALIKES, ObjectLabels, check_look_alikes
from sightline.structures.level import level_detections, level_sample, mounted_detections
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample, check_points

Sweep = Float32[Tensor, "_ 4"]
"""LiDAR frame, raised by the settings' height offset: x, y, z [m], reflectance."""

_FARTHEST_M = 1e5
_MAX_POINTS = 2**22
_MANY_POINTS, _MIN_SHARE = 1000, 0.01  # of many points, the least share in range
_SEED: Final = 0  # for drawing points: results are reproducible


@dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """Part of a sweep that the network gets: the same for training, scoring and use.

    The defaults are those of the design that ships; the published one draws 16,384 points from -3
    to 1 m (recipe `detection3d-baseline-kitti`).
    """

    num_points: int | None = None
    """Number of points drawn; a smaller sweep repeats some. None: all points, in their order."""
    lowest_m: tuple[float, float, float] = (0.0, -40.0, -4.0)
    """Smallest x, y, z of points (LiDAR frame)."""
    highest_m: tuple[float, float, float] = (70.4, 40.0, 3.0)
    """Largest x, y, z of points."""
    far_m: float = 40.0
    """All points from this x on are kept, if there is room: far objects have few points."""
    in_view: bool = True
    """Whether to keep only points inside the camera image: elsewhere KITTI has no labels."""
    reflectance: bool = False
    """Whether points have their reflectance."""
    height_offset_m: float = 0.0
    """Height added to points, for a LiDAR that is mounted higher than KITTI's (1.73 m)."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.num_points is not None:
            check_range("input.num_points", self.num_points, 1, _MAX_POINTS)
        numbers = (*self.lowest_m, *self.highest_m, self.far_m, self.height_offset_m)
        if not all(abs(number) <= _FARTHEST_M for number in numbers):
            raise ValueError(f"lengths of the input must be within {_FARTHEST_M:g}, got {numbers}")
        if any(low >= high for low, high in zip(self.lowest_m, self.highest_m, strict=True)):
            raise ValueError(
                f"input.lowest_m must be below highest_m in x, y and z, got {self.lowest_m} and "
                f"{self.highest_m}"
            )


def cut_to_view(sample: CameraLidarSample, config: SweepConfig) -> CameraLidarSample:
    """Keep the points inside the camera image, if the settings require it.

    Raises:
        ValueError: The sample has no sweep, or points that `check_points` refuses.
    """
    points = sample.points
    if points is None:
        raise ValueError(
            f"sample {sample.sample_id} has no sweep, so nothing can be detected; give data with "
            "point clouds"
        )
    check_points(sample)
    return replace(sample, points=points[points_in_view(sample)]) if config.in_view else sample


def to_kitti_frame(sample: CameraLidarSample) -> CameraLidarSample:
    """Transform a sample to a LiDAR frame like KITTI's: level, x ahead, at the same height.

    `from_kitti_frame` is the inverse for detections.
    """
    sample = level_sample(sample)
    rise_m = sample.higher_than_kitti_m
    if sample.points is None or not rise_m:
        return sample
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = -rise_m
    camera_from_lidar = sample.calibration.camera_from_lidar @ old_from_new
    objects = sample.objects
    if objects is not None:
        boxes = objects.boxes3d.tensor
        raised = Boxes3D(boxes + boxes.new_tensor([0, 0, rise_m, 0, 0, 0, 0]))
        objects = replace(objects, boxes3d=raised)
    return replace(
        sample,
        points=sample.points + sample.points.new_tensor([0, 0, rise_m, 0]),
        objects=objects,
        calibration=replace(sample.calibration, camera_from_lidar=camera_from_lidar),
        lidar_height_m=None,
    )


def to_kitti_boxes(found: Detections3D, sample: CameraLidarSample) -> Detections3D:
    """Transform detections from the sample's own LiDAR frame to that of `to_kitti_frame`."""
    level = level_detections(found, sample)
    up = level.boxes.tensor.new_tensor([0, 0, sample.higher_than_kitti_m, 0, 0, 0, 0])
    return replace(level, boxes=Boxes3D(level.boxes.tensor + up))


def from_kitti_frame(found: Detections3D, sample: CameraLidarSample) -> Detections3D:
    """Transform detections in `to_kitti_frame(sample)` to the sample's own LiDAR frame."""
    down = found.boxes.tensor.new_tensor([0, 0, sample.higher_than_kitti_m, 0, 0, 0, 0])
    lowered = replace(found, boxes=Boxes3D(found.boxes.tensor - down))
    return mounted_detections(lowered, sample)


def points_in_range(
    points: Float32[Tensor, "num_points 4"], config: SweepConfig
) -> Float32[Tensor, "num_seen 4"]:
    """Keep the points in the network's range, in their order, raised by the height offset."""
    raised = points + points.new_tensor([0, 0, config.height_offset_m, 0])
    low, high = (points.new_tensor(corner) for corner in (config.lowest_m, config.highest_m))
    xyz = raised[:, :3]
    return raised[((xyz >= low) & (xyz <= high)).all(dim=1)]


def draw_points(
    points: Float32[Tensor, "num_seen 4"], config: SweepConfig, rng: np.random.Generator
) -> Float32[Tensor, "num_points 4"]:
    """Draw exactly `num_points` points in random order, or none from an empty sweep.

    If `num_points` is None, keep all in order. Shi et al. 2019 (PointRCNN), in its published code:
    from more points, all far ones stay, and near ones are drawn without repetition; if there are
    too many far ones, all points are equally likely. Of fewer points, all stay and some are
    repeated. The order is random because a ball query takes the first points that it finds.
    """
    if config.num_points is None:
        return points
    count, num_points = len(points), config.num_points
    indices = np.arange(count)
    is_far = (points[:, 0] >= config.far_m).numpy()
    far, near = indices[is_far], indices[~is_far]
    if 0 < count <= num_points:
        repeated = rng.integers(count, size=num_points - count)
        chosen = rng.permutation(np.concatenate((indices, repeated)))
    elif len(far) >= num_points:
        chosen = rng.permutation(indices)[:num_points]
    elif count:
        near = rng.permutation(near)[: num_points - len(far)]
        chosen = rng.permutation(np.concatenate((far, near)))
    else:
        chosen = indices
    return points[torch.from_numpy(chosen)]


def network_sweep(sample: CameraLidarSample, settings: SweepConfig) -> Sweep:
    """Prepare a sample's sweep for a network at inference; warn as `predict` does.

    Raises:
        ValueError: See `predict`.
    """
    visible = cut_to_view(sample, settings).points
    assert visible is not None, "checked when it was cut"
    assert sample.points is not None, "likewise"
    seen = points_in_range(visible, settings)
    if len(sample.points) >= _MANY_POINTS and len(seen) < _MIN_SHARE * len(sample.points):
        warn_user(
            f"of the {len(sample.points)} points of sample {sample.sample_id} only {len(seen)} lie "
            "in the network's range; check that its axes are x forward, y left, z up, in metres "
            "from the LiDAR",
        )
    return draw_points(seen, settings, np.random.default_rng(_SEED))


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class SweepTruth:
    """Ground truth of one sweep; boxes are x, y, z, length, width, height, yaw, in its frame."""

    boxes: Float64[Tensor, "num_objects 7"]
    """Boxes of the objects to detect."""
    classes: Int64[Tensor, " num_objects"]
    """Indices into the detector's classes."""
    ignored_boxes: Float64[Tensor, "num_ignored 7"]
    """Boxes of areas without a loss."""
    ignored_classes: Bool[Tensor, "num_ignored num_classes"]
    """Classes for which each area is ignored."""

    def cpu(self) -> "SweepTruth":
        """Copy to the CPU, for loops over single boxes."""
        return SweepTruth(**{each.name: getattr(self, each.name).cpu() for each in fields(self)})


@dataclass(frozen=True, kw_only=True)
class SweepTruthConfig:
    """Selection of objects to detect; other boxes are ignored or background."""

    ignored_names: tuple[str, ...] = ("Van", "Truck", "Person_sitting")
    """KITTI's classes that are ignored for the class that they resemble, unless the detector learns
    them."""
    min_points: int = 1
    """Smallest number of points on an object to detect; others are ignored."""

    def __post_init__(self) -> None:
        """Check the names and the number."""
        check_look_alikes(self.ignored_names)
        check_numbers(self, "at least 0", "min_points")


def make_truth(
    objects: ObjectLabels,
    points: Float[Tensor, "num_points fields"],
    class_names: tuple[str, ...],
    sweep: SweepConfig,
    config: SweepTruthConfig = SweepTruthConfig(),
) -> SweepTruth:
    """Make the ground truth of a sweep from labels.

    Objects of the detector's classes with enough points are targets if their centre lies in the
    network's range. Other objects of these classes are ignored for their own class, those of
    similar classes for the class that they resemble, and a DontCare with a 3D box for all classes.
    Labels without a 3D box have no effect, and other classes are background. A point in several
    boxes counts for the first, and a point that was drawn several times counts once. Points are the
    network's input.

    Raises:
        ValueError: A point or a box is not finite.
    """
    offset = torch.tensor([0, 0, sweep.height_offset_m, 0, 0, 0, 0], dtype=torch.float64)
    boxes = objects.boxes3d.tensor.double() + offset
    low, high = (boxes.new_tensor(corner) for corner in (sweep.lowest_m, sweep.highest_m))
    is_seen = ((boxes[:, :3] >= low) & (boxes[:, :3] <= high)).all(dim=1)
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    is_held = holder >= 0
    held = torch.cat((holder[is_held, None].to(points.dtype), points[is_held]), dim=1)
    holders = torch.unique(held, dim=0)[:, 0].long()  # sparse sweeps repeat some points
    inside = torch.bincount(holders, minlength=len(boxes))
    is_clear = (is_seen & (inside >= config.min_points)).tolist()
    found: list[int] = []
    ignored: list[int] = []
    ignored_classes: list[list[bool]] = []
    for index in objects.has_box3d.nonzero()[:, 0].tolist():
        name = objects.class_names[index]
        is_like = name in config.ignored_names and name not in class_names
        like = LOOK_ALIKES[name] if is_like else name
        if name in class_names and is_clear[index]:
            found.append(index)
        elif like in class_names or name == "DontCare":
            ignored.append(index)
            ignored_classes.append([name == "DontCare" or each == like for each in class_names])
    classes = [class_names.index(objects.class_names[index]) for index in found]
    return SweepTruth(
        boxes=boxes[found],
        classes=torch.tensor(classes, dtype=torch.int64),
        ignored_boxes=boxes[ignored],
        ignored_classes=torch.tensor(ignored_classes, dtype=torch.bool).reshape(
            -1, len(class_names)
        ),
    )
