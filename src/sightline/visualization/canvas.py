"""Strokes, areas and points with sub-pixel positions, for all pictures.

`put_...` functions change the given canvas.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from sightline.structures.arrays import image_remedy
from sightline.visualization.colors import INVALID, RGB

_SHIFT = 4  # bits: OpenCV takes coordinates in sixteenths of a pixel
_HALO: RGB = (10, 10, 14)
_HALO_OPACITY = 0.55
_OVERSAMPLING = 3
_POINTS_PER_BATCH = 2**17  # a sweep of KITTI's LiDAR; drawing a point takes a kilobyte


def scale_of(canvas: UInt8[np.ndarray, "height width 3"]) -> float:
    """Scale of strokes and letters: 1 at KITTI's width of 1242 px, at most 4."""
    width = int(canvas.shape[1])
    return min(max(width / 1242, 0.75), 4.0)


def copied(picture: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """Copy an RGB picture, for drawing on it.

    Raises:
        ValueError: The array is of another type or shape.
    """
    canvas = picture.copy()
    is_array = isinstance(canvas, np.ndarray)
    if is_array and (canvas.dtype != np.uint8 or canvas.ndim != 3 or canvas.shape[2] != 3):
        raise ValueError(
            f"picture is {canvas.dtype} of shape {canvas.shape}, expected uint8 of height, width, "
            f"3; {image_remedy(canvas)}"
        )
    return canvas


def scaled_to_width(
    picture: UInt8[np.ndarray, "height width 3"], width_px: int
) -> UInt8[np.ndarray, "new_height new_width 3"]:
    """Scale a picture to a width, in its proportions."""
    height = max(round(picture.shape[0] * width_px / picture.shape[1]), 1)
    scaled = cv2.resize(picture, (width_px, height), interpolation=cv2.INTER_AREA)
    return scaled.astype(np.uint8, copy=False)


def scaled_into(
    picture: UInt8[np.ndarray, "height width 3"], size: tuple[int, int]
) -> UInt8[np.ndarray, "new_height new_width 3"]:
    """Scale a picture into an area of (height, width) in its proportions, centred."""
    zoom = min(new / old for new, old in zip(size, picture.shape[:2], strict=True))
    height, width = (max(round(side * zoom), 1) for side in picture.shape[:2])
    interpolation = cv2.INTER_AREA if zoom < 1 else cv2.INTER_NEAREST
    area = np.full((*size, 3), INVALID, np.uint8)
    top, left = (size[0] - height) // 2, (size[1] - width) // 2
    area[top : top + height, left : left + width] = cv2.resize(
        picture, (width, height), interpolation=interpolation
    )
    return area


def put_lines(
    canvas: UInt8[np.ndarray, "height width 3"],
    segments: Float[np.ndarray, "num_segments 2 2"],
    color: RGB,
    *,
    width_px: int = 1,
    halo: bool = False,
    opacity: float = 1.0,
    dash_px: float | None = None,
) -> None:
    """Draw segments of (x, y) [px].

    Args:
        canvas: The canvas.
        segments: Both ends of each segment.
        color: Colour.
        width_px: Width of the strokes.
        halo: Whether a dark halo separates them from a bright background.
        opacity: Opacity of the strokes.
        dash_px: Length of dashes and gaps. None: no gaps.
    """
    if dash_px is not None:
        segments = _dashes(segments, dash_px)
    fixed = np.rint(segments * 2**_SHIFT).astype(np.int32)
    if halo:
        target = canvas.copy()
        cv2.polylines(target, fixed, False, _HALO, width_px + 2, cv2.LINE_AA, _SHIFT)
        _blend(canvas, target, _HALO_OPACITY * opacity)
    target = canvas if opacity == 1 else canvas.copy()
    cv2.polylines(target, fixed, False, color, width_px, cv2.LINE_AA, _SHIFT)
    if opacity < 1:
        _blend(canvas, target, opacity)


def _dashes(
    segments: Float[np.ndarray, "num_segments 2 2"], dash_px: float
) -> Float[np.ndarray, "num_dashes 2 2"]:
    """Split each segment into dashes as long as the gaps between them, one dash at each end."""
    dashes = []
    for start, end in segments:
        count = 2 * int(np.linalg.norm(end - start) / (2 * dash_px)) + 1
        shares = np.linspace(0.0, 1.0, count + 1)[:, None]
        ends = start + shares * (end - start)
        dashes.append(np.stack((ends[:-1:2], ends[1::2]), axis=1))
    return np.concatenate(dashes) if dashes else segments


def put_polygon(
    canvas: UInt8[np.ndarray, "height width 3"],
    vertices: Float[np.ndarray, "num_vertices 2"],
    color: RGB,
    *,
    opacity: float,
) -> None:
    """Fill a convex polygon of (x, y) [px]."""
    if len(vertices) < 3:
        return
    filled = canvas.copy()
    fixed = np.rint(vertices * 2**_SHIFT).astype(np.int32)
    cv2.fillConvexPoly(filled, fixed, color, cv2.LINE_AA, _SHIFT)
    _blend(canvas, filled, opacity)


def put_picture_within(
    canvas: UInt8[np.ndarray, "height width 3"],
    picture: UInt8[np.ndarray, "height width 3"],
    points: Float[np.ndarray, "num_points 2"],
    *,
    opacity: float,
) -> None:
    """Put a picture over the canvas within the convex hull of points (x, y) [px]."""
    limits = np.array(canvas.shape[1::-1])
    hull = cv2.convexHull(np.rint(points.clip(-limits, 2 * limits)).astype(np.int32))
    left, top, width, height = cv2.boundingRect(hull)
    rows = slice(max(top, 0), max(top + height, 0))
    columns = slice(max(left, 0), max(left + width, 0))
    part = canvas[rows, columns]
    if part.size == 0:
        return
    mask = np.zeros(part.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, hull - np.array([columns.start, rows.start]), 1)
    mixed = cv2.addWeighted(picture[rows, columns], opacity, part, 1 - opacity, 0)
    part[mask > 0] = mixed[mask > 0]


def put_points(
    canvas: UInt8[np.ndarray, "height width 3"],
    pixels: Float[np.ndarray, "num_points 2"],
    colors: UInt8[np.ndarray, "num_points 3"],
    *,
    diameter_px: float,
) -> None:
    """Draw discs at (x, y) [px]; later points cover earlier ones."""
    height, width = canvas.shape[:2]
    layer = np.zeros((height * _OVERSAMPLING, width * _OVERSAMPLING, 4), np.uint8)
    for start in range(0, len(pixels), _POINTS_PER_BATCH):
        batch = slice(start, start + _POINTS_PER_BATCH)
        _ink_discs(layer, pixels[batch], colors[batch], diameter_px)
    small = cv2.resize(layer, (width, height), interpolation=cv2.INTER_AREA)
    covered = small[..., 3] > 0
    uncovered = 255 - small[covered, 3:].astype(np.float32)
    canvas[covered] = np.rint(small[covered, :3] + canvas[covered] * (uncovered / 255))


def _ink_discs(
    layer: UInt8[np.ndarray, "rows columns 4"],
    pixels: Float[np.ndarray, "num_points 2"],
    colors: UInt8[np.ndarray, "num_points 3"],
    diameter_px: float,
) -> None:
    """Set colour and full opacity of the discs' pixels in an oversampled layer."""
    radius = diameter_px * _OVERSAMPLING / 2
    reach = np.arange(-int(radius), int(radius) + 1)
    dy, dx = (axis.ravel() for axis in np.meshgrid(reach, reach, indexing="ij"))
    disc = dx**2 + dy**2 <= radius**2
    centers = np.floor((pixels + 0.5) * _OVERSAMPLING).astype(np.int64)
    columns = centers[:, 0, None] + dx[disc]
    rows = centers[:, 1, None] + dy[disc]
    inside = (columns >= 0) & (columns < layer.shape[1]) & (rows >= 0) & (rows < layer.shape[0])
    inked = np.concatenate((colors, np.full_like(colors[:, :1], 255)), axis=1)
    # Row by row of a points-by-disc table: numpy lets the last assignment win.
    spread = np.broadcast_to(inked[:, None], (*inside.shape, 4))
    layer[rows[inside], columns[inside]] = spread[inside]


def _blend(
    canvas: UInt8[np.ndarray, "height width 3"],
    over: UInt8[np.ndarray, "height width 3"],
    opacity: float,
) -> None:
    cv2.addWeighted(over, opacity, canvas, 1 - opacity, 0, dst=canvas)
