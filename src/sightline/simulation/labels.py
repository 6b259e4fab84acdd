"""KITTI labels of a simulated frame, from the geometry and from what the camera really shows."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Int32

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.kitti_labels import NO_ALPHA, NO_LOCATION, KittiObjects
from sightline.simulation.camera import CameraFrame
from sightline.simulation.camera_rays import View, camera_view
from sightline.simulation.pixels import image_from_lidar, wrap_angle
from sightline.simulation.raycast import Raycaster
from sightline.simulation.scene import Mesh, Pose, Scene, world_from_footprint
from sightline.simulation.silhouette import silhouette

_NEAR_M = 0.3
"""What is nearer to the image plane cannot be projected."""
_MIN_PIXELS: Final = 25
"""What shows fewer pixels is not there."""

# How KITTI's annotators chose, fitted to their labels of cars.
_VISIBLE: Final = 0.93
"""Share of an object's pixels above which it counts as fully visible."""
_PARTLY: Final = 0.45
"""Share above which it counts as partly occluded; largely below."""
_MIN_LABELLED_PIXELS: Final = 120
_MIN_SHARE: Final = 0.1
_MIN_HEIGHT_PX: Final = 15.0
_MAX_DISTANCE_M: Final = 95.0
_MAX_TRUNCATION: Final = 0.98
"""What shows fewer pixels or a smaller share of itself, or is lower, farther or cut off farther, is
DontCare. Pixels are those of KITTI's focal length."""
KITTI_FOCAL_PX: Final = 721.5377
_DONT_CARE_GAP_PX: Final = 8.0
_UNKNOWN: Final = -1.0
"""KITTI's placeholder for the rest of what a region to ignore lacks."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Seen:
    """An actor that the camera shows."""

    index: int
    box: Float64[np.ndarray, "4"]
    """In the image, clipped to it."""
    truncation: float
    visible_share: float
    num_pixels: float
    """That it shows, at KITTI's focal length."""
    height_px: float
    """Of the box, likewise."""
    depth_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameLabels:
    """Labels and which actor each is of."""

    objects: KittiObjects
    actors: Int32[np.ndarray, " num_objects"]
    """Index into the scene's actors; -1 for DontCare."""


