"""3D boxes of image boxes by geometry alone: class size, road plane, and returns if there are any.

The distance of an object follows from the height of its image box, as the class's height is known,
and from the box's lower edge, which stands on the road. Returns within the image box decide where
there are some. Roads are taken as flat, and objects as parallel to the camera's view if the shape
of their box does not say otherwise.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.joining.evidence import logit
from sightline.joining.scene import Scene

LIFTED_COLUMNS: Final = (
    "logit of the image box's score",
    "log of the range",
    "log of the range's relative error",
    "log of the returns in the image box",
    "misfit",
    "at the image's border",
)
"""Evidence for a lifted box."""

_SIZES_LWH: Final = {
    "Car": (3.88, 1.63, 1.53),
    "Pedestrian": (0.84, 0.66, 1.76),
    "Cyclist": (1.76, 0.60, 1.74),
}
"""Mean sizes [m] in KITTI's training labels: Lang et al. 2019 and Shi et al. 2019 use the same."""
_NUM_YAWS: Final = 16  # over half a turn: front and rear look alike
_HEIGHT_SPREAD: Final = 0.07  # relative, of heights within a class and of boxes' heights
_HORIZON_SPREAD: Final = 0.015  # [rad], of the camera's pitch and the road's slope
_MIN_GROUND_ERROR_M: Final = 0.3
_RETURN_ERROR_M: Final = 0.35
_FEW_RETURNS_ERROR_M: Final = 0.6
_FEW_RETURNS: Final = 2
_NEAREST_M, _FARTHEST_M = 2.0, 90.0
_NEAREST_DEPTH_M: Final = 0.3
_SEEN_TO_CENTER: Final = 0.3  # shares of the length between the seen edge and the centre
_THICKNESS_M: Final = {"Car": 1.5}
_THIN_M: Final = 0.6
_ROAD_WEIGHT: Final = 0.3  # of the road in the choice of the yaw
_BORDER_PX: Final = 1.5
_CORNER_SIGNS: Final = np.array(
    [(x, y, z) for x in (0.5, -0.5) for y in (0.5, -0.5) for z in (0.0, 1.0)]
)
"""Corners of a box in units of its size, about the centre of its bottom."""


class Lifted(NamedTuple):
    """3D box of an image box."""

    box: Float64[np.ndarray, "7"]
    """Level LiDAR frame, as in `Boxes3D`."""
    range_error_m: float
    """Expected error of the distance."""
    evidence: Float64[np.ndarray, "6"]
    """Columns of `LIFTED_COLUMNS`."""


class _View(NamedTuple):
    """Camera and the image box to explain."""

    scene: Scene
    box: Float64[np.ndarray, "4"]
    focal_px: float
    at_left: bool
    at_right: bool
    at_bottom: bool


class _Guesses(NamedTuple):
    """Boxes of one size at several yaws, in the camera frame."""

    yaws: Float64[np.ndarray, " yaws"]
    offsets: Float64[np.ndarray, "yaws 8 3"]
    """Corners [m], seen from the bottom's centre."""
    bottoms: Float64[np.ndarray, "yaws 3"]
    """Centres of the bottoms [m]."""


