"""Boxes and LiDAR points on the camera's image."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.geometry.transforms import transform_points
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import (
    copied,
    put_lines,
    put_picture_within,
    put_points,
    put_polygon,
    scale_of,
)
from sightline.visualization.clipping import clip_polygon, clip_segments, view_planes
from sightline.visualization.colors import (
    DEPTH_SCALE,
    RGB,
    BoxStyle,
    ColorScale,
    check_columns,
    class_color,
)
from sightline.visualization.lettering import Tag, put_tags

# Indices of corners from Boxes3D.corners().
_EDGES = np.array(
    [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)
_FACES = np.array(
    [[0, 1, 5, 4], [2, 3, 7, 6], [3, 0, 4, 7], [1, 2, 6, 5], [4, 5, 6, 7], [0, 1, 2, 3]]
)
"""Front, rear, left, right, top, bottom."""
_FRONT = _FACES[0]
_EDGE_FACES = np.array([[set(edge) <= set(face) for face in _FACES.tolist()] for edge in _EDGES])
"""Mask of the faces that meet in each edge."""
_CORNER_SHARE, _CORNER_PX = 0.3, 16.0  # maximum length of a side drawn from each corner
_COVERING = 0.75  # opacity of a nearer box over a farther one
_DASH_PX = 5.0
TAG_HEIGHT_PX: Final = 9


@named_arguments
def camera_picture(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    """Image of the sample; black without a camera."""
    if sample.image is None:
        return np.zeros((*sample.image_size, 3), np.uint8)
    return np.ascontiguousarray(sample.image.permute(1, 2, 0).cpu().numpy())


@named_arguments
def sweep_picture(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    """Points of the sample in the image, coloured by range, on black."""
    black = np.zeros((*sample.image_size, 3), np.uint8)
    if sample.points is None:
        return black
    return draw_points(black, sample.points, sample.calibration)


@named_arguments
def draw_boxes2d(
    picture: UInt8[np.ndarray, "height width 3"],
    boxes: Boxes2D,
    class_names: Sequence[str],
    *,
    scores: Float[Tensor, " num_boxes"] | None = None,
    color: RGB | None = None,
    tags: bool = True,
    corners_only: bool = False,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the outlines of 2D boxes in the colours of their classes on a copy of an RGB picture.

    Boxes of NaN, those of objects outside the image, are left out.

    Args:
        picture: The picture; not changed.
        boxes: Boxes in pixels of the picture.
        class_names: Class name of each box.
        scores: Scores to write after the class names.
        color: Colour of all boxes, instead of their classes' colours.
        tags: Whether to write the class names at the boxes, larger boxes first; DontCare regions
            never have one.
        corners_only: Whether to draw strong corners instead of whole outlines, which leaves room
            for 3D boxes of the same objects.

    Raises:
        ValueError: There is not one class name or score for each box, or the picture has another
            type or shape.
    """
    check_columns(len(boxes), class_names=class_names, scores=scores)
    canvas = copied(picture)
    scale = scale_of(canvas)
    rows = boxes.tensor.detach().cpu().double().numpy()
    order = np.argsort(-boxes.area().detach().cpu().double().numpy(), kind="stable")
    named: list[Tag] = []
    is_placed = np.isfinite(rows).all(axis=1)
    for index in order[is_placed[order]].tolist():
        name = class_names[index]
        x_min, y_min, x_max, y_max = rows[index].tolist()
        corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
        # As homogeneous points, so that boxes far outside are clipped.
        homogeneous = np.concatenate((corners, np.ones((4, 1))), axis=1)
        outline = np.stack((homogeneous, np.roll(homogeneous, -1, axis=0)), axis=1)
        if corners_only:
            outline = _ends(outline, _CORNER_PX * scale)
        segments = clip_segments(outline, view_planes(canvas.shape[:2]))
        chosen = color or class_color(name)
        opacity = 0.7 if name == "DontCare" else 1.0
        width_px = round(2 * scale) if corners_only else round(scale)
        put_lines(canvas, segments, chosen, width_px=width_px, halo=True, opacity=opacity)
        if name != "DontCare" and len(segments):
            text = name if scores is None else f"{name} {float(scores[index]):.2f}"
            named.append(Tag(text=text, color=chosen, box=(x_min, y_min, x_max, y_max)))
    if tags:
        put_tags(canvas, named, height_px=round(TAG_HEIGHT_PX * max(scale, 1.0)))
    return canvas


