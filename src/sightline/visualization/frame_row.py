"""A frame and what was found in it at a glance: camera, depth and bird's-eye view in one picture.

Smaller than a sheet and always of one size, as videos and sheets of several frames need it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from jaxtyping import UInt8

from sightline.geometry.projection import sparse_depth_map
from sightline.structures.level import level_view
from sightline.structures.predictions import Perception
from sightline.structures.sample import SENSOR_TITLES, CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye
from sightline.visualization.canvas import scaled_into
from sightline.visualization.cells import MUTED, PAGE, TITLE
from sightline.visualization.colors import DEPTH_SCALE, INVALID, RGB, class_color
from sightline.visualization.depth import colorize_depth, put_legend
from sightline.visualization.image import camera_picture, draw_detections, sweep_picture
from sightline.visualization.lettering import put_text, text_width
from sightline.visualization.zoom import zoomed

_ALARM: RGB = (240, 130, 60)
_GAP_PX: Final = 10
_HEAD_PX: Final = 34
_LINE_PX: Final = 30
_WIDE: Final = 2.0  # pictures at least so many times as wide as high stand one above the other
_STACKED_PX, _BESIDE_PX = 940, 620  # widths of a camera's picture
_ABOVE_PX: Final = 300
_HIGHEST: Final = 1.5  # pictures higher than so many times their width are made narrower
_DEPTH_PLACE: Final = 1  # of its panel
_FARTHEST_M: Final = 80.0
_TWO_COLUMNS_FROM: Final = 4  # frames


@dataclass(frozen=True, kw_only=True, slots=True)
class RowLayout:
    """Where the parts of a picture stand: the same for all frames of a video."""

    camera_size: tuple[int, int]
    """Height, width [px] of each panel: camera, depth, further predictions."""
    is_stacked: bool
    """Whether these panels stand one below the other, not side by side."""
    further: tuple[str, ...] = ()
    """Keys of further predictions with a panel."""

    @classmethod
    def of(cls, image_size: tuple[int, int], further: tuple[str, ...] = ()) -> "RowLayout":
        """Choose the layout for images of a height and width [px]."""
        height, width = image_size
        is_stacked = width >= _WIDE * height
        width_px = _STACKED_PX if is_stacked else _BESIDE_PX
        height_px = min(max(round(height * width_px / width), 1), round(_HIGHEST * width_px))
        return cls(camera_size=(height_px, width_px), is_stacked=is_stacked, further=further)

    @property
    def num_panels(self) -> int:
        """Number of panels of the camera's size."""
        return 2 + len(self.further)

    @property
    def above_size(self) -> tuple[int, int]:
        """Height, width [px] of the bird's-eye view, which is as high as what stands beside it."""
        height = self.camera_size[0]
        if self.is_stacked:
            height = self.num_panels * (height + _LINE_PX + _GAP_PX) - _LINE_PX - _GAP_PX
        return height, _ABOVE_PX

    @property
    def size(self) -> tuple[int, int]:
        """Height, width [px] of the whole: even numbers, as videos need them."""
        columns = 1 if self.is_stacked else self.num_panels
        height = _HEAD_PX + _LINE_PX + self.above_size[0] + _GAP_PX
        width = columns * (self.camera_size[1] + _GAP_PX) + self.above_size[1] + 2 * _GAP_PX
        return height + height % 2, width + width % 2


def draw_row(
    sample: CameraLidarSample, told: Perception, layout: RowLayout, *, note: str = ""
) -> UInt8[np.ndarray, "height width 3"]:
    """The frame as an RGB picture of the layout's size.

    The camera's image with 2D boxes (only their corners where there are 3D boxes, too) and 3D boxes
    (the edges that it sees), depth where it may be believed, further predictions, and sweep and 3D
    boxes from above. A part that is missing is named in its place, a sensor that delivered nothing
    also in the head.

    Args:
        sample: Any of its sensors may be missing.
        told: What was found; all of it is drawn.
        layout: Of an image size like the sample's; another size is fitted in.
        note: Written at the right of the head, the time for example.
    """
    sample, told = level_view(sample, told)
    height, width = layout.size
    page = np.full((height, width, 3), PAGE, np.uint8)
    _put_head(page, sample, told, note)
    camera_px = layout.camera_size
    fitted, seen = _fitted(sample, told, camera_px)
    panels = [
        (_camera_title(told), _camera(fitted, seen)),
        ("Depth" if told.depth is not None else "Depth of the sweep", _depth(fitted, seen)),
        *(_further(sample, told, key, camera_px) for key in layout.further),
    ]
    for place, (title, picture) in enumerate(panels):
        row, column = (place, 0) if layout.is_stacked else (0, place)
        line = _HEAD_PX + row * (_LINE_PX + camera_px[0] + _GAP_PX)
        left = _GAP_PX + column * (camera_px[1] + _GAP_PX)
        _put_titled(page, title, line, left)
        _put_picture(page, picture, line + _LINE_PX, left, camera_px)
        if place == _DEPTH_PLACE:
            right = left + camera_px[1] - 20
            put_legend(page, DEPTH_SCALE, right=right, top=line + 4, hole="no value")
    left += camera_px[1] + _GAP_PX
    _put_titled(page, "From above", _HEAD_PX, left)
    _put_picture(page, _above(sample, told, layout), _HEAD_PX + _LINE_PX, left, layout.above_size)
    return page


def _fitted(
    sample: CameraLidarSample, told: Perception, room: tuple[int, int]
) -> tuple[CameraLidarSample, Perception]:
    zoom = min(side / old for side, old in zip(room, sample.image_size, strict=True))
    height, width = (max(round(side * zoom), 1) for side in sample.image_size)
    return zoomed(sample, told, (height, width))


