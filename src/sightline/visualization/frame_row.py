"""Picture of a frame with its predictions: camera, depth and bird's-eye view.

Smaller than a sheet and always of one size, for videos and sheets of several frames.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.geometry.projection import sparse_depth_map
from sightline.structures.level import level_view
from sightline.structures.objects import Objects
from sightline.structures.predictions import Detections2D, Detections3D, Perception
from sightline.structures.sample import SENSOR_TITLES, CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye
from sightline.visualization.canvas import scaled_into
from sightline.visualization.cells import MUTED, PAGE, TITLE
from sightline.visualization.colors import DEPTH_SCALE, INVALID, RGB, class_color
from sightline.visualization.depth import colorize_depth, draw_depth, put_legend
from sightline.visualization.image import camera_picture, draw_detections, sweep_picture
from sightline.visualization.lettering import put_text, text_width
from sightline.visualization.objects import OBJECTS_LEGEND, box_styles, draw_objects
from sightline.visualization.zoom import zoomed

_ALARM: RGB = (240, 130, 60)
_GAP_PX: Final = 10
_HEAD_PX: Final = 34
_LINE_PX: Final = 30
_WIDE: Final = 2.0  # minimum width / height of pictures that are stacked
_STACKED_PX, _BESIDE_PX = 940, 620  # widths of a camera's picture
_ABOVE_PX: Final = 300
_HIGHEST: Final = 1.5  # maximum height / width of pictures; higher ones become narrower
_DEPTH_PANEL: Final = 1  # its index
_FARTHEST_M: Final = 80.0
_TWO_COLUMNS_FROM: Final = 4  # frames


@dataclass(frozen=True, kw_only=True, slots=True)
class RowLayout:
    """Layout of a picture's parts: the same for all frames of a video."""

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
        """Height, width [px] of the bird's-eye view, which is as high as the panels beside it."""
        height = self.camera_size[0]
        if self.is_stacked:
            height = self.num_panels * (height + _LINE_PX + _GAP_PX) - _LINE_PX - _GAP_PX
        return height, _ABOVE_PX

    @property
    def size(self) -> tuple[int, int]:
        """Height, width [px] of the whole picture: even numbers, as required by videos."""
        columns = 1 if self.is_stacked else self.num_panels
        height = _HEAD_PX + _LINE_PX + self.above_size[0] + _GAP_PX
        width = columns * (self.camera_size[1] + _GAP_PX) + self.above_size[1] + 2 * _GAP_PX
        return height + height % 2, width + width % 2