def lift(scene: Scene, index: int) -> Lifted:
    """Lift one box of the image detector, at the yaw that explains its shape best."""
    box, name = scene.image.in_image[index], scene.image.names[index]
    height, width = scene.image_size
    view = _View(
        scene=scene,
        box=box,
        focal_px=float(scene.image_from_camera[0, 0]),
        at_left=bool(box[0] <= _BORDER_PX),
        at_right=bool(box[2] >= width - 1 - _BORDER_PX),
        at_bottom=bool(box[3] >= height - 1 - _BORDER_PX),
    )
    size = np.array(_SIZES_LWH[name])
    on_road = _depth_on_road(view, size)
    guesses = _by_height(view, _first_guesses(view, name, size))
    if view.at_bottom and on_road is not None:  # the object ends below what is seen
        nearer = np.minimum(on_road / guesses.bottoms[:, 2], 1.0)
        guesses = guesses._replace(bottoms=guesses.bottoms * nearer[:, None])
    depths = guesses.bottoms[:, 2].copy()
    precision = (_HEIGHT_SPREAD * depths) ** -2.0
    total = precision * depths
    if on_road is not None and not view.at_bottom:
        error = max(_HORIZON_SPREAD * on_road**2 / scene.lidar_height_m, _MIN_GROUND_ERROR_M)
        precision, total = precision + error**-2.0, total + on_road * error**-2.0
    returns = _returns_of(view, float(depths.mean()), name)
    if len(returns):
        error = _RETURN_ERROR_M if len(returns) > _FEW_RETURNS else _FEW_RETURNS_ERROR_M
        corners = np.sort(guesses.bottoms[:, None, 2] + guesses.offsets[..., 2], axis=1)
        behind = depths - corners[:, :4].mean(axis=1)  # of the centre, behind what is seen
        precision = precision + error**-2.0
        total = total + (np.median(returns) + behind) * error**-2.0
    fused = total / precision
    moved = guesses.bottoms * (fused / depths)[:, None]
    guesses = guesses._replace(bottoms=_match(view, guesses._replace(bottoms=moved)))
    misfit = _misfit(view, guesses, name)
    best = int(misfit.argmin())
    error_m = float(precision[best] ** -0.5)
    evidence = (
        float(logit(scene.image.scores[index])),
        math.log(fused[best]),
        math.log(error_m / fused[best]),
        math.log1p(scene.image.num_points[index]),
        math.log1p(float(misfit[best])),
        float(view.at_left or view.at_right or view.at_bottom),
    )
    return Lifted(_to_level(scene, guesses, best, size), error_m, np.array(evidence))


def _first_guesses(view: _View, name: str, size: Float64[np.ndarray, "3"]) -> _Guesses:
    """Boxes at all yaws in the middle of the image box, at the distance of their height."""
    count = 1 if name == "Pedestrian" else _NUM_YAWS
    yaws = math.pi * (np.arange(count) / count) - (math.pi / 2 if count > 1 else 0.0)
    yaws = np.where(yaws < -math.pi / 2 + 1e-9, -math.pi / 2, yaws)
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    corners = _CORNER_SIGNS * size
    turned = np.stack(
        (
            cos * corners[:, 0] - sin * corners[:, 1],
            sin * corners[:, 0] + cos * corners[:, 1],
            np.broadcast_to(corners[:, 2], (count, 8)),
        ),
        axis=2,
    )
    rotation = view.scene.camera_from_level[:3, :3]
    box, matrix = view.box, view.scene.image_from_camera
    depth = view.focal_px * size[2] / max(box[3] - box[1], 2.0) + size[0] / 4
    middle = np.array([(box[0] + box[2]) / 2, box[3], 1.0]) * depth
    bottom = np.linalg.solve(matrix[:, :3], middle - matrix[:, 3])
    return _Guesses(yaws, turned @ rotation.T, np.tile(bottom, (count, 1)))


def _project(view: _View, guesses: _Guesses) -> Float64[np.ndarray, "yaws 4"]:
    """Bounds of the boxes [px], not cut at the image's border."""
    matrix = view.scene.image_from_camera
    homogeneous = (guesses.bottoms[:, None] + guesses.offsets) @ matrix[:, :3].T + matrix[:, 3]
    pixels = homogeneous[..., :2] / np.maximum(homogeneous[..., 2:], _NEAREST_DEPTH_M)
    return np.concatenate((pixels.min(axis=1), pixels.max(axis=1)), axis=1)


def _match(view: _View, guesses: _Guesses) -> Float64[np.ndarray, "yaws 3"]:
    """Move boxes sideways and up until their middle and lower edge are those of the image box."""
    box, moved = view.box, guesses.bottoms.copy()
    for _ in range(3):
        seen = _project(view, guesses._replace(bottoms=moved))
        scale = moved[:, 2] / view.focal_px
        if view.at_left and not view.at_right:
            shift = box[2] - seen[:, 2]
        elif view.at_right and not view.at_left:
            shift = box[0] - seen[:, 0]
        else:
            shift = (box[0] + box[2] - seen[:, 0] - seen[:, 2]) / 2
        moved[:, 0] += shift * scale
        if view.at_bottom:
            moved[:, 1] += (box[1] - seen[:, 1]) * scale
        else:
            moved[:, 1] += (box[3] - seen[:, 3]) * scale
    return moved


