"""3D boxes of image boxes: class size, road plane, a regression, and returns if there are any.

The distance of an object follows from the height of its image box, as the class's height is known,
and from the box's lower edge, which stands on the road; the geometric mean of that and of a fitted
regression (`ranges`) is taken. Returns within the image box decide where
there are some. Roads are taken as flat, and objects as parallel to the camera's view if the shape
of their box does not say otherwise.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from sightline.joining.evidence import logit
from sightline.joining.ranges import BORDER_PX, predict_ranges, range_columns, read_ranges
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
_LOWEST_CAMERA_M: Final = 0.3
_SAME_HEIGHT_M: Final = 0.5
_RETURN_ERROR_M: Final = 0.35
_FEW_RETURNS_ERROR_M: Final = 0.6
_FEW_RETURNS: Final = 2
_NEAREST_M, _FARTHEST_M = 2.0, 90.0
_NEAREST_DEPTH_M: Final = 0.3
_SEEN_TO_CENTER: Final = 0.3  # shares of the length between the seen edge and the centre
_THICKNESS_M: Final = {"Car": 1.5}
_THIN_M: Final = 0.6
_ROAD_WEIGHT: Final = 0.3  # of the road in the choice of the yaw
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
    """Camera and the image boxes of one class to explain."""

    scene: Scene
    boxes: Float64[np.ndarray, "num_boxes 4"]
    focal_px: float
    at_left: Bool[np.ndarray, " num_boxes"]
    at_right: Bool[np.ndarray, " num_boxes"]
    at_bottom: Bool[np.ndarray, " num_boxes"]


class _Guesses(NamedTuple):
    """Boxes of one size at several yaws for each image box, in the camera frame."""

    yaws: Float64[np.ndarray, " yaws"]
    offsets: Float64[np.ndarray, "yaws 8 3"]
    """Corners [m], seen from the bottom's centre."""
    bottoms: Float64[np.ndarray, "num_boxes yaws 3"]
    """Centres of the bottoms [m]."""


def lift(scene: Scene, indices: Sequence[int]) -> dict[int, Lifted]:
    """Lift boxes of the image detector, each at the yaw that explains its shape best."""
    lifted: dict[int, Lifted] = {}
    for name in sorted({scene.image.names[index] for index in indices}):
        of_class = [index for index in indices if scene.image.names[index] == name]
        lifted |= zip(of_class, _lift_class(scene, of_class, name), strict=True)
    return {index: lifted[index] for index in indices}


def scene_columns(scene: Scene, indices: Sequence[int]) -> Float64[np.ndarray, "num_boxes 18"]:
    """Compute `RANGE_COLUMNS` for image boxes of a scene."""
    return _columns(_view(scene, scene.image.in_image[list(indices)]))


def _view(scene: Scene, boxes: Float64[np.ndarray, "num_boxes 4"]) -> _View:
    height, width = scene.image_size
    return _View(
        scene=scene,
        boxes=boxes,
        focal_px=float(scene.image_from_camera[0, 0]),
        at_left=boxes[:, 0] <= BORDER_PX,
        at_right=boxes[:, 2] >= width - 1 - BORDER_PX,
        at_bottom=boxes[:, 3] >= height - 1 - BORDER_PX,
    )


def _columns(view: _View) -> Float64[np.ndarray, "num_boxes 18"]:
    scene, road_m = view.scene, _depth_on_road(view, 0.0)
    return range_columns(view.boxes, scene.image_size, scene.image_from_camera, road_m)


