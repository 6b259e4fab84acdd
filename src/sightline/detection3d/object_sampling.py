"""Augmentation that pastes road users of other sweeps into free places of a sweep.

After Yan et al. 2018 (SECOND) and Shi et al. 2019 (PointRCNN), section 4.1. Departures: objects
turn about the sensor, so that the visible side and the point density stay; they are put on the
ground; and points hidden by occlusion, of the object or of the scene, are removed.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from beartype import beartype
from jaxtyping import Bool, Float, Float32, Float64, Int64, jaxtyped
from torch import Tensor

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.formats.kitti_conversion import kitti_from_detections
from sightline.detection3d.checks import check_different, check_numbers
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.ranges import check_range
from sightline.geometry.transforms import wrap_angle, yaw_rotation
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.ops.rotated_iou import pairwise_iou_bev
from sightline.structures.labels import ObjectLabels
from sightline.structures.level import level_sample
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample

_GROUND_QUANTILE = 0.1  # quantile of the nearby heights; most lower points are noise
_GROUND_M = 0.3  # higher points belong to something on the ground
# Rays of the LiDAR: wider than the sensor's step, so that a surface has no gaps, and about as high
# as the spacing of 64 beams.
_AZIMUTH_STEP, _ELEVATION_STEP = math.radians(0.25), math.radians(0.42)


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class BankedObject:
    """Road user cut out of a sweep."""

    class_name: str
    box: Float64[Tensor, "7"]
    """x, y, z, length, width, height, yaw, in the LiDAR frame of its sweep."""
    points: Float32[Tensor, "num_points 4"]
    """Points in the same frame; reflectance in [0, 1]."""


@dataclass(frozen=True, kw_only=True)
class ObjectSamplingConfig:
    """Selection and placement of pasted objects."""

    class_names: tuple[str, ...] = ("Car", "Pedestrian", "Cyclist")
    """KITTI's class names; classes in the bank are drawn equally often."""
    max_objects: int = 8
    """Largest number of paste attempts in a sweep (at least 1); each attempt tries one place."""
    min_points: int = 5
    """Smallest number of points of an object, in the bank and visible after pasting."""
    max_bearing_deg: float = 39.0
    """Largest bearing to either side of straight ahead: the view of KITTI's camera."""
    clearance_m: float = 0.3
    """Free distance around other objects, ignored ones too."""
    ground_reach_m: float = 1.0
    """Distance around the object in which ground points are searched."""
    min_ground_points: int = 5
    """Smallest number of points in that area."""
    slack_m: float = 1.0
    """Points this little behind another point on the same ray stay visible."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_different("class_names", self.class_names, self.class_names)
        check_numbers(self, "at least 1", "max_objects", "min_points", "min_ground_points")
        check_range("max_bearing_deg", self.max_bearing_deg, 0, 180)
        check_numbers(self, "finite and not negative", "clearance_m", "ground_reach_m", "slack_m")


class ObjectBank:
    """Objects from training samples by class."""

    def __init__(self, objects: Iterable[BankedObject]) -> None:
        self._by_class: dict[str, list[BankedObject]] = {}
        for entry in objects:
            self._by_class.setdefault(entry.class_name, []).append(entry)

    def __len__(self) -> int:
        """Number of objects."""
        return sum(map(len, self._by_class.values()))

    def draw(self, class_names: tuple[str, ...], rng: np.random.Generator) -> BankedObject | None:
        """Draw a class, then an object of it; None if the bank has none of the classes."""
        present = [name for name in class_names if name in self._by_class]
        if not present:
            return None
        objects = self._by_class[present[rng.integers(len(present))]]
        return objects[rng.integers(len(objects))]


def collect_objects(
    sample: CameraLidarSample, config: ObjectSamplingConfig = ObjectSamplingConfig()
) -> list[BankedObject]:
    """Collect the pasteable objects of a labelled sample, with their points.

    Raises:
        ValueError: The sample has no sweep or no labels.
    """
    points, objects = _sweep_and_labels(sample)
    boxes = objects.boxes3d.tensor.double()
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    found = []
    for index, name in enumerate(objects.class_names):
        inside = points[holder == index]
        if name in config.class_names and len(inside) >= config.min_points:
            found.append(BankedObject(class_name=name, box=boxes[index].clone(), points=inside))
    return found


def fill_bank(
    datasets: Sequence[SampleDataset],
    num_frames: int,
    rng: np.random.Generator,
    config: ObjectSamplingConfig = ObjectSamplingConfig(),
) -> ObjectBank:
    """Fill a bank from `num_frames` frames drawn from all data sets; from all if there are fewer.

    Raises:
        ValueError: A frame cannot be read, or has no sweep or no labels.
    """
    frames = [(dataset, index) for dataset in datasets for index in range(len(dataset))]
    chosen = sorted(rng.permutation(len(frames))[:num_frames].tolist())
    samples = (level_sample(dataset[index]) for dataset, index in (frames[each] for each in chosen))
    return ObjectBank(entry for sample in samples for entry in collect_objects(sample, config))


def paste_objects(
    sample: CameraLidarSample,
    bank: ObjectBank,
    rng: np.random.Generator,
    config: ObjectSamplingConfig = ObjectSamplingConfig(),
) -> CameraLidarSample:
    """Paste some of the bank's objects into free places, and append their labels.

    Each object is turned about the sensor to a bearing drawn evenly, mirrored half of the time, and
    put on the ground there. It is skipped if it would come near another box, if something stands in
    its place, if no ground is visible, if it is outside the image, or if too few of its points stay
    visible. Labels of objects that it hides stay, so they may have fewer points. Image and depth do
    not change, and do not show it. The order of the points is no longer KITTI's.

    Raises:
        ValueError: The sample has no sweep or no labels.
    """
    for _ in range(rng.integers(1, config.max_objects + 1)):
        entry = bank.draw(config.class_names, rng)
        bearing = math.radians(config.max_bearing_deg) * rng.uniform(-1, 1)
        is_mirrored = bool(rng.random() < 0.5)
        if entry is not None:
            moved = _moved(entry, bearing, is_mirrored=is_mirrored)
            sample = _with_object(sample, moved, config)
    return sample


def _sweep_and_labels(
    sample: CameraLidarSample,
) -> tuple[Float32[Tensor, "num_points 4"], ObjectLabels]:
    if sample.points is None or sample.objects is None:
        raise ValueError(
            f"sample {sample.sample_id} needs a sweep and labels; give it both or leave out this "
            "step"
        )
    return sample.points, sample.objects


def _moved(entry: BankedObject, bearing: float, *, is_mirrored: bool) -> BankedObject:
    """Turn the object about the sensor to a bearing, mirrored if requested."""
    box, points = entry.box.clone(), entry.points.double()
    if is_mirrored:
        box[1], box[6] = -box[1], -box[6]
        points[:, 1] = -points[:, 1]
    turn = torch.tensor(bearing, dtype=torch.float64) - torch.atan2(box[1], box[0])
    rotation = yaw_rotation(turn)
    box[:3] = rotation @ box[:3]
    box[6] = wrap_angle(box[6] + turn)
    points[:, :3] = points[:, :3] @ rotation.T
    return replace(entry, box=box, points=points.float())


def _with_object(
    sample: CameraLidarSample, entry: BankedObject, config: ObjectSamplingConfig
) -> CameraLidarSample:
    """Paste the object, or return the sample unchanged if there is no room."""
    points, objects = _sweep_and_labels(sample)
    grown = Boxes3D(entry.box[None]).enlarge(config.clearance_m).bev
    if bool((pairwise_iou_bev(grown, objects.boxes3d.bev.double()) > 0).any()):
        return sample
    ground_m = _free_ground(points, entry, config)
    if ground_m is None:
        return sample
    rise_m = ground_m + float(entry.box[5]) / 2 - float(entry.box[2])
    standing = replace(
        entry,
        box=entry.box + rise_m * entry.box.new_tensor([0, 0, 1, 0, 0, 0, 0]),
        points=entry.points + rise_m * entry.points.new_tensor([0, 0, 1, 0]),
    )
    seen = visible_together(points[:, :3], standing.points[:, :3], slack_m=config.slack_m)
    labels = _with_label(objects, standing, sample)
    if labels is None or int(seen.pasted.sum()) < config.min_points:
        return sample
    together = torch.cat((points[seen.scene], standing.points[seen.pasted]))
    return replace(sample, points=together, objects=labels)


def _free_ground(
    points: Float32[Tensor, "num_points 4"], entry: BankedObject, config: ObjectSamplingConfig
) -> float | None:
    """Height of the ground under the object; None if it is hidden or occupied."""
    box = entry.box
    tall = torch.cat((box[:2], box.new_zeros(1), box[3:5], box.new_full((1,), 1e3), box[6:]))
    around = Boxes3D(tall[None]).enlarge(config.ground_reach_m)
    near = points[around.contain(points[:, :3].double())[0], :3].double()
    if len(near) < config.min_ground_points:
        return None
    ground_m = float(near[:, 2].quantile(_GROUND_QUANTILE))
    height_m = near[:, 2] - ground_m
    stands = (height_m > _GROUND_M) & (height_m < float(box[5]))
    is_taken = bool((stands & Boxes3D(tall[None]).contain(near)[0]).any())
    return None if is_taken else ground_m


def _with_label(
    objects: ObjectLabels, entry: BankedObject, sample: CameraLidarSample
) -> ObjectLabels | None:
    """Append the label of a fully visible object; None if it is outside the image."""
    found = Detections3D(
        class_names=(entry.class_name,), boxes=Boxes3D(entry.box[None]), scores=torch.ones(1)
    )
    visible = kitti_from_detections(found, sample.calibration, sample.image_size)
    if not visible.class_names:
        return None
    boxes3d, boxes2d = objects.boxes3d.tensor, objects.boxes2d.tensor
    box2d = torch.from_numpy(visible.boxes2d).to(boxes2d.dtype)
    return ObjectLabels(
        class_names=(*objects.class_names, entry.class_name),
        boxes2d=Boxes2D(torch.cat((boxes2d, box2d))),
        boxes3d=Boxes3D(torch.cat((boxes3d, entry.box[None].to(boxes3d.dtype)))),
        truncation=torch.cat((objects.truncation, objects.truncation.new_zeros(1))),
        occlusion=torch.cat((objects.occlusion, objects.occlusion.new_zeros(1))),
        alpha=torch.cat((objects.alpha, torch.from_numpy(visible.alpha))),
    )


class Visible(NamedTuple):
    """Masks of the visible points."""

    scene: Bool[Tensor, " num_scene"]
    pasted: Bool[Tensor, " num_pasted"]


def visible_together(
    scene: Float[Tensor, "num_scene 3"], pasted: Float[Tensor, "num_pasted 3"], *, slack_m: float
) -> Visible:
    """Find the points [m] of a sweep and of a pasted object that do not hide each other.

    A point is hidden by a point of the other cloud on the same ray whose ground distance is smaller
    by more than the slack. For points of the sweep, the rays to the left and right count too, so
    that an object has no gaps. A cloud does not hide itself. Rays do not wrap around behind the
    sensor.
    """
    (scene_ray, scene_m), (pasted_ray, pasted_m) = _rays(scene), _rays(pasted)
    if len(scene) == 0 or len(pasted) == 0:
        return Visible(scene_m >= 0, pasted_m >= 0)
    low = pasted_ray.amin(dim=0) - torch.tensor([1, 0])  # azimuth, elevation
    width, height = (pasted_ray.amax(dim=0) - low + torch.tensor([2, 1])).tolist()
    column, row = (scene_ray - low).unbind(dim=1)
    is_near = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    scene_cell = torch.where(is_near, row * width + column, 0)
    column, row = (pasted_ray - low).unbind(dim=1)
    pasted_cell = row * width + column
    before = _nearest(pasted_cell, pasted_m, width * height).reshape(height, width)
    beside = torch.full((height, 1), math.inf, dtype=before.dtype)
    before = torch.minimum(before, torch.cat((before[:, 1:], beside), dim=1)).minimum(
        torch.cat((beside, before[:, :-1]), dim=1)
    )
    is_hidden = is_near & (scene_m > before.flatten()[scene_cell] + slack_m)
    ahead = _nearest(scene_cell[is_near], scene_m[is_near], width * height)
    return Visible(~is_hidden, pasted_m <= ahead[pasted_cell] + slack_m)


def _rays(
    points: Float[Tensor, "num_points 3"],
) -> tuple[Int64[Tensor, "num_points 2"], Float64[Tensor, " num_points"]]:
    """Ray (azimuth, elevation) and ground distance [m] of each point."""
    x, y, z = points.double().unbind(dim=1)
    range_m = torch.hypot(x, y)
    rays = torch.atan2(y, x) / _AZIMUTH_STEP, torch.atan2(z, range_m) / _ELEVATION_STEP
    return torch.stack(rays, dim=1).floor().long(), range_m


def _nearest(
    cell: Int64[Tensor, " num_points"], range_m: Float64[Tensor, " num_points"], number: int
) -> Float64[Tensor, " {number}"]:
    empty = torch.full((number,), math.inf, dtype=range_m.dtype)
    return empty.scatter_reduce_(0, cell, range_m, "amin")
