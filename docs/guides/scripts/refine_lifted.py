"""Lifted image boxes as further proposals of the second stage of 3D detection."""

from typing import Any, NamedTuple

import numpy as np

from joined_scene import Detections, Scene, count_returns
from kitti_frame import Array, Frame, Steps, seen_points, single
from onnx_detection3d import refined
from pillars import Proposals
from rotated_boxes import suppress


class SecondStage(NamedTuple):
    """Second file of 3D detection, and the frame whose boxes it refines."""

    frame: Frame
    session: Any  # onnxruntime's
    steps: Steps

    def __call__(self, boxes: Detections) -> Detections:
        """Refine boxes of the LiDAR's frame that lie in the network's range."""
        rule, names = self.steps["sweep"], list(self.steps["classes"])
        low, high = np.array(rule["lowest_m"])[:2], np.array(rule["highest_m"])[:2]
        boxes = [
            each for each in boxes if (low <= each[2][:2]).all() and (each[2][:2] <= high).all()
        ]
        xyz, raised = (
            seen_points(self.frame, rule),
            single([box for _, _, box in boxes]).reshape(-1, 7),
        )
        raised[:, 2] += single(rule["height_offset_m"])
        classes = np.array([names.index(name) for name, _, _ in boxes], int)
        scores = single([score for _, score, _ in boxes])
        return refined(self.session, self.steps, xyz, Proposals(raised, classes, scores))


def add_refined(
    scene: Scene,
    lifted: dict[int, Array],
    scores: Array,
    found: Detections,
    refine: SecondStage,
    settings: Steps,
) -> tuple[Detections, Array]:
    """Add refined boxes to the boxes of the sweep, the surest first; tell which ones they are."""
    share, names = settings["proposed_score_share"], scene.image.names
    given = [(str(names[each]), share * scores[each], box) for each, box in lifted.items()]
    least = settings["min_proposed_returns"]
    more = [each for each in refine(given) if count_returns(scene.points, each[2]) >= least]
    together = [*found, *more]
    boxes = np.array([box for _, _, box in together]).reshape(-1, 7)
    surest = np.array([score for _, score, _ in together])
    classes = np.array([name for name, _, _ in together], str)
    kept = suppress(boxes, classes, surest, settings["max_iou_from_above"])
    return [together[each] for each in kept], np.array(kept, int) >= len(found)