def _by_height(view: _View, guesses: _Guesses) -> _Guesses:
    """Move boxes along their rays until they are as high as the image box."""
    height = max(view.box[3] - view.box[1], 2.0)
    for _ in range(6):
        seen = _project(view, guesses)
        factor = np.clip((seen[:, 3] - seen[:, 1]) / height, 0.5, 2.0)
        depth = np.clip(guesses.bottoms[:, 2] * factor, _NEAREST_M, _FARTHEST_M)
        moved = guesses.bottoms * (depth / guesses.bottoms[:, 2])[:, None]
        guesses = guesses._replace(bottoms=moved)
        guesses = guesses._replace(bottoms=_match(view, guesses))
    return guesses


def _depth_on_road(view: _View, size: Float64[np.ndarray, "3"]) -> float | None:
    """Depth of the object's centre if the box's lower edge stands on the road; None: it cannot."""
    scene = view.scene
    pixel = np.array([(view.box[0] + view.box[2]) / 2, view.box[3], 1.0])
    ray = np.linalg.solve(scene.image_from_camera[:, :3], pixel)
    up = scene.camera_from_level[:3, 2]
    center = scene.camera_from_level[:3, 3]
    origin = -np.linalg.solve(scene.image_from_camera[:, :3], scene.image_from_camera[:, 3])
    falling = float(ray @ up)
    height = float((origin - center) @ up) + scene.lidar_height_m
    if falling >= -1e-3:
        return None
    depth = float(origin[2] + ray[2] * height / -falling) + _SEEN_TO_CENTER * size[0]
    return float(np.clip(depth, _NEAREST_M, _FARTHEST_M))


def _returns_of(view: _View, depth_m: float, name: str) -> Float64[np.ndarray, " returns"]:
    """Depths [m] of the returns of the object: the densest near layer inside the image box."""
    scene, box = view.scene, view.box
    margin = np.array([0.12, 0.08]) * (box[2:] - box[:2])
    is_inside = (scene.pixels > box[:2] + margin) & (scene.pixels < box[2:] - margin)
    points = scene.points[is_inside.all(axis=1)]
    depths = points @ scene.camera_from_level[2, :3] + scene.camera_from_level[2, 3]
    depths = np.sort(depths[np.abs(depths - depth_m) < 0.35 * depth_m + 2.0])
    if len(depths) == 0:
        return depths
    thickness = _THICKNESS_M.get(name, _THIN_M)
    count = np.searchsorted(depths, depths + thickness, "right") - np.arange(len(depths))
    first = int(np.argmax(count - 0.01 * np.arange(len(depths))))
    return depths[first : first + int(count[first])]


def _misfit(view: _View, guesses: _Guesses, name: str) -> Float64[np.ndarray, " yaws"]:
    """Negative log likelihood of each guess: shape of the box, road, and yaws along the street."""
    box, scene = view.box, view.scene
    seen = _project(view, guesses)
    spread = 0.08 * (box[3] - box[1]) + 2.0
    cost = np.zeros(len(seen))
    if not (view.at_left or view.at_right):
        cost += ((seen[:, 2] - seen[:, 0] - box[2] + box[0]) / spread) ** 2 / 2
    if not view.at_bottom:
        cost += ((seen[:, 3] - seen[:, 1] - box[3] + box[1]) / spread) ** 2 / 2
    above = (guesses.bottoms - scene.camera_from_level[:3, 3]) @ scene.camera_from_level[:3, 2]
    above = above + scene.lidar_height_m
    cost += _ROAD_WEIGHT * (above / (_HORIZON_SPREAD * guesses.bottoms[:, 2] + 0.15)) ** 2 / 2
    if name != "Pedestrian":
        away = np.abs((guesses.yaws + math.pi / 2) % math.pi - math.pi / 2)
        cost -= np.log(0.8 * np.exp(-((away / math.radians(8)) ** 2) / 2) + 0.06)
    return cost


def _to_level(
    scene: Scene, guesses: _Guesses, best: int, size: Float64[np.ndarray, "3"]
) -> Float64[np.ndarray, "7"]:
    """Box of a guess in the level LiDAR frame."""
    rotation, shift = scene.camera_from_level[:3, :3], scene.camera_from_level[:3, 3]
    bottom = rotation.T @ (guesses.bottoms[best] - shift)
    center = bottom + np.array([0.0, 0.0, size[2] / 2])
    return np.concatenate((center, size, guesses.yaws[best : best + 1]))
