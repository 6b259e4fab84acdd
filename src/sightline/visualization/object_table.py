"""Table of a frame's objects, with exact values, as a picture."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.objects import Objects
from sightline.structures.predictions import Detections3D
from sightline.visualization.cells import MUTED
from sightline.visualization.chart import BACKGROUND, TEXT
from sightline.visualization.colors import RGB, class_color
from sightline.visualization.lettering import put_text, text_width

_ROW_PX = 20
_TEXT_PX = 9
_LEFT_PX = 14
# Right ends of the columns after the class, as shares of the width.
_COLUMN_ENDS = (0.36, 0.62, 0.76, 0.86, 0.97)
_LABEL_COLUMNS = ("range m", "l x w x h m", "points", "trunc.", "occl.")
_DETECTION_COLUMNS = ("range m", "l x w x h m", "points", "", "score")
_OBJECT_COLUMNS = ("range m", "l x w x h m", "points", "3D box", "score")
_OCCLUSION = {-1: "-", 0: "none", 1: "partly", 2: "largely", 3: "unknown"}


@dataclass(frozen=True, kw_only=True)
class _Row:
    class_name: str
    range_m: float
    index: int
    """Index of the object's box."""
    last: tuple[str, str]
    """Last two cells, which differ between labels and detections."""


def draw_object_table(
    objects: ObjectLabels | Detections3D | Objects,
    points: Float32[Tensor, "num_points 4"] | None,
    *,
    width_px: int,
    max_height_px: int,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a table of the objects with a 3D part, nearest first; objects without room are counted.

    Args:
        objects: Labels (with truncation and occlusion), detections (with scores) or joined objects
            (with the origin of the 3D box and their scores).
        points: Sweep for the number of points in each box. None: no numbers.
        width_px: Width of the picture.
        max_height_px: Maximum height of the picture.
    """
    if isinstance(objects, ObjectLabels):
        rows, boxes, columns = _label_rows(objects), objects.boxes3d, _LABEL_COLUMNS
    elif isinstance(objects, Objects):
        rows, boxes, columns = _object_rows(objects), objects.boxes3d, _OBJECT_COLUMNS
    else:
        rows, boxes, columns = _detection_rows(objects), objects.boxes, _DETECTION_COLUMNS
    rows.sort(key=lambda row: row.range_m)
    room = (max_height_px - 6) // _ROW_PX - 1
    listed = rows if len(rows) <= room else rows[: max(room - 1, 0)]
    num_lines = 1 + len(listed) + (len(listed) < len(rows))
    canvas = np.full((num_lines * _ROW_PX + 6, width_px, 3), BACKGROUND, np.uint8)
    _put_row(canvas, 0, "class", columns, color=MUTED)
    for number, row in enumerate(listed, start=1):
        top = number * _ROW_PX
        swatch = slice(top + 6, top + _ROW_PX - 5)
        canvas[swatch, _LEFT_PX : _LEFT_PX + 9] = class_color(row.class_name)
        _put_row(canvas, number, row.class_name, _cells(row, boxes, points), color=TEXT)
    if len(listed) < len(rows):
        more = f"and {len(rows) - len(listed)} more, farther away"
        _put_row(canvas, len(listed) + 1, more, (), color=MUTED)
    return canvas


def _label_rows(labels: ObjectLabels) -> list[_Row]:
    rows = []
    for index in labels.has_box3d.nonzero()[:, 0].tolist():
        truncation = float(labels.truncation[index])
        occlusion = int(labels.occlusion[index])
        last = (
            f"{truncation:.2f}" if truncation >= 0 else "-",
            _OCCLUSION.get(occlusion, str(occlusion)),
        )
        rows.append(_row(labels.class_names[index], labels.boxes3d, index, last))
    return rows


def _detection_rows(detections: Detections3D) -> list[_Row]:
    return [
        _row(name, detections.boxes, index, ("", f"{float(detections.scores[index]):.2f}"))
        for index, name in enumerate(detections.class_names)
    ]


def _object_rows(objects: Objects) -> list[_Row]:
    names, origins = objects.class_names, objects.origins
    return [
        _row(
            names[index],
            objects.boxes3d,
            index,
            (origins[index], f"{float(objects.scores[index]):.2f}"),
        )
        for index in objects.has_box3d.nonzero()[:, 0].tolist()
    ]


def _row(class_name: str, boxes: Boxes3D, index: int, last: tuple[str, str]) -> _Row:
    range_m = float(boxes.centers[index, :2].norm())
    return _Row(class_name=class_name, range_m=range_m, index=index, last=last)


def _cells(
    row: _Row, boxes: Boxes3D, points: Float32[Tensor, "num_points 4"] | None
) -> tuple[str, ...]:
    box = boxes[row.index : row.index + 1]
    length, width, height = box.sizes[0].tolist()
    size = f"{length:.1f} x {width:.1f} x {height:.1f}"
    count = "-" if points is None else str(int(box.contain(points[:, :3].to(box.tensor)).sum()))
    return (f"{row.range_m:.1f}", size, count, *row.last)


def _put_row(
    canvas: UInt8[np.ndarray, "height width 3"],
    number: int,
    first: str,
    cells: tuple[str, ...],
    *,
    color: RGB,
) -> None:
    baseline = number * _ROW_PX + 15
    put_text(canvas, first, _LEFT_PX + 18, baseline, height_px=_TEXT_PX, color=color)
    for cell, end in zip(cells, _COLUMN_ENDS, strict=False):
        left = round(end * canvas.shape[1]) - text_width(cell, _TEXT_PX)
        put_text(canvas, cell, left, baseline, height_px=_TEXT_PX, color=color)