def label_frame(
    scene: Scene, frame: CameraFrame, calibration: CalibrationMatrices, lidar_height_m: float
) -> FrameLabels:
    """Labels what the camera shows as KITTI's annotators would, from left to right of the actors.

    The 2D box is that of the object's projection, hidden parts included, clipped to the image.
    Truncation is the share of the unclipped box outside. Occlusion is 0, 1 or 2 by the share of
    the object's pixels within the image that it owns there. What is too small, far or hidden to
    label is DontCare where it shows, close ones in one box.
    """
    onlooker = _Onlooker.of(scene, frame, calibration, lidar_height_m)
    pixels = np.bincount(frame.owners[frame.owners >= 0], minlength=len(scene.actors))
    seen = [onlooker.look_at(index) for index in np.flatnonzero(pixels >= _MIN_PIXELS).tolist()]
    labelled = [item for item in seen if _is_labelled(item)]
    regions = _joined([onlooker.shown_box(item) for item in seen if not _is_labelled(item)])
    objects = _joined_objects(
        _kitti_objects(scene, labelled, calibration, lidar_height_m), _regions_to_ignore(regions)
    )
    num_regions = len(regions)
    actors = np.array([*(item.index for item in labelled), *(-1,) * num_regions], dtype=np.int32)
    return FrameLabels(objects=objects, actors=actors)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Onlooker:
    """Looks at the actors of a scene one by one."""

    scene: Scene
    frame: CameraFrame
    view: View
    image_from_world: Float64[np.ndarray, "3 4"]
    scale: float
    """Of the picture, against KITTI's focal length."""

    @staticmethod
    def of(
        scene: Scene, frame: CameraFrame, calibration: CalibrationMatrices, lidar_height_m: float
    ) -> "_Onlooker":
        world_from_lidar = world_from_footprint(scene.ego, lidar_height_m)
        return _Onlooker(
            scene=scene,
            frame=frame,
            view=camera_view(calibration, scene.ego, lidar_height_m),
            image_from_world=image_from_lidar(calibration) @ np.linalg.inv(world_from_lidar),
            scale=float(calibration.image_from_camera[1, 1]) / KITTI_FOCAL_PX,
        )

    def look_at(self, index: int) -> _Seen:
        """Box, truncation and visible share of one actor."""
        height, width = self.frame.owners.shape
        mesh = _mesh_of(self.scene, index)
        homogeneous = (
            mesh.vertices.astype(np.float64) @ self.image_from_world[:, :3].T
            + self.image_from_world[:, 3]
        )
        # What shows has a vertex in front; of one that is nearly past, that must do.
        in_front = homogeneous[homogeneous[:, 2] >= min(_NEAR_M, homogeneous[:, 2].max())]
        pixels = in_front[:, :2] / in_front[:, 2:]
        whole = np.concatenate((pixels.min(axis=0), pixels.max(axis=0)))
        limits = np.array([width - 1, height - 1, width - 1, height - 1], dtype=np.float64)
        clipped = np.clip(whole, 0.0, limits)
        if len(in_front) == len(homogeneous):
            alone = silhouette(pixels, mesh.faces, _whole_pixels(clipped))
            box, visible_share = self._fit(index, clipped, alone)
        else:  # no vertex bounds what reaches behind the camera: it may be anywhere
            box, visible_share = self._fit(index, limits * (0, 0, 1, 1), self._cast_at(mesh))
        inside = _area(clipped) / max(_area(whole), 1e-9)
        truncation = float(np.clip(1 - inside * len(in_front) / len(homogeneous), 0, 1))
        return _Seen(
            index=index,
            box=box,
            truncation=truncation,
            visible_share=visible_share,
            num_pixels=float(np.count_nonzero(self.frame.owners == index)) / self.scale**2,
            height_px=float(box[3] - box[1]) / self.scale,
            depth_m=float(np.median(in_front[:, 2])),
        )

    def shown_box(self, item: _Seen) -> Float64[np.ndarray, "4"]:
        """The box around the pixels that show an actor."""
        rows, columns = np.nonzero(self.frame.owners == item.index)
        corners = (columns.min(), rows.min(), columns.max(), rows.max())
        return np.array(corners, dtype=np.float64)

    def _fit(
        self, index: int, box: Float64[np.ndarray, "4"], alone: Bool[np.ndarray, "rows columns"]
    ) -> tuple[Float64[np.ndarray, "4"], float]:
        """The part of a box that an actor alone would fill, and the share of it that it does fill.

        `alone` are the box's pixels. The part is smaller where the image's edge cuts an actor.
        """
        rows, columns = np.nonzero(alone)
        if len(rows) == 0:
            return box, 0.0
        x_min, y_min, _, _ = _whole_pixels(box)
        x, y = columns + x_min, rows + y_min
        lower = np.maximum(box[:2], (x.min() - 0.5, y.min() - 0.5))
        upper = np.minimum(box[2:], (x.max() + 0.5, y.max() + 0.5))
        share = float((self.frame.owners[y, x] == index).mean())
        return np.concatenate((lower, upper)), share

    def _cast_at(self, mesh: Mesh) -> Bool[np.ndarray, "height width"]:
        """Which pixels of the image a mesh alone would cover."""
        shape = self.frame.owners.shape
        rows, columns = np.indices(shape, dtype=np.float32).reshape(2, -1)
        hits = Raycaster(mesh).cast(*self.view.rays(columns, rows), coherent=True)
        hit: Bool[np.ndarray, "height width"] = (hits.faces >= 0).reshape(shape)
        return hit


def _whole_pixels(box: Float64[np.ndarray, "4"]) -> tuple[int, int, int, int]:
    """First and last column and row of the pixels around a box within the image."""
    x_min, y_min = np.floor(box[:2]).astype(int).tolist()
    x_max, y_max = np.ceil(box[2:]).astype(int).tolist()
    return x_min, y_min, x_max, y_max


def _mesh_of(scene: Scene, index: int) -> Mesh:
    """The part of the scene's mesh that is an actor; its vertices stand together in it."""
    first, last = np.searchsorted(scene.owners, (index, index + 1))
    faces = scene.mesh.faces[first:last]
    start, end = faces.min(), faces.max() + 1
    return Mesh(
        vertices=scene.mesh.vertices[start:end],
        normals=scene.mesh.normals[start:end],
        uvs=scene.mesh.uvs[start:end],
        faces=faces - start,
        materials=scene.mesh.materials[first:last],
        colors=scene.mesh.colors[first:last],
    )