def _lift_class(scene: Scene, indices: list[int], name: str) -> list[Lifted]:
    boxes = scene.image.in_image[indices]
    view = _view(scene, boxes)
    size = np.array(_SIZES_LWH[name])
    on_road = _depth_on_road(view, _SEEN_TO_CENTER * size[0])
    guesses = _by_height(view, _first_guesses(view, name, size))
    ends_below = view.at_bottom & np.isfinite(on_road)  # of what is seen
    nearer = np.minimum(on_road[:, None] / guesses.bottoms[..., 2], 1.0)
    nearer = np.where(ends_below[:, None], nearer, 1.0)
    guesses = guesses._replace(bottoms=guesses.bottoms * nearer[..., None])
    depths = guesses.bottoms[..., 2].copy()
    precision = (_HEIGHT_SPREAD * depths) ** -2.0
    total = precision * depths
    error_m = np.maximum(_HORIZON_SPREAD * on_road**2 / _eye_height_m(scene), _MIN_GROUND_ERROR_M)
    on_ground = np.where(np.isfinite(on_road) & ~view.at_bottom, error_m**-2.0, 0.0)[:, None]
    precision = precision + on_ground
    total = total + np.nan_to_num(on_road)[:, None] * on_ground
    learned = predict_ranges(_columns(view), read_ranges()[name])
    total = np.sqrt(total * precision * learned[:, None])  # the geometric mean of both distances
    corners = np.sort(guesses.bottoms[:, :, None, 2] + guesses.offsets[..., 2], axis=2)
    behind = depths - corners[..., :4].mean(axis=2)  # of the centre, behind what is seen
    for row, depth in enumerate(depths.mean(axis=1)):
        returns = _returns_of(scene, boxes[row], float(depth), name)
        if len(returns):
            error = _RETURN_ERROR_M if len(returns) > _FEW_RETURNS else _FEW_RETURNS_ERROR_M
            precision[row] += error**-2.0
            total[row] += (np.median(returns) + behind[row]) * error**-2.0
    fused = total / precision
    guesses = guesses._replace(bottoms=guesses.bottoms * (fused / depths)[..., None])
    guesses = guesses._replace(bottoms=_match(view, guesses))
    misfit = _misfit(view, guesses, name)
    rows, best = np.arange(len(boxes)), misfit.argmin(axis=1)
    error_m, range_m = precision[rows, best] ** -0.5, fused[rows, best]
    evidence = np.stack(
        (
            logit(scene.image.scores[indices]),
            np.log(range_m),
            np.log(error_m / range_m),
            np.log1p(scene.image.num_points[indices]),
            np.log1p(misfit[rows, best]),
            (view.at_left | view.at_right | view.at_bottom).astype(float),
        ),
        axis=1,
    )
    found = _to_level(scene, guesses.bottoms[rows, best], guesses.yaws[best], size)
    return [Lifted(*each) for each in zip(found, error_m.tolist(), evidence, strict=True)]


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
    matrix = view.scene.image_from_camera
    depths = view.focal_px * size[2] / _heights(view) + size[0] / 4
    middles = _bottom_middles(view) * depths[:, None]
    bottoms = np.linalg.solve(matrix[:, :3], (middles - matrix[:, 3]).T).T
    return _Guesses(yaws, turned @ rotation.T, np.repeat(bottoms[:, None], count, axis=1))


def _heights(view: _View) -> Float64[np.ndarray, " num_boxes"]:
    """Heights of the image boxes [px]."""
    return np.asarray(np.maximum(view.boxes[:, 3] - view.boxes[:, 1], 2.0))


def _bottom_middles(view: _View) -> Float64[np.ndarray, "num_boxes 3"]:
    """Homogeneous pixels of the middles of the lower edges."""
    boxes = view.boxes
    return np.stack(((boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3], np.ones(len(boxes))), axis=1)


def _project(view: _View, guesses: _Guesses) -> Float64[np.ndarray, "num_boxes yaws 4"]:
    """Bounds of the boxes [px], not cut at the image's border."""
    matrix = view.scene.image_from_camera
    corners = guesses.bottoms[:, :, None] + guesses.offsets
    homogeneous = corners @ matrix[:, :3].T + matrix[:, 3]
    pixels = homogeneous[..., :2] / np.maximum(homogeneous[..., 2:], _NEAREST_DEPTH_M)
    return np.concatenate((pixels.min(axis=2), pixels.max(axis=2)), axis=2)


def _match(view: _View, guesses: _Guesses) -> Float64[np.ndarray, "num_boxes yaws 3"]:
    """Move boxes sideways and up until their middle and lower edge are those of the image box."""
    moved = guesses.bottoms.copy()
    x_min, y_min, x_max, y_max = view.boxes.T[:, :, None]
    from_right = (view.at_left & ~view.at_right)[:, None]
    from_left = (view.at_right & ~view.at_left)[:, None]
    for _ in range(3):
        seen = _project(view, guesses._replace(bottoms=moved))
        scale = moved[..., 2] / view.focal_px
        middle = (x_min + x_max - seen[..., 0] - seen[..., 2]) / 2
        shift = np.where(from_left, x_min - seen[..., 0], middle)
        shift = np.where(from_right, x_max - seen[..., 2], shift)
        rise = np.where(view.at_bottom[:, None], y_min - seen[..., 1], y_max - seen[..., 3])
        moved[..., 0] += shift * scale
        moved[..., 1] += rise * scale
    return moved


def _by_height(view: _View, guesses: _Guesses) -> _Guesses:
    """Move boxes along their rays until they are as high as the image box."""
    for _ in range(6):
        seen = _project(view, guesses)
        factor = np.clip((seen[..., 3] - seen[..., 1]) / _heights(view)[:, None], 0.5, 2.0)
        depths = np.clip(guesses.bottoms[..., 2] * factor, _NEAREST_M, _FARTHEST_M)
        moved = guesses.bottoms * (depths / guesses.bottoms[..., 2])[..., None]
        guesses = guesses._replace(bottoms=moved)
        guesses = guesses._replace(bottoms=_match(view, guesses))
    return guesses


