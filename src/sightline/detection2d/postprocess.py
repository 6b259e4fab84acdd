"""From a network's boxes to detections in the frame."""

from jaxtyping import Float
from torch import Tensor

from sightline.detection2d.config import CLASSES, PostprocessConfig
from sightline.detection2d.placement import Placement
from sightline.geometry.boxes2d import Boxes2D
from sightline.ops.nms import nms2d
from sightline.structures.predictions import Detections2D

MOST_CANDIDATES = 2000  # of a frame, the surest: what suppression is asked to look at


def to_detections(
    scores: Float[Tensor, "places classes"],
    boxes: Float[Tensor, "places 4"],
    placement: Placement,
    config: PostprocessConfig,
) -> Detections2D:
    """Detections in the frame's pixels, the surest first, cut at its border.

    Boxes of a class suppress each other (greedy, by IoU); those that show nothing are left out.
    Boxes of several detectors count alike, which is how late fusion joins them.

    Args:
        scores: Of each class at each place.
        boxes: x_min, y_min, x_max, y_max in pixels of the network's input.
        placement: Of the frame in it.
        config: What is kept.
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
