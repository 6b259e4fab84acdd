"""Joined objects on the camera's image and from above, each once.

Colours show the class, dashed edges a 3D box lifted from the image, and a filled front or outline
from above the support of both sensors.
"""

from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.structures.objects import Objects
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import scale_of
from sightline.visualization.colors import BoxStyle, class_color
from sightline.visualization.image import TAG_HEIGHT_PX, draw_boxes2d, draw_boxes3d
from sightline.visualization.lettering import Tag, put_tags

OBJECTS_LEGEND: Final = "C camera, L LiDAR, filled = both, dashed = lifted from the image"
"""Explanation of the marks, for a title."""

_BOTH: Final = "C+L"


def support_marks(objects: Objects, sample: CameraLidarSample) -> tuple[str, ...]:
    """Name the sensors that support each object: C+L, C or L.

    C is the image detector's box beside an image that is not black, L the sweep detector's; the
    image detector's box without an image counts as L, since it is found in the sweep.
    """
    has_camera = sample.image is not None and bool(sample.image.any())
    marks = []
    for by_image, by_sweep in zip(
        (objects.image_support > 0).tolist(), (objects.lidar_support > 0).tolist(), strict=True
    ):
        sees = by_image and has_camera
        is_measured = by_sweep or not sees
        marks.append(_BOTH if sees and is_measured else "C" if sees else "L")
    return tuple(marks)


def draw_objects(
    picture: UInt8[np.ndarray, "height width 3"], objects: Objects, sample: CameraLidarSample
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw objects on a copy of an RGB picture of the sample's size.

    3D boxes have their visible edges, with the corners of the image box; an object without a 3D box
    has the whole outline of its image box. Tags have class, score and `support_marks`; objects less
    high than their tag have none.

    Args:
        picture: The picture; not changed.
        objects: Objects, boxes in the frame of the sample's LiDAR.
        sample: The sample.
    """
    marks = support_marks(objects, sample)
    canvas = draw_boxes3d(
        picture,
        objects.boxes3d,
        objects.class_names,
        sample.calibration,
        tags=False,
        styles=box_styles(objects, sample),
    )
    in_image, has_box3d = objects.has_box2d, objects.has_box3d
    for chosen, corners_only in ((in_image & has_box3d, True), (in_image & ~has_box3d, False)):
        part = objects.select(chosen.nonzero()[:, 0])
        canvas = draw_boxes2d(
            canvas, part.boxes2d, part.class_names, tags=False, corners_only=corners_only
        )
    tag_px = round(TAG_HEIGHT_PX * max(scale_of(canvas), 1.0))
    tags = []
    for index in objects.boxes2d.area().nan_to_num().argsort(descending=True, stable=True).tolist():
        name, score = objects.class_names[index], float(objects.scores[index])
        x_min, y_min, x_max, y_max = objects.boxes2d.tensor[index].tolist()
        if y_max - y_min >= 2 * tag_px:  # false for NaN, outside the image
            text = f"{name} {score:.2f} {marks[index]}"
            tags.append(Tag(text=text, color=class_color(name), box=(x_min, y_min, x_max, y_max)))
    put_tags(canvas, tags, height_px=tag_px)
    return canvas


def box_styles(objects: Objects, sample: CameraLidarSample) -> tuple[BoxStyle, ...]:
    """Choose the style of each 3D box, in the image and from above."""
    marks = support_marks(objects, sample)
    return tuple(
        BoxStyle(is_dashed=origin == "lifted", is_filled=mark == _BOTH)
        for origin, mark in zip(objects.origins, marks, strict=True)
    )