def _camera_height_m(scene: Scene) -> float:
    """Height of the camera above the road."""
    matrix, up = scene.image_from_camera, scene.camera_from_level[:3, 2]
    origin = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return float((origin - scene.camera_from_level[:3, 3]) @ up) + scene.lidar_height_m


def _eye_height_m(scene: Scene) -> float:
    """Height from which distances on the road are as sure as `_HORIZON_SPREAD` says.

    It was set for the height of KITTI's LiDAR, near that of its camera. The points' origin may also
    be far from the camera, such as on the road.
    """
    camera_m = max(_camera_height_m(scene), _LOWEST_CAMERA_M)
    is_near = abs(camera_m - scene.lidar_height_m) < _SAME_HEIGHT_M
    return scene.lidar_height_m if is_near else camera_m


def _depth_on_road(view: _View, behind_m: float) -> Float64[np.ndarray, " num_boxes"]:
    """Depths, so far behind where the boxes' lower edges stand on the road; NaN: they cannot."""
    scene, matrix = view.scene, view.scene.image_from_camera
    rays = np.linalg.solve(matrix[:, :3], _bottom_middles(view).T).T
    up = scene.camera_from_level[:3, 2]
    origin = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    falling = rays @ up
    falling = np.where(falling < -1e-3, falling, np.nan)
    height = _camera_height_m(scene)
    depths = origin[2] + rays[:, 2] * height / -falling + behind_m
    return np.asarray(np.clip(depths, _NEAREST_M, _FARTHEST_M))


def _returns_of(
    scene: Scene, box: Float64[np.ndarray, "4"], depth_m: float, name: str
) -> Float64[np.ndarray, " returns"]:
    """Depths [m] of the returns of the object: the densest near layer inside the image box."""
    margin = np.array([0.12, 0.08]) * (box[2:] - box[:2])
    (x_min, y_min), (x_max, y_max) = box[:2] + margin, box[2:] - margin
    x, y = scene.pixels.T
    near = np.flatnonzero((x > x_min) & (x < x_max))
    points = scene.points[near[(y[near] > y_min) & (y[near] < y_max)]]
    depths = points @ scene.camera_from_level[2, :3] + scene.camera_from_level[2, 3]
    depths = np.sort(depths[np.abs(depths - depth_m) < 0.35 * depth_m + 2.0])
    if len(depths) == 0:
        return depths
    thickness = _THICKNESS_M.get(name, _THIN_M)
    count = np.searchsorted(depths, depths + thickness, "right") - np.arange(len(depths))
    first = int(np.argmax(count - 0.01 * np.arange(len(depths))))
    return depths[first : first + int(count[first])]


def _misfit(view: _View, guesses: _Guesses, name: str) -> Float64[np.ndarray, "num_boxes yaws"]:
    """Negative log likelihood of each guess: shape of the box, road, and yaws along the street."""
    boxes, scene = view.boxes, view.scene
    seen = _project(view, guesses)
    sizes, given = seen[..., 2:] - seen[..., :2], (boxes[:, 2:] - boxes[:, :2])[:, None]
    spread = 0.08 * given[..., 1] + 2.0
    width, height = np.moveaxis(((sizes - given) / spread[..., None]) ** 2 / 2, 2, 0)
    cost = np.where((view.at_left | view.at_right)[:, None], 0.0, width)
    cost += np.where(view.at_bottom[:, None], 0.0, height)
    above = (guesses.bottoms - scene.camera_from_level[:3, 3]) @ scene.camera_from_level[:3, 2]
    above = above + scene.lidar_height_m
    cost += _ROAD_WEIGHT * (above / (_HORIZON_SPREAD * guesses.bottoms[..., 2] + 0.15)) ** 2 / 2
    if name != "Pedestrian":
        away = np.abs((guesses.yaws + math.pi / 2) % math.pi - math.pi / 2)
        cost -= np.log(0.8 * np.exp(-((away / math.radians(8)) ** 2) / 2) + 0.06)
    return cost


def _to_level(
    scene: Scene,
    bottoms: Float64[np.ndarray, "num_boxes 3"],
    yaws: Float64[np.ndarray, " num_boxes"],
    size: Float64[np.ndarray, "3"],
) -> Float64[np.ndarray, "num_boxes 7"]:
    """Boxes in the level LiDAR frame, by their bottoms' centres in the camera frame."""
    rotation, shift = scene.camera_from_level[:3, :3], scene.camera_from_level[:3, 3]
    centers = (bottoms - shift) @ rotation + np.array([0.0, 0.0, size[2] / 2])
    return np.column_stack((centers, np.tile(size, (len(bottoms), 1)), yaws))
