"""Bird's-eye view of a frame."""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import unproject_pixels
from sightline.geometry.wrong_types import named_arguments, named_fields
from sightline.visualization.canvas import put_lines, put_points, put_polygon
from sightline.visualization.colors import RGB, BoxStyle, check_columns, class_color
from sightline.visualization.lettering import put_text, text_width

_BACKGROUND: RGB = (17, 19, 24)
_IN_VIEW: RGB = (150, 165, 190)
_RING: RGB = (64, 70, 80)
_RING_TEXT: RGB = (150, 156, 166)
_EGO: RGB = (235, 235, 235)
_RING_STEP_M = 10
_DASH_PX = 3.0
_EGO_SIZE_M = (4.0, 1.8)
_ROAD_SHARE = 0.05  # share of the points below the height drawn as the road
_BRIGHTEST_M = 2.5  # height above the road with the brightest colour


@named_fields
@dataclass(frozen=True, kw_only=True)
class BirdsEyeView:
    """Rectangle of the LiDAR frame's ground plane in a picture: x up, y to the left."""

    x_min_m: float = -4.0
    x_max_m: float = 76.0
    y_min_m: float = -22.0
    y_max_m: float = 22.0
    pixels_per_m: float = 14.0

    def __post_init__(self) -> None:
        """Check that the rectangle is not empty."""
        # Written so that NaN, which compares false with everything, is refused.
        has_area = self.x_min_m < self.x_max_m and self.y_min_m < self.y_max_m
        if not (has_area and self.pixels_per_m > 0) or not all(map(math.isfinite, astuple(self))):
            raise ValueError(
                "a bird's-eye view needs x_min_m < x_max_m, y_min_m < y_max_m and pixels_per_m "
                f"above 0, all finite, got {self}"
            )
        if min(self.picture_size) < 1:
            raise ValueError(
                f"a bird's-eye view needs at least one pixel along each side, got {self}; raise "
                "pixels_per_m"
            )

    @property
    def picture_size(self) -> tuple[int, int]:
        """Height, width [px]."""
        height = round((self.x_max_m - self.x_min_m) * self.pixels_per_m)
        return height, round((self.y_max_m - self.y_min_m) * self.pixels_per_m)

    def pixels(self, xy: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Positions in the picture, (column, row), of points x, y [m] of the LiDAR frame."""
        column = (self.y_max_m - xy[..., 1]) * self.pixels_per_m - 0.5
        row = (self.x_max_m - xy[..., 0]) * self.pixels_per_m - 0.5
        return np.stack((column, row), axis=-1)


@named_arguments
def draw_birds_eye(
    points: Float[Tensor, "num_points fields"] | None,
    boxes: Boxes3D | None = None,
    class_names: Sequence[str] = (),
    *,
    calibration: Calibration | None = None,
    image_size: tuple[int, int] | None = None,
    view: BirdsEyeView | None = None,
    color: RGB | None = None,
    styles: Sequence[BoxStyle] | None = None,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw points, boxes with headings, range rings and the camera's field of view from above.

    Args:
        points: Points in the LiDAR frame, x, y, z first; higher points are brighter.
        boxes: Boxes in the LiDAR frame; boxes of NaN or without a size are left out. A line leads
            from the centre through the front, which is drawn stronger.
        class_names: Class name of each box.
        calibration: Calibration; with `image_size`, the camera's field of view is drawn.
        image_size: Height, width [px] of the camera.
        view: Drawn area and scale.
        color: Colour of all boxes, instead of their classes' colours.
        styles: Style of each box. None: filled, with full edges.

    Raises:
        ValueError: There is not one class name or style for each box.
    """
    view = view or BirdsEyeView()
    canvas = np.full((*view.picture_size, 3), _BACKGROUND, np.uint8)
    if calibration is not None and image_size is not None:
        _put_field_of_view(canvas, view, calibration, image_size)
    _put_rings(canvas, view)
    if points is not None:
        _put_cloud(canvas, view, points)
    _put_ego(canvas, view)
    if boxes is not None:
        put_boxes_from_above(canvas, view, boxes, class_names, color=color, styles=styles)
    _put_ring_labels(canvas, view)
    return canvas


@named_arguments
def put_boxes_from_above(
    canvas: UInt8[np.ndarray, "height width 3"],
    view: BirdsEyeView,
    boxes: Boxes3D,
    class_names: Sequence[str],
    *,
    color: RGB | None = None,
    styles: Sequence[BoxStyle] | None = None,
) -> None:
    """Draw boxes into an existing bird's-eye view.

    Args:
        canvas: The view's picture.
        view: Drawn area and scale.
        boxes: Boxes in the LiDAR frame.
        class_names: Class name of each box.
        color: Colour of all boxes, instead of their classes' colours.
        styles: Style of each box. None: filled, with full edges.

    Raises:
        ValueError: There is not one class name or style for each box.
    """
    check_columns(len(boxes), class_names=class_names, styles=styles)
    styles = styles or [BoxStyle()] * len(boxes)
    has_size = (boxes.sizes > 0).all(dim=-1).tolist()
    corners = boxes.corners()[:, :4, :2].detach().cpu().double().numpy()
    for name, outline, drawn, style in zip(class_names, corners, has_size, styles, strict=True):
        # Far outside the view fixed-point coordinates would overflow.
        if not drawn or not np.abs(outline).max() <= 10_000:  # false for NaN
            continue
        chosen = color or class_color(name)
        ring = view.pixels(outline)
        middle, front = ring.mean(axis=0), ring[:2].mean(axis=0)
        tip = front + 0.5 * (front - middle)
        if style.is_filled:
            put_polygon(canvas, ring, chosen, opacity=0.3)
        sides = np.stack((ring, np.roll(ring, -1, axis=0)), axis=1)
        put_lines(canvas, sides, chosen, dash_px=_DASH_PX if style.is_dashed else None)
        put_lines(canvas, np.stack((ring[:2], np.stack((front, tip)))), chosen, width_px=2)


def _put_field_of_view(
    canvas: UInt8[np.ndarray, "height width 3"],
    view: BirdsEyeView,
    calibration: Calibration,
    image_size: tuple[int, int],
) -> None:
    height, width = image_size
    middle = (height - 1) / 2
    edges = torch.tensor([[-0.5, middle], [width - 0.5, middle]], dtype=torch.float64)
    # Borders of the field of view, from next to the camera to beyond the picture.
    near = unproject_pixels(edges, torch.full((2,), 0.01, dtype=torch.float64), calibration)
    far = unproject_pixels(edges, torch.full((2,), 300.0, dtype=torch.float64), calibration)
    corners = view.pixels(torch.cat((near, far.flip(0)))[:, :2].numpy())
    put_polygon(canvas, corners, _IN_VIEW, opacity=0.07)
    put_lines(canvas, corners[[[0, 3], [1, 2]]], _IN_VIEW, opacity=0.5)


def _ring_ranges(view: BirdsEyeView) -> range:
    return range(_RING_STEP_M, int(view.x_max_m) + 1, _RING_STEP_M)


def _put_rings(canvas: UInt8[np.ndarray, "height width 3"], view: BirdsEyeView) -> None:
    # OpenCV draws circles with few corners, which is visible on large ones.
    turn = np.linspace(0, 2 * np.pi, 721)
    unit = np.stack((np.cos(turn), np.sin(turn)), axis=-1)
    for range_m in _ring_ranges(view):
        ring = view.pixels(range_m * unit)
        put_lines(canvas, np.stack((ring[:-1], ring[1:]), axis=1), _RING)


def _put_ring_labels(canvas: UInt8[np.ndarray, "height width 3"], view: BirdsEyeView) -> None:
    """Label the rings on plates, ahead on the right or at the picture's border."""
    for range_m in _ring_ranges(view):
        text = f"{range_m} m"
        width = text_width(text, 9)
        side = np.deg2rad(-52.0)
        position = view.pixels(range_m * np.array([np.cos(side), np.sin(side)]))
        if position[0] + width > canvas.shape[1] - 4:  # the ring is outside the picture there
            y = -min(range_m, -view.y_min_m - (width + 8) / view.pixels_per_m)
            if y > range_m:  # the whole picture is to the left of the ring
                continue
            position = view.pixels(np.array([np.sqrt(range_m**2 - y**2), y]))
        left = round(float(position[0])) + 4
        baseline = max(round(float(position[1])) - 4, 13)  # else the upper edge would cut the label
        if left < 3:  # the ring is to the right of the picture, or there is no room
            continue
        plate = canvas[baseline - 12 : baseline + 4, left - 3 : left + width + 3]
        plate[:] = np.rint(0.7 * np.array(_BACKGROUND) + 0.3 * plate)
        put_text(canvas, text, left, baseline, height_px=9, color=_RING_TEXT)


def _put_cloud(
    canvas: UInt8[np.ndarray, "height width 3"],
    view: BirdsEyeView,
    points: Float[Tensor, "num_points fields"],
) -> None:
    xyz = points[:, :3].detach().cpu().double().numpy()
    pixels = view.pixels(xyz[:, :2])
    inside = ((pixels > -1) & (pixels < np.array(canvas.shape[1::-1]))).all(axis=1)
    xyz, pixels = xyz[inside], pixels[inside]
    order = np.argsort(xyz[:, 2], kind="stable")
    z = xyz[order, 2]
    road_m = z[int(_ROAD_SHARE * len(z))] if len(z) else 0.0
    height_share = np.clip((z - road_m) / _BRIGHTEST_M, 0, 1)
    low, high = np.array([70.0, 78.0, 92.0]), np.array([232.0, 236.0, 240.0])
    colors = np.rint(low + height_share[:, None] * (high - low)).astype(np.uint8)
    put_points(canvas, pixels[order], colors, diameter_px=1.7)


def _put_ego(canvas: UInt8[np.ndarray, "height width 3"], view: BirdsEyeView) -> None:
    """Draw a chevron at the LiDAR that points ahead, as long as a car."""
    length, width = _EGO_SIZE_M
    outline = np.array([[length / 2, 0.0], [-length / 2, width / 2], [-length / 4, 0.0]])
    left = view.pixels(outline)
    right = view.pixels(outline * np.array([1.0, -1.0]))
    put_polygon(canvas, left, _EGO, opacity=0.95)
    put_polygon(canvas, right, _EGO, opacity=0.95)