def _camera_title(told: Perception) -> str:
    if told.detections2d is None or told.detections3d is None:
        return "Camera"
    return "Camera: 2D boxes (corners), 3D boxes (edges)"


def _camera(sample: CameraLidarSample, told: Perception) -> UInt8[np.ndarray, "height width 3"]:
    picture = camera_picture(sample)
    if sample.image is None:
        picture = sweep_picture(sample)  # so that boxes stand on something
        _put_notice(picture, "no camera image", share=0.12)
    return draw_detections(picture, told.detections2d, told.detections3d, sample.calibration)


def _depth(sample: CameraLidarSample, told: Perception) -> UInt8[np.ndarray, "height width 3"]:
    """Completed, else as far as it was measured."""
    if told.depth is not None:
        return colorize_depth(torch.where(told.depth.valid, told.depth.depth_m, 0.0))
    if sample.points is None:
        return _notice(sample.image_size, "no depth")
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return colorize_depth(sparse, point_size_px=3)


def _further(
    sample: CameraLidarSample, told: Perception, key: str, room: tuple[int, int]
) -> tuple[str, UInt8[np.ndarray, "height width 3"]]:
    """Title and picture of a further prediction's panel."""
    found = told.further.get(key)
    if found is None:
        return key, _notice(room, f"no {key}")
    return found.title, scaled_into(found.draw(sample), room)


def _above(
    sample: CameraLidarSample, told: Perception, layout: RowLayout
) -> UInt8[np.ndarray, "height width 3"]:
    height, width = layout.above_size
    view = BirdsEyeView()
    pixels_per_m = width / (view.y_max_m - view.y_min_m)
    farthest_m = min(view.x_min_m + height / pixels_per_m, _FARTHEST_M)
    view = replace(view, x_max_m=farthest_m, pixels_per_m=pixels_per_m)
    found = told.detections3d
    picture = draw_birds_eye(
        sample.points,
        None if found is None else found.boxes,
        () if found is None else found.class_names,
        calibration=sample.calibration,
        image_size=sample.image_size,
        view=view,
    )
    if sample.points is None:
        _put_notice(picture, "no LiDAR sweep")
    return picture


def _put_head(
    page: UInt8[np.ndarray, "height width 3"],
    sample: CameraLidarSample,
    told: Perception,
    note: str,
) -> None:
    """The frame's name, what fails, and how many of each class were found."""
    baseline, left = 23, _GAP_PX
    put_text(page, sample.sample_id, left, baseline, height_px=13, color=TITLE)
    left += text_width(sample.sample_id, 13) + 18
    for sensor in sample.missing_sensors:
        text = f"no {SENSOR_TITLES[sensor]}"
        put_text(page, text, left, baseline, height_px=11, color=_ALARM)
        left += text_width(text, 11) + 18
    for dimensions, found in (("2D", told.detections2d), ("3D", told.detections3d)):
        if found is None:
            continue
        put_text(page, dimensions, left, baseline, height_px=10, color=MUTED)
        left += text_width(dimensions, 10) + 8
        for name, count in sorted(Counter(found.class_names).items()):
            text = f"{count} {name}"
            page[baseline - 10 : baseline, left : left + 10] = class_color(name)
            put_text(page, text, left + 15, baseline, height_px=10, color=TITLE)
            left += 15 + text_width(text, 10) + 12
        left += 10
    right = page.shape[1] - _GAP_PX - text_width(note, 10)
    if note and right > left:
        put_text(page, note, right, baseline, height_px=10, color=MUTED)


def _put_titled(page: UInt8[np.ndarray, "height width 3"], title: str, top: int, left: int) -> None:
    put_text(page, title, left, top + 20, height_px=10, color=TITLE)


def _put_picture(
    page: UInt8[np.ndarray, "height width 3"],
    picture: UInt8[np.ndarray, "rows columns 3"],
    top: int,
    left: int,
    room: tuple[int, int],
) -> None:
    """In the middle of its room, on the colour of holes."""
    page[top : top + room[0], left : left + room[1]] = INVALID
    rows, columns = min(picture.shape[0], room[0]), min(picture.shape[1], room[1])
    top, left = top + (room[0] - rows) // 2, left + (room[1] - columns) // 2
    page[top : top + rows, left : left + columns] = picture[:rows, :columns]


def _notice(size: tuple[int, int], text: str) -> UInt8[np.ndarray, "height width 3"]:
    picture = np.full((*size, 3), INVALID, np.uint8)
    _put_notice(picture, text)
    return picture


def _put_notice(
    picture: UInt8[np.ndarray, "height width 3"], text: str, *, share: float = 0.5
) -> None:
    """In the middle of a row, at a share of the height."""
    height, width = picture.shape[:2]
    left = (width - text_width(text, 12)) // 2
    put_text(picture, text, left, round(share * height) + 6, height_px=12, color=MUTED)


def draw_rows(
    frames: Sequence[tuple[CameraLidarSample, Perception]],
) -> UInt8[np.ndarray, "height width 3"]:
    """Several frames on one page, two beside each other from the fourth on; see `draw_row`.

    Raises:
        ValueError: There is no frame.
    """
    if not frames:
        raise ValueError("a page needs at least one frame")
    further = tuple(dict.fromkeys(key for _, told in frames for key in told.further))
    layout = RowLayout.of(frames[0][0].image_size, further)
    rows = [draw_row(sample, told, layout) for sample, told in frames]
    num_columns = 1 if len(rows) < _TWO_COLUMNS_FROM else 2
    rows += [np.full_like(rows[0], PAGE)] * (-len(rows) % num_columns)
    lines = [
        np.concatenate(rows[start : start + num_columns], axis=1)
        for start in range(0, len(rows), num_columns)
    ]
    return np.concatenate(lines)
