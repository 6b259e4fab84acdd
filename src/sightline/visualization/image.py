"""Boxes and LiDAR points on the camera's image."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.geometry.transforms import transform_points
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import put_lines, put_points, put_polygon, scale_of
from sightline.visualization.clipping import clip_polygon, clip_segments, view_planes
from sightline.visualization.colors import DEPTH_SCALE, RGB, ColorScale, class_color
from sightline.visualization.lettering import Tag, put_tags

# Corner numbers as Boxes3D.corners() gives them.
_EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
_FRONT = np.array([0, 1, 5, 4])
_TAG_HEIGHT_PX = 9


def camera_picture(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    """The sample's image; black where there is none."""
    if sample.image is None:
        return np.zeros((*sample.image_size, 3), np.uint8)
    return np.ascontiguousarray(sample.image.permute(1, 2, 0).cpu().numpy())


def sweep_picture(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    """The sample's points by their range, on black."""
    black = np.zeros((*sample.image_size, 3), np.uint8)
    if sample.points is None:
        return black
    return draw_points(black, sample.points, sample.calibration)


def draw_boxes2d(
    picture: UInt8[np.ndarray, "height width 3"],
    boxes: Boxes2D,
    class_names: Sequence[str],
    *,
    scores: Float[Tensor, " num_boxes"] | None = None,
    color: RGB | None = None,
    tags: bool = True,
) -> UInt8[np.ndarray, "height width 3"]:
    """The RGB picture with the boxes' outlines in the colours of their classes.

    Args:
        picture: Is left as it is.
        boxes: In pixels of the picture.
        class_names: One for each box.
        scores: Written behind the class, if given.
        color: One for all boxes instead.
        tags: Whether the classes are written at the boxes; larger boxes first where it is narrow.
            DontCare regions are never named.
    """
    canvas = picture.copy()
    scale = scale_of(canvas)
    rows = boxes.tensor.detach().cpu().double().numpy()
    order = np.argsort(-boxes.area().detach().cpu().double().numpy(), kind="stable")
    named: list[Tag] = []
    for index in order.tolist():
        name = class_names[index]
        x_min, y_min, x_max, y_max = rows[index].tolist()
        corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
        # A homogeneous 1 makes pixels of them: boxes far outside are cut like all else.
        homogeneous = np.concatenate((corners, np.ones((4, 1))), axis=1)
        outline = np.stack((homogeneous, np.roll(homogeneous, -1, axis=0)), axis=1)
        segments = clip_segments(outline, view_planes(canvas.shape[:2]))
        chosen = color or class_color(name)
        opacity = 0.7 if name == "DontCare" else 1.0
        put_lines(canvas, segments, chosen, width_px=round(scale), halo=True, opacity=opacity)
        if name != "DontCare" and len(segments):
            text = name if scores is None else f"{name} {float(scores[index]):.2f}"
            named.append(Tag(text=text, color=chosen, box=(x_min, y_min, x_max, y_max)))
    if tags:
        put_tags(canvas, named, height_px=round(_TAG_HEIGHT_PX * max(scale, 1.0)))
    return canvas


def draw_boxes3d(
    picture: UInt8[np.ndarray, "height width 3"],
    boxes: Boxes3D,
    class_names: Sequence[str],
    calibration: Calibration,
    *,
    scores: Float[Tensor, " num_boxes"] | None = None,
    color: RGB | None = None,
    tags: bool = True,
) -> UInt8[np.ndarray, "height width 3"]:
    """The RGB picture with the projected boxes, the front face of each filled.

    Edges are cut where they pass the camera, so a box beside it is drawn right; a box behind the
    camera, or of no size, is not drawn. Nearer boxes cover farther ones.

    Args:
        picture: Is left as it is.
        boxes: LiDAR frame.
        class_names: One for each box.
        calibration: Of the picture, at its size.
        scores: Written behind the class, if given.
        color: One for all boxes instead.
        tags: Whether the classes are written at the boxes, nearest first where it is narrow.
    """
    canvas = picture.copy()
    scale = scale_of(canvas)
    planes = view_planes(canvas.shape[:2])
    corners = boxes.corners().detach().cpu().double()
    flat = transform_points(calibration.image_from_lidar, corners.reshape(-1, 3))
    homogeneous = flat.reshape(-1, 8, 3).numpy()
    has_size = (boxes.sizes > 0).all(dim=-1).cpu().numpy()
    order = np.argsort(-homogeneous[..., 2].mean(axis=1), kind="stable")
    named: list[Tag] = []
    for index in order[has_size[order]].tolist():
        segments = clip_segments(homogeneous[index][_EDGES], planes)
        if len(segments) == 0:
            continue
        name = class_names[index]
        chosen = color or class_color(name)
        front = clip_polygon(homogeneous[index][_FRONT], planes)
        put_polygon(canvas, front, chosen, opacity=0.25)
        put_lines(canvas, segments, chosen, width_px=round(scale), halo=True)
        x_min, y_min = segments.min(axis=(0, 1)).tolist()
        x_max, y_max = segments.max(axis=(0, 1)).tolist()
        text = name if scores is None else f"{name} {float(scores[index]):.2f}"
        named.append(Tag(text=text, color=chosen, box=(x_min, y_min, x_max, y_max)))
    if tags:
        put_tags(canvas, named[::-1], height_px=round(_TAG_HEIGHT_PX * max(scale, 1.0)))
    return canvas


def draw_points(
    picture: UInt8[np.ndarray, "height width 3"],
    points: Float[Tensor, "num_points fields"],
    calibration: Calibration,
    *,
    scale: ColorScale = DEPTH_SCALE,
    diameter_px: float | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """The RGB picture with the LiDAR points in front of the camera, coloured by their range.

    Args:
        picture: Is left as it is.
        points: LiDAR frame: x, y, z first.
        calibration: Of the picture, at its size.
        scale: Colours of the ranges (distance from the LiDAR).
        diameter_px: Of a point; by the picture's width if not given. Nearer points cover farther.
    """
    canvas = picture.copy()
    xyz = points[:, :3].detach().cpu()
    projected = project_points(xyz, calibration)
    visible = projected.in_image((canvas.shape[0], canvas.shape[1]))
    ranges = xyz[visible].norm(dim=1).numpy()
    order = np.argsort(-ranges, kind="stable")
    put_points(
        canvas,
        projected.pixels[visible].numpy()[order],
        scale.colors(ranges[order]),
        diameter_px=diameter_px or 2.6 * scale_of(canvas),
    )
    return canvas