def draw_row(
    sample: CameraLidarSample, perception: Perception, layout: RowLayout, *, note: str = ""
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a frame as an RGB picture of the layout's size.

    It has the camera's image with 2D boxes (only their corners if there are also 3D boxes) and 3D
    boxes (their visible edges), trusted depth, further predictions, and sweep and 3D boxes from
    above. Joined objects replace the detections. Missing parts are named in their places, missing
    sensors also in the head.

    Args:
        sample: The sample; any of its sensors may be missing.
        perception: Predictions to draw.
        layout: Layout; images of another size are scaled to it.
        note: Text at the right of the head, for example the time.
    """
    sample, perception = level_view(sample, perception)
    height, width = layout.size
    page = np.full((height, width, 3), PAGE, np.uint8)
    _put_head(page, sample, perception, note)
    camera_px = layout.camera_size
    fitted, scaled = _fitted(sample, perception, camera_px)
    panels = [
        (_camera_title(perception), _camera(fitted, scaled)),
        ("Depth" if perception.depth is not None else "Depth of the sweep", _depth(fitted, scaled)),
        *(_further(sample, perception, key, camera_px) for key in layout.further),
    ]
    for index, (title, picture) in enumerate(panels):
        row, column = (index, 0) if layout.is_stacked else (0, index)
        line = _HEAD_PX + row * (_LINE_PX + camera_px[0] + _GAP_PX)
        left = _GAP_PX + column * (camera_px[1] + _GAP_PX)
        _put_titled(page, title, line, left)
        _put_picture(page, picture, line + _LINE_PX, left, camera_px)
        if index == _DEPTH_PANEL:
            right = left + camera_px[1] - 20
            put_legend(page, DEPTH_SCALE, right=right, top=line + 4, hole="no value")
    left += camera_px[1] + _GAP_PX
    _put_titled(page, "From above", _HEAD_PX, left)
    above = _above(sample, perception, layout)
    _put_picture(page, above, _HEAD_PX + _LINE_PX, left, layout.above_size)
    return page


def _fitted(
    sample: CameraLidarSample, perception: Perception, room: tuple[int, int]
) -> tuple[CameraLidarSample, Perception]:
    zoom = min(side / old for side, old in zip(room, sample.image_size, strict=True))
    height, width = (max(round(side * zoom), 1) for side in sample.image_size)
    return zoomed(sample, perception, (height, width))


def _camera_title(perception: Perception) -> str:
    if perception.objects is not None:
        return f"Objects: {OBJECTS_LEGEND}"
    if perception.detections2d is None or perception.detections3d is None:
        return "Camera"
    return "Camera: 2D boxes (corners), 3D boxes (edges)"


def _camera(
    sample: CameraLidarSample, perception: Perception
) -> UInt8[np.ndarray, "height width 3"]:
    picture = camera_picture(sample)
    if sample.image is None:
        picture = sweep_picture(sample)  # as a background for the boxes
        _put_notice(picture, "no camera image", share=0.12)
    if perception.objects is not None:
        return draw_objects(picture, perception.objects, sample)
    return draw_detections(
        picture, perception.detections2d, perception.detections3d, sample.calibration
    )


def _depth(
    sample: CameraLidarSample, perception: Perception
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the completed depth, else the measured depth."""
    if perception.depth is not None:
        return draw_depth(perception.depth)
    if sample.points is None:
        return _notice(sample.image_size, "no depth")
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return colorize_depth(sparse, point_size_px=3)


def _further(
    sample: CameraLidarSample, perception: Perception, key: str, room: tuple[int, int]
) -> tuple[str, UInt8[np.ndarray, "height width 3"]]:
    """Title and picture of a further prediction's panel."""
    found = perception.further.get(key)
    if found is None:
        return key, _notice(room, f"no {key}")
    return found.title, scaled_into(found.draw(sample), room)


def _above(
    sample: CameraLidarSample, perception: Perception, layout: RowLayout
) -> UInt8[np.ndarray, "height width 3"]:
    height, width = layout.above_size
    view = BirdsEyeView()
    pixels_per_m = width / (view.y_max_m - view.y_min_m)
    farthest_m = min(view.x_min_m + height / pixels_per_m, _FARTHEST_M)
    view = replace(view, x_max_m=farthest_m, pixels_per_m=pixels_per_m)
    objects, found = perception.objects, perception.detections3d
    boxes = None if found is None else found.boxes
    names = () if found is None else found.class_names
    styles = None
    if objects is not None:
        boxes, names, styles = objects.boxes3d, objects.class_names, box_styles(objects, sample)
    picture = draw_birds_eye(
        sample.points,
        boxes,
        names,
        calibration=sample.calibration,
        image_size=sample.image_size,
        view=view,
        styles=styles,
    )
    if sample.points is None:
        _put_notice(picture, "no LiDAR sweep", share=0.05)
    return picture


def _put_head(
    page: UInt8[np.ndarray, "height width 3"],
    sample: CameraLidarSample,
    perception: Perception,
    note: str,
) -> None:
    """Write the frame's name, missing sensors, and the number of detections per class."""
    baseline, left = 23, _GAP_PX
    put_text(page, sample.sample_id, left, baseline, height_px=13, color=TITLE)
    left += text_width(sample.sample_id, 13) + 18
    for sensor in sample.missing_sensors:
        text = f"no {SENSOR_TITLES[sensor]}"
        put_text(page, text, left, baseline, height_px=11, color=_ALARM)
        left += text_width(text, 11) + 18
    counted: dict[str, Detections2D | Detections3D | Objects | None]
    counted = {"2D": perception.detections2d, "3D": perception.detections3d}
    if perception.objects is not None:
        counted = {"objects": perception.objects}
    for kind, found in counted.items():
        if found is None:
            continue
        put_text(page, kind, left, baseline, height_px=10, color=MUTED)
        left += text_width(kind, 10) + 8
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
    """Put a picture into the middle of its area, on the colour of missing values."""
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
    """Write a centred notice at a share of the height."""
    height, width = picture.shape[:2]
    left = (width - text_width(text, 12)) // 2
    put_text(picture, text, left, round(share * height) + 6, height_px=12, color=MUTED)


def draw_rows(
    frames: Sequence[tuple[CameraLidarSample, Perception]],
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw several frames on one page, in two columns for four or more; see `draw_row`.

    Raises:
        ValueError: There is no frame.
    """
    if not frames:
        raise ValueError("a page needs at least one frame")
    further = tuple(dict.fromkeys(key for _, perception in frames for key in perception.further))
    layout = RowLayout.of(frames[0][0].image_size, further)
    rows = [draw_row(sample, perception, layout) for sample, perception in frames]
    num_columns = 1 if len(rows) < _TWO_COLUMNS_FROM else 2
    rows += [np.full_like(rows[0], PAGE)] * (-len(rows) % num_columns)
    lines = [
        np.concatenate(rows[start : start + num_columns], axis=1)
        for start in range(0, len(rows), num_columns)
    ]
    return np.concatenate(lines)
