"""KITTI labels of a simulated frame, from the geometry and the camera's pixels."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float32, Float64, Int32
from scipy.ndimage import find_objects

from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import (
    NO_ALPHA,
    NO_LOCATION,
    KittiObjects,
    objects_from_rows,
)
from sightline.data.formats.pixels import wrap_angle
from sightline.simulation.camera.samples import (
    LEVEL_CAMERA_AXES,
    RollingView,
    View,
    camera_view,
)
from sightline.simulation.rays.raycast import EmbreeScene
from sightline.simulation.scene import Actor, Scene, world_from_footprint
from sightline.simulation.settings import KITTI_FOCAL_PX

_MIN_ANGLE: Final = math.radians(20.0)
"""Minimum angle between a flank and the line of sight in the views that define a car's box: it has
one size in all frames of a drive, and most show it from behind or ahead."""
_ANGLE_OFFSET: Final = math.radians(25.0)
"""Angle by which these views are flatter than a side view. With both angles, points of the flank
reach as near to the far ends of simulated labels as to those of KITTI's cars."""
_LOWER_BODY_SHARE: Final = 0.5
"""Share of the height below which bodies are widest and have no mirrors."""


def labelled_ends(
    vertices: Float[np.ndarray, "num_vertices 3"],
    size_lwh: tuple[float, float, float],
    viewpoint: Float64[np.ndarray, "2"],
) -> tuple[float, float]:
    """Compute a car's rear and front end along x [m] as KITTI's annotators label them.

    Annotators have only the points. An end that faces away is round, so the last visible part is
    where the line of sight leaves the flank: the box ends there, about 0.3 m before the bumper. The
    length of a passing car changes by some centimetres during a drive. `vertices` and `viewpoint`,
    the x and y of the sensor, are in the car's frame [m]: x ahead, y left, z up, the origin on the
    ground.
    """
    length, width, height = size_lwh
    body = vertices[vertices[:, 2] < _LOWER_BODY_SHARE * height, :2]
    beside = max(abs(float(viewpoint[1])) - width / 2, 0.0)
    side = math.copysign(1.0, float(viewpoint[1]))
    ends = []
    for direction in (-1.0, 1.0):
        distance = length / 2 - direction * float(viewpoint[0])
        angle = max(math.atan2(beside, distance) - _ANGLE_OFFSET, _MIN_ANGLE)
        last = np.argmax(body @ np.array([direction * math.sin(angle), side * math.cos(angle)]))
        seen = min(direction * float(body[last, 0]), length / 2)
        ends.append(direction * (seen if distance > 0 else length / 2))
    return ends[0], ends[1]


_NEAR_M = 0.3  # minimum depth for projection into the image
# Rules of KITTI's annotators. The first two are fitted to the cars of all 7,481 label files: for
# equal cover of a car's box by nearer labelled boxes, simulated cars have each level as often.
_FULLY_VISIBLE_SHARE: Final = 0.97  # visible share of pixels above which occlusion is 0
_PARTLY_VISIBLE_SHARE: Final = 0.48  # share above which occlusion is 1; otherwise 2 or 3
_MIN_LABELLED_PIXELS: Final = 150
_MIN_SHARE: Final = 0.15
_MIN_HEIGHT_PX: Final = 14.0
_MAX_DEPTH_M: Final = 80.0
"""Limits of labelled objects: fewer pixels, a smaller visible share, a lower height or a greater
depth gives DontCare. Pixels refer to KITTI's focal length. KITTI's lowest labels are 12.7 px high,
0.04 % of its cars are farther away, and with this share as many are wholly covered by other
boxes."""
_MIN_PIXELS: Final = 15  # minimum pixels of an object; smaller ones are ignored
_PERSON_MARGIN_M: Final = 0.02
"""Gap between a pedestrian and either side of the box, which then has 0.72 of the width of the
projected 3D box (median; 0.55 to 0.9 for nine in ten) as in KITTI's files."""
_DONT_CARE_GAP_PX: Final = 4.0
_ROUND_ENDED_CLASSES: Final = ("Car", "Van")  # labelled only up to the flank's visible end
_NO_BOX3D: Final = (-1.0, -1.0, NO_ALPHA, -1.0, -1.0, -1.0, *(NO_LOCATION,) * 3, NO_ALPHA)
"""Numbers on a DontCare line; its box follows the third number."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _VisibleActor:
    """Actor within view of the camera."""

    index: int
    actor: Actor
    size_lwh: tuple[float, float, float]  # size of the label [m]
    location: Float64[np.ndarray, "3"]  # bottom centre, camera frame [m]
    rotation_y: float
    box: Float64[np.ndarray, "4"]
    """2D box as KITTI draws it; NaN where no edge of the 3D box is in view."""
    visible_box: Float64[np.ndarray, "4"]  # bounding box of the visible pixels
    truncation: float
    visible_share: float
    num_pixels: int  # number of visible pixels


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameLabels:
    """Labels and the actor of each."""

    objects: KittiObjects
    actors: Int32[np.ndarray, " num_objects"]  # index into the scene's actors; -1 for DontCare
    visible_boxes: Float64[np.ndarray, "num_objects 4"]
    """x_min, y_min, x_max, y_max of each object's visible pixels; NaN for DontCare."""


