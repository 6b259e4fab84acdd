"""Conversion of a network's boxes to detections in the frame."""

from jaxtyping import Float
from torch import Tensor

from sightline.detection2d.config import CLASSES, PostprocessConfig
from sightline.detection2d.placement import Placement
from sightline.geometry.boxes2d import Boxes2D
from sightline.ops.nms import nms2d
from sightline.structures.predictions import Detections2D

MOST_CANDIDATES = 2000  # best-scored boxes of a frame that enter suppression


def to_detections(
    scores: Float[Tensor, "places classes"],
    boxes: Float[Tensor, "places 4"],
    placement: Placement,
    config: PostprocessConfig,
) -> Detections2D:
    """Make detections in the frame's pixels, by descending score, clipped to the frame.

    Boxes of a class suppress each other (greedy, by IoU); empty boxes are removed. Boxes of several
    detectors are treated alike, which is how late fusion joins them.

    Args:
        scores: Scores of each class at each place.
        boxes: x_min, y_min, x_max, y_max in pixels of the network's input.
        placement: Placement of the frame in the input.
        config: Thresholds.
    """
    rows, columns = (scores > config.min_score).nonzero().unbind(dim=1)
    sure = scores[rows, columns]
    if len(sure) > MOST_CANDIDATES:
        best = sure.argsort(descending=True, stable=True)[:MOST_CANDIDATES]
        rows, columns, sure = rows[best], columns[best], sure[best]
    found = Boxes2D(placement.to_image(boxes[rows].float())).clip(placement.image_size)
    is_shown = found.area() > 0
    rows, columns, sure, found = rows[is_shown], columns[is_shown], sure[is_shown], found[is_shown]
    kept = nms2d(
        found.tensor,
        sure,
        config.nms_iou,
        labels=columns,
        max_detections=config.max_detections,
    )
    names = tuple(CLASSES[index] for index in columns[kept].tolist())
    return Detections2D(class_names=names, boxes=found[kept], scores=sure[kept].float())
