"""New scores of both detectors' boxes, and which of them are one object."""

from typing import NamedTuple

import numpy as np

from joined_evidence import gather, score
from joined_scene import Boxes, Scene
from kitti_frame import Array, Steps
from lift_boxes import lift


class Pairs(NamedTuple):
    """Scores of all boxes, and the image box of each box of the sweep; -1: none."""

    image: Array
    sweep: Array
    partners: Array
    kind: str  # of image boxes: beside a sweep ("image"), or alone

    @property
    def unmatched(self) -> list[int]:
        """Image boxes without a partner."""
        places: list[int] = np.setdiff1d(np.arange(len(self.image)), self.partners).tolist()
        return places


def pair(scene: Scene, rule: Steps) -> Pairs:
    """Score the boxes by the fitted models, and match them."""
    sweep_rows, image_rows, iou, same = gather(scene)
    kind = "image" if len(scene.points) else "alone"
    image = mixed(scene.image, image_rows[:, : len(rule["columns"][kind])], rule, kind)
    sweep = mixed(scene.sweep, sweep_rows, rule, "sweep")
    outside = np.isnan(scene.sweep.in_image).any(axis=1)
    sweep = np.where(outside, scene.sweep.scores, sweep)
    overlapping = same & (iou >= rule["settings"]["min_iou"])
    partners = match(np.where(overlapping, iou * scene.image.scores, -1.0), sweep)
    return Pairs(image, sweep, partners, kind)


def mixed(boxes: Boxes, rows: Array, rule: Steps, kind: str) -> Array:
    """Mix the detector's own scores with those of the fitted model of each class."""
    scores, share = boxes.scores.copy(), rule["settings"]["own_share"]
    for name, model in rule[kind].items():
        chosen = boxes.names == name
        given = score(model, rows[chosen])
        scores[chosen] = (1 - share) * given + share * boxes.scores[chosen]
    return scores


def match(fit: Array, scores: Array) -> Array:
    """Give each box of the sweep the free image box that fits best, the surest first; -1: none."""
    partners, free = np.full(len(scores), -1), np.ones(fit.shape[1], bool)
    for row in np.argsort(-scores, kind="stable") if fit.shape[1] else ():
        best = int(np.where(free, fit[row], -1.0).argmax())
        if free[best] and fit[row, best] >= 0:
            partners[row], free[best] = best, False
    return partners


def lift_unmatched(scene: Scene, pairs: Pairs, rule: Steps) -> dict[int, tuple[Array, Array]]:
    """Lift the image boxes without a partner that are sure enough; their boxes and evidence."""
    least = rule["settings"]["min_lifted_score"]
    chosen = [each for each in pairs.unmatched if scene.image.scores[each] >= least]
    return {each: lift(scene, each, rule["ranges"]) for each in chosen}