def label_frame(
    scene: Scene,
    owners: Int32[np.ndarray, "height width"],
    calibration: CalibrationMatrices,
    lidar_height_m: float,
    view: View | RollingView | None = None,
) -> FrameLabels:
    """Label the objects in view as KITTI's annotators would, in the order of the actors.

    The 2D box is `kitti_boxes.project_box`, hidden parts included; a pedestrian's is as wide as the
    person, not as the 3D box. `labelled_ends` gives the ends of cars and vans. Occlusion is 0, 1 or
    2 by the visible share of the object's pixels within the image; a largely hidden object cut by
    the image border has 3, as do 95 % of KITTI's cars of that level. Objects too small, far or
    hidden to label are DontCare, with close ones merged into one box.

    Boxes stand upright on the car's level, whatever the camera's pitch and roll: 2D boxes bound the
    upright boxes, rotation_y is about the vertical, and the location is the one from which readers
    compute the box's true middle, half of its height along the camera's y axis.

    `owners` are the indices of the actors at each pixel, negative for none; the LiDAR, the
    calibration's reference frame, is `lidar_height_m` above the ego's footprint. `view` is the one
    that the owners were seen from; None: the calibration's.
    """
    lidar_from_world = np.linalg.inv(world_from_footprint(scene.ego, lidar_height_m))
    observer = _Observer(
        scene=scene,
        owners=owners,
        view=view or camera_view(calibration, scene.ego, lidar_height_m),
        camera_from_level=calibration.camera_from_lidar[:3, :3] @ LEVEL_CAMERA_AXES.T,
        camera_from_world=calibration.camera_from_lidar @ lidar_from_world,
        image_from_camera=calibration.image_from_camera,
    )
    pixels = np.bincount(owners[owners >= 0], minlength=len(scene.actors))
    scale = float(calibration.image_from_camera[1, 1]) / KITTI_FOCAL_PX
    seen = [
        observer.measure(index, region, int(pixels[index]))
        for index, region in enumerate(find_objects(np.maximum(owners, -1) + 1))
        if region is not None and pixels[index] >= _MIN_PIXELS
    ]
    labelled = [item for item in seen if _is_labelled(item, scale)]
    others = [item for item in seen if not _is_labelled(item, scale)]
    regions = _joined([np.where(np.isnan(one.box), one.visible_box, one.box) for one in others])
    names = *(item.actor.class_name for item in labelled), *("DontCare",) * len(regions)
    rows = [_row(item) for item in labelled]
    rows += [np.array((*_NO_BOX3D[:3], *box, *_NO_BOX3D[3:])) for box in regions]
    boxes = [*(item.visible_box for item in labelled), *(np.full(4, np.nan) for _ in regions)]
    indices = [*(item.index for item in labelled), *(-1 for _ in regions)]
    return FrameLabels(
        objects=objects_from_rows(names, np.array(rows, np.float64).reshape(-1, 14)),
        actors=np.array(indices, dtype=np.int32),
        visible_boxes=np.array(boxes, np.float64).reshape(-1, 4),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Observer:
    """Observer that measures a scene's actors one by one."""

    scene: Scene
    owners: Int32[np.ndarray, "height width"]
    view: View | RollingView
    camera_from_world: Float64[np.ndarray, "4 4"]
    camera_from_level: Float64[np.ndarray, "3 3"]
    """Rotation from a camera at the same place that is level like the car."""
    image_from_camera: Float64[np.ndarray, "3 4"]

    def measure(self, index: int, region: tuple[slice, ...], num_pixels: int) -> _VisibleActor:
        """Compute location, boxes, truncation and visible share of one actor."""
        actor, pose = self.scene.actors[index], self.scene.poses[index]
        camera_from_actor = self.camera_from_world @ world_from_footprint(pose, 0.0)
        size_lwh, middle = self._labelled(index, camera_from_actor)
        bottom = camera_from_actor[:3, 3] + camera_from_actor[:3, 0] * middle
        heading = self.camera_from_level.T @ camera_from_actor[:3, 0]
        rotation_y = float(np.arctan2(-heading[2], heading[0]))
        upright = box_corners(
            self.camera_from_level.T @ bottom, np.array(size_lwh[::-1]), rotation_y
        )
        corners = upright @ self.camera_from_level.T
        # Readers raise the location along the camera's own vertical to the box's middle.
        raised = np.array((0.0, -size_lwh[2] / 2, 0.0))
        location = bottom + (self.camera_from_level @ raised - raised)
        height, width = self.owners.shape
        box, truncation = project_box(corners, self.image_from_camera, (height, width))
        outline, share = self._outline(index)
        if actor.class_name == "Pedestrian" and not np.isnan(outline).any():
            margin_px = _PERSON_MARGIN_M * self.image_from_camera[0, 0] / location[2]
            box[[0, 2]] = np.clip(outline + margin_px * np.array((-1, 1)), 0, width - 1)
        rows, columns = region
        visible_box = columns.start, rows.start, columns.stop - 1, rows.stop - 1
        return _VisibleActor(
            index=index,
            actor=actor,
            size_lwh=size_lwh,
            location=location,
            rotation_y=rotation_y,
            box=box,
            visible_box=np.array(visible_box, np.float64),
            truncation=truncation,
            visible_share=share,
            num_pixels=num_pixels,
        )

    def _labelled(
        self, index: int, camera_from_actor: Float64[np.ndarray, "4 4"]
    ) -> tuple[tuple[float, float, float], float]:
        """Compute an actor's label size [m] and its middle's offset ahead of the actor's [m]."""
        actor = self.scene.actors[index]
        if actor.class_name not in _ROUND_ENDED_CLASSES:
            return actor.box_lwh, 0.0
        actor_from_camera = np.linalg.inv(camera_from_actor)
        to_actor = actor_from_camera @ self.camera_from_world
        vertices = self._mesh(index)[0] @ to_actor[:3, :3].T + to_actor[:3, 3]
        rear, front = labelled_ends(vertices, actor.box_lwh, actor_from_camera[:2, 3])
        return (front - rear, *actor.box_lwh[1:]), (rear + front) / 2

    def _mesh(
        self, index: int
    ) -> tuple[Float32[np.ndarray, "num_vertices 3"], Int32[np.ndarray, "num_faces 3"]]:
        """Select an actor's vertices in the world [m] and its faces."""
        first, last = np.searchsorted(self.scene.owners, (index, index + 1))
        faces = self.scene.mesh.faces[first:last]
        start = faces.min()  # an actor's vertices are contiguous
        return self.scene.mesh.vertices[start : faces.max() + 1], faces - start

    def _outline(self, index: int) -> tuple[Float64[np.ndarray, "2"], float]:
        """Compute an actor's horizontal image range if unoccluded [px], and its visible share.

        An actor that reaches behind the camera has no range: NaN.
        """
        vertices, faces = self._mesh(index)
        image_from_world = self.image_from_camera @ self.camera_from_world
        homogeneous = vertices @ image_from_world[:, :3].T + image_from_world[:, 3]
        end = np.array(self.owners.shape[::-1]) - 1
        lower, upper, reach = np.zeros(2), end, np.full(2, np.nan)
        if homogeneous[:, 2].min() >= _NEAR_M:
            pixels = homogeneous[:, :2] / homogeneous[:, 2:]
            lower, upper = (np.clip(ends(pixels, axis=0), 0, end) for ends in (np.min, np.max))
            reach = np.array((lower[0], upper[0]))
        (x_min, y_min), (x_max, y_max) = np.floor(lower).astype(int), np.ceil(upper).astype(int)
        visible = self.owners[y_min : y_max + 1, x_min : x_max + 1].reshape(-1)
        rows, columns = np.indices((y_max - y_min + 1, x_max - x_min + 1)).reshape(2, -1)
        rays = self.view.rays(
            (columns + x_min).astype(np.float32), (rows + y_min).astype(np.float32)
        )
        found, _, _ = EmbreeScene(vertices, faces).intersect(*rays, coherent=True)
        alone = found >= 0
        return reach, float((visible[alone] == index).mean()) if alone.any() else 0.0


def _is_labelled(item: _VisibleActor, scale: float) -> bool:
    """Test for a labelled object; `scale` is the image's focal length over KITTI's."""
    return bool(
        item.num_pixels >= _MIN_LABELLED_PIXELS * scale**2
        and item.visible_share >= _MIN_SHARE
        and item.box[3] - item.box[1] >= _MIN_HEIGHT_PX * scale
        and item.location[2] <= _MAX_DEPTH_M
    )


def _occlusion(item: _VisibleActor) -> int:
    if item.visible_share > _PARTLY_VISIBLE_SHARE:
        return 0 if item.visible_share > _FULLY_VISIBLE_SHARE else 1
    return 3 if item.truncation > 0 else 2


def _joined(boxes: list[Float64[np.ndarray, "4"]]) -> list[Float64[np.ndarray, "4"]]:
    """Merge boxes that touch or nearly touch.

    This takes one pass: a grown box may touch one that it did not touch before.
    """
    merged: list[Float64[np.ndarray, "4"]] = []
    for box in boxes:
        grown = box
        apart = []
        for other in merged:
            lower, upper = np.maximum(grown[:2], other[:2]), np.minimum(grown[2:], other[2:])
            if (lower - upper > _DONT_CARE_GAP_PX).any():
                apart.append(other)
            else:
                grown = np.concatenate(
                    (np.minimum(grown[:2], other[:2]), np.maximum(grown[2:], other[2:]))
                )
        merged = [*apart, grown]
    return merged


def _row(item: _VisibleActor) -> Float64[np.ndarray, "14"]:
    """Collect the numbers of a label line."""
    bearing = np.arctan2(item.location[0], item.location[2])
    turns = wrap_angle(np.array((item.rotation_y - bearing, item.rotation_y)))
    start = item.truncation, _occlusion(item), turns[0]
    row = (*start, *item.box, *item.size_lwh[::-1], *item.location, turns[1])
    return np.array(row, dtype=np.float64)