@named_arguments
def draw_boxes3d(
    picture: UInt8[np.ndarray, "height width 3"],
    boxes: Boxes3D,
    class_names: Sequence[str],
    calibration: Calibration,
    *,
    scores: Float[Tensor, " num_boxes"] | None = None,
    color: RGB | None = None,
    tags: bool = True,
    styles: Sequence[BoxStyle] | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw projected 3D boxes, with filled visible front faces, on a copy of an RGB picture.

    Only edges of visible faces are drawn; all edges if the camera is inside the box. Edges are
    clipped at the camera, so a box beside it is drawn correctly; a box behind the camera, of NaN or
    without a size is not drawn. Farther boxes are faint inside nearer ones.

    Args:
        picture: The picture; not changed.
        boxes: Boxes in the LiDAR frame.
        class_names: Class name of each box.
        calibration: Calibration for the picture's size.
        scores: Scores to write after the class names.
        color: Colour of all boxes, instead of their classes' colours.
        tags: Whether to write the class names at the boxes, nearest first.
        styles: Style of each box. None: filled, with full edges.

    Raises:
        ValueError: There is not one class name, score or style for each box, or the picture has
            another type or shape.
    """
    check_columns(len(boxes), class_names=class_names, scores=scores, styles=styles)
    styles = styles or [BoxStyle()] * len(boxes)
    canvas = copied(picture)
    scale = scale_of(canvas)
    planes = view_planes(canvas.shape[:2])
    corners = boxes.corners().detach().cpu().double()
    flat = transform_points(calibration.image_from_lidar, corners.reshape(-1, 3))
    homogeneous = flat.reshape(-1, 8, 3).numpy()
    sees_face = _visible_faces(boxes, calibration)
    sees_edge = (sees_face @ _EDGE_FACES.T) | ~sees_face.any(axis=1, keepdims=True)
    is_placed = np.isfinite(homogeneous).all(axis=(1, 2))
    is_drawn = is_placed & (boxes.sizes > 0).all(dim=-1).cpu().numpy()
    order = np.argsort(-homogeneous[..., 2].mean(axis=1), kind="stable")
    named: list[Tag] = []
    for index in order[is_drawn[order]].tolist():
        segments = clip_segments(homogeneous[index][_EDGES[sees_edge[index]]], planes)
        if len(segments) == 0:
            continue
        name = class_names[index]
        chosen = color or class_color(name)
        put_picture_within(canvas, picture, segments.reshape(-1, 2), opacity=_COVERING)
        if sees_face[index, 0] and styles[index].is_filled:
            front = clip_polygon(homogeneous[index][_FRONT], planes)
            put_polygon(canvas, front, chosen, opacity=0.25)
        dash_px = _DASH_PX * scale if styles[index].is_dashed else None
        put_lines(canvas, segments, chosen, width_px=round(scale), halo=True, dash_px=dash_px)
        x_min, y_min = segments.min(axis=(0, 1)).tolist()
        x_max, y_max = segments.max(axis=(0, 1)).tolist()
        text = name if scores is None else f"{name} {float(scores[index]):.2f}"
        named.append(Tag(text=text, color=chosen, box=(x_min, y_min, x_max, y_max)))
    if tags:
        put_tags(canvas, named[::-1], height_px=round(TAG_HEIGHT_PX * max(scale, 1.0)))
    return canvas


@named_arguments
def draw_detections(
    picture: UInt8[np.ndarray, "height width 3"],
    detections2d: Detections2D | None,
    detections3d: Detections3D | None,
    calibration: Calibration,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw detections with scores: 3D boxes, and 2D boxes over them, then as corners only.

    Returns:
        A new picture.
    """
    if detections3d is not None:
        picture = draw_boxes3d(
            picture,
            detections3d.boxes,
            detections3d.class_names,
            calibration,
            scores=detections3d.scores,
            tags=detections2d is None,
        )
    if detections2d is not None:
        picture = draw_boxes2d(
            picture,
            detections2d.boxes,
            detections2d.class_names,
            scores=detections2d.scores,
            corners_only=detections3d is not None,
        )
    return picture


def _visible_faces(
    boxes: Boxes3D, calibration: Calibration
) -> Bool[np.ndarray, "num_boxes num_faces"]:
    """Find the faces, in the order of `_FACES`, that have the camera's centre on their outside."""
    image_from_lidar = calibration.image_from_lidar
    centre = -torch.linalg.solve(image_from_lidar[:, :3], image_from_lidar[:, 3])
    exact = Boxes3D(boxes.tensor.detach().cpu().double())
    x, y, z = exact.to_canonical(centre.cpu()[None])[:, 0].unbind(dim=1)
    length, width, height = (exact.sizes / 2).unbind(dim=1)
    outside = (x > length, -x > length, y > width, -y > width, z > height, -z > height)
    return torch.stack(outside, dim=1).numpy()


def _ends(
    outline: Float[np.ndarray, "num_sides 2 3"], length_px: float
) -> Float[np.ndarray, "twice_as_many 2 3"]:
    """End pieces of each side of a box."""
    start, end = outline[:, 0], outline[:, 1]
    along = end - start
    whole = np.linalg.norm(along, axis=1, keepdims=True).clip(min=1e-9)
    reach = along * np.minimum(_CORNER_SHARE, length_px / whole)
    return np.concatenate(
        (np.stack((start, start + reach), axis=1), np.stack((end - reach, end), axis=1))
    )


@named_arguments
def draw_points(
    picture: UInt8[np.ndarray, "height width 3"],
    points: Float[Tensor, "num_points fields"],
    calibration: Calibration,
    *,
    scale: ColorScale = DEPTH_SCALE,
    diameter_px: float | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw LiDAR points, coloured by range, on a copy of an RGB picture; nearer points on top.

    Args:
        picture: The picture; not changed.
        points: Points in the LiDAR frame: x, y, z first.
        calibration: Calibration for the picture's size.
        scale: Colours of the ranges (distance from the LiDAR).
        diameter_px: Diameter of a point. None: from the picture's width.

    Raises:
        ValueError: The picture has another type or shape.
    """
    canvas = copied(picture)
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
