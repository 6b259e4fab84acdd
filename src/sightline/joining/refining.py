"""Lifted image boxes as further proposals of the 3D detector's second stage."""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Float64

from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.config import JoinConfig
from sightline.joining.lifting import Lifted
from sightline.joining.scene import Scene, count_returns
from sightline.ops.nms import nms_bev
from sightline.structures.level import level_detections, mounted_detections
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample

Refine = Callable[[CameraLidarSample, Detections3D], Detections3D]
"""Refinement of 3D boxes by a sweep; see `Detection3DPredictor.refine_boxes`."""


@runtime_checkable
class Refiner(Protocol):
    """Detector whose second stage refines boxes from elsewhere."""

    def refine_boxes(self, sample: CameraLidarSample, boxes: Detections3D) -> Detections3D:
        """Refine boxes of a sample, given and returned in the LiDAR's own frame."""
        ...


def refiner_of(detector: object) -> Refine | None:
    """Take the second stage of a detector in sweeps; None: it has none, or is no detector."""
    return detector.refine_boxes if isinstance(detector, Refiner) else None


class Extended(NamedTuple):
    """Detections in a sweep, by descending score, and which of them image boxes proposed."""

    found: Detections3D
    is_proposed: Bool[np.ndarray, " num_boxes"]


def add_refined(
    sample: CameraLidarSample,
    scene: Scene,
    lifted: Mapping[int, Lifted],
    scores: Float64[np.ndarray, " num_image"],
    found: Detections3D,
    refine: Refine,
    config: JoinConfig,
) -> Extended:
    """Add lifted boxes, refined by the second stage, to the detections in a sweep.

    Refined boxes with few returns are left out, and so is the less sure of two boxes of a class
    that overlap from above.

    Args:
        sample: The frame.
        scene: The frame's detections and returns.
        lifted: Lifted boxes by the index of their image box.
        scores: Scores of all image boxes.
        found: Detections in the sweep, in the LiDAR's own frame.
        refine: The second stage.
        config: The limits.
    """
    indices = list(lifted)
    boxes = torch.from_numpy(np.array([lifted[index].box for index in indices]).reshape(-1, 7))
    proposals = Detections3D(
        class_names=tuple(scene.image.names[index] for index in indices),
        boxes=Boxes3D(boxes),
        scores=torch.from_numpy(config.proposed_score_share * scores[indices]),
    )
    refined = refine(sample, mounted_detections(proposals, sample))
    level = Boxes3D(level_detections(refined, sample).boxes.tensor.double())
    is_seen = count_returns(level, torch.from_numpy(scene.points)) >= config.min_proposed_returns
    names = np.array([*found.class_names, *refined.class_names])
    together = torch.cat((found.boxes.tensor.double(), refined.boxes.tensor.double()))
    surest = torch.cat((found.scores.double(), refined.scores.double()))
    count = len(found.scores)
    places = torch.cat((torch.arange(count), count + is_seen.nonzero()[:, 0]))
    labels = torch.from_numpy(np.unique(names, return_inverse=True)[1])[places]
    above = Boxes3D(together[places]).bev
    kept = places[nms_bev(above, surest[places], config.max_iou_from_above, labels=labels)]
    extended = Detections3D(
        class_names=tuple(names[kept.numpy()].tolist()),
        boxes=Boxes3D(together[kept]),
        scores=surest[kept],
    )
    return Extended(extended, (kept >= count).numpy())
