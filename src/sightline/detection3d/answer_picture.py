"""Picture of a frame with a detector's proposals and detections, in the image and from above."""

from dataclasses import replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import UInt8

from sightline.augmentation.scene_changes import resize
from sightline.structures.level import level_detections, level_sample
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.cells import GAP_PX, TITLE_PX, titled_cell
from sightline.visualization.colors import RGB
from sightline.visualization.image import camera_picture, draw_boxes3d

PROPOSED: Final[RGB] = (150, 156, 166)
LABELLED: Final[RGB] = (245, 245, 245)
DRAWN_SCORE: Final = 0.3
"""Score from which proposals and detections are drawn."""

_FARTHEST_M = 60.0


def answer_picture(
    title: str,
    sample: CameraLidarSample,
    proposed: Detections3D,
    found: Detections3D,
    *,
    width_px: int = 900,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw proposals (grey) over detections in the image, and both from above at the right.

    Labels are white, detections have the colours of their classes. Proposals and detections with a
    score below 0.3 are not drawn.

    Args:
        title: Title of the first picture.
        sample: The detector's input; image, sweep and labels may be missing.
        proposed: Output of the first stage.
        found: Final detections.
        width_px: Width of the image.
    """
    height_px = max(round(sample.image_size[0] * width_px / sample.image_size[1]), 1)
    proposed, sure = (
        level_detections(each.filter_by_score(DRAWN_SCORE), sample) for each in (proposed, found)
    )
    sample = level_sample(resize(sample, height_px, width_px))
    image = camera_picture(sample)
    first = draw_boxes3d(
        image,
        proposed.boxes,
        proposed.class_names,
        sample.calibration,
        color=PROPOSED,
        tags=False,
    )
    second = draw_boxes3d(
        _with_labels(image, sample),
        sure.boxes,
        sure.class_names,
        sample.calibration,
        scores=sure.scores,
    )
    seen = np.concatenate(
        (
            titled_cell(title, f"{len(proposed.scores)} proposals", first),
            titled_cell("Detections", f"{len(sure.scores)}; labels are white", second),
        )
    )
    above = _from_above(sample, proposed, sure, seen.shape[0] - TITLE_PX - GAP_PX)
    return np.concatenate((seen, titled_cell("From above", "to 60 m", above)), axis=1)


def _with_labels(
    image: UInt8[np.ndarray, "height width 3"], sample: CameraLidarSample
) -> UInt8[np.ndarray, "height width 3"]:
    if sample.objects is None:
        return image
    labels = sample.objects.select(sample.objects.has_box3d)
    return draw_boxes3d(
        image, labels.boxes3d, labels.class_names, sample.calibration, color=LABELLED, tags=False
    )


def _from_above(
    sample: CameraLidarSample, proposed: Detections3D, found: Detections3D, height_px: int
) -> UInt8[np.ndarray, "height width 3"]:
    view = BirdsEyeView(x_max_m=_FARTHEST_M)
    view = replace(view, pixels_per_m=height_px / (view.x_max_m - view.x_min_m))
    labels = sample.objects
    picture = draw_birds_eye(
        sample.points,
        None if labels is None else labels.boxes3d,
        () if labels is None else labels.class_names,
        calibration=sample.calibration,
        image_size=sample.image_size,
        view=view,
        color=LABELLED,
    )
    put_boxes_from_above(picture, view, proposed.boxes, proposed.class_names, color=PROPOSED)
    put_boxes_from_above(picture, view, found.boxes, found.class_names)
    fitted = cv2.resize(picture, (picture.shape[1], height_px), interpolation=cv2.INTER_AREA)
    return fitted.astype(np.uint8, copy=False)