def _is_labelled(item: _Seen) -> bool:
    return (
        item.num_pixels >= _MIN_LABELLED_PIXELS
        and item.visible_share >= _MIN_SHARE
        and item.height_px >= _MIN_HEIGHT_PX
        and item.depth_m <= _MAX_DISTANCE_M
        and item.truncation <= _MAX_TRUNCATION
    )


def _occlusion(visible_share: float) -> int:
    return 0 if visible_share > _VISIBLE else 1 if visible_share > _PARTLY else 2


def _joined(boxes: list[Float64[np.ndarray, "4"]]) -> list[Float64[np.ndarray, "4"]]:
    """Boxes that touch or nearly do, merged until none are left that do."""
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


def _kitti_objects(
    scene: Scene, seen: list[_Seen], calibration: CalibrationMatrices, lidar_height_m: float
) -> KittiObjects:
    """What a label file says of objects with a 3D part."""
    actors = [scene.actors[item.index] for item in seen]
    sizes_lwh = np.array([actor.size_lwh for actor in actors], np.float64).reshape(-1, 3)
    places = [_place(scene.poses[item.index], scene.ego) for item in seen]
    ahead, left, up, yaw = np.array(places, np.float64).reshape(-1, 4).T
    bottoms = np.stack((ahead, left, up - lidar_height_m), axis=1)
    camera_from_lidar = calibration.camera_from_lidar
    locations = bottoms @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3]
    rotation_y = wrap_angle(-yaw - np.pi / 2)
    bearing = np.arctan2(locations[:, 0], locations[:, 2])
    return KittiObjects(
        class_names=tuple(actor.class_name for actor in actors),
        truncation=np.array([item.truncation for item in seen], np.float64),
        occlusion=np.array([_occlusion(item.visible_share) for item in seen], np.float64),
        alpha=wrap_angle(rotation_y - bearing),
        boxes2d=np.array([item.box for item in seen], np.float64).reshape(-1, 4),
        dimensions_hwl=sizes_lwh[:, ::-1],
        locations=locations,
        rotation_y=rotation_y,
    )


def _regions_to_ignore(boxes: list[Float64[np.ndarray, "4"]]) -> KittiObjects:
    count = len(boxes)
    return KittiObjects(
        class_names=("DontCare",) * count,
        truncation=np.full(count, _UNKNOWN),
        occlusion=np.full(count, _UNKNOWN),
        alpha=np.full(count, NO_ALPHA),
        boxes2d=np.array(boxes, np.float64).reshape(-1, 4),
        dimensions_hwl=np.full((count, 3), _UNKNOWN),
        locations=np.full((count, 3), NO_LOCATION),
        rotation_y=np.full(count, NO_ALPHA),
    )


def _joined_objects(first: KittiObjects, second: KittiObjects) -> KittiObjects:
    """The objects of both, one after the other."""
    return KittiObjects(
        class_names=first.class_names + second.class_names,
        truncation=np.concatenate((first.truncation, second.truncation)),
        occlusion=np.concatenate((first.occlusion, second.occlusion)),
        alpha=np.concatenate((first.alpha, second.alpha)),
        boxes2d=np.concatenate((first.boxes2d, second.boxes2d)),
        dimensions_hwl=np.concatenate((first.dimensions_hwl, second.dimensions_hwl)),
        locations=np.concatenate((first.locations, second.locations)),
        rotation_y=np.concatenate((first.rotation_y, second.rotation_y)),
    )


def _place(pose: Pose, ego: Pose) -> tuple[float, float, float, float]:
    """How far ahead, left and up [m] and how turned [rad] something stands, seen from the ego."""
    dx, dy = pose.x - ego.x, pose.y - ego.y
    cos, sin = np.cos(ego.yaw), np.sin(ego.yaw)
    return cos * dx + sin * dy, -sin * dx + cos * dy, pose.z - ego.z, pose.yaw - ego.yaw


def _area(box: Float64[np.ndarray, "4"]) -> float:
    return float(max(box[2] - box[0], 0.0) * max(box[3] - box[1], 0.0))
