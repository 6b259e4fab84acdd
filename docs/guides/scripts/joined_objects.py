"""Joined objects from the boxes of both detectors."""

from typing import NamedTuple

import numpy as np

from joined_calibration import beta
from joined_evidence import gather, overlaps, score
from joined_scene import Boxes, Detections, Scene, make_scene
from kitti_frame import Array, Frame, Steps
from lift_boxes import lift


class Found(NamedTuple):
    """An object: its 3D box is measured, lifted from the image, or none."""

    name: str
    score: float
    box: Array  # x_min, y_min, x_max, y_max [px]; no number: outside the image
    origin: str
    score3d: float
    box3d: Array  # x, y, z, length, width, height [m], yaw [rad] in the LiDAR's frame


def join(frame: Frame, in_image: Detections, in_sweep: Detections, rule: Steps) -> list[Found]:
    """Match the boxes, score them anew, and lift image boxes without a partner."""
    scene, settings = make_scene(frame, in_image, in_sweep), rule["settings"]
    sweep_rows, image_rows, iou, same = gather(scene)
    kind = "image" if len(scene.points) else "alone"
    scores2d = mixed(scene.image, image_rows[:, : len(rule["columns"][kind])], rule, kind)
    scores3d = mixed(scene.sweep, sweep_rows, rule, "sweep")
    outside = np.isnan(scene.sweep.in_image).any(axis=1)
    scores3d = np.where(outside, scene.sweep.scores, scores3d)
    overlapping = same & (iou >= settings["min_iou"])
    partners = match(np.where(overlapping, iou * scene.image.scores, -1.0), scores3d)
    found = measured(scene, scores2d, scores3d, partners, settings["projected_share"])
    for index in np.setdiff1d(np.arange(len(scores2d)), partners).tolist():
        name, box = str(scene.image.names[index]), scene.image.in_image[index]
        origin, score3d, box3d = "none", 0.0, np.zeros(7)
        if scene.image.scores[index] >= settings["min_lifted_score"]:
            box3d, row = lift(scene, index)
            origin, score3d = "lifted", float(score(rule["lifted"][name], row[None])[0])
        found.append(Found(name, float(scores2d[index]), box, origin, score3d, box3d))
    found = [calibrated(each, kind, rule["calibrators"]) for each in found]
    return without_repeats(found, settings["min_iou"], settings["max_iou"])


def mixed(boxes: Boxes, rows: Array, rule: Steps, kind: str) -> Array:
    """Mix the detector's own scores with those of the fitted model of each class."""
    scores, share = boxes.scores.copy(), rule["settings"]["own_share"]
    for name, model in rule[kind].items():
        chosen = boxes.names == name
        given = score(model, rows[chosen])
        scores[chosen] = (1 - share) * given + share * boxes.scores[chosen]
    return scores


def calibrated(found: Found, kind: str, maps: Steps) -> Found:
    """Calibrate both scores, without a change of their order."""
    in_image = beta(maps[kind][found.name], found.score)
    in_space = beta(maps[f"{kind}_3d"][found.name], found.score3d)
    return found._replace(score=in_image, score3d=0.0 if found.origin == "none" else in_space)


def match(fit: Array, scores: Array) -> Array:
    """Give each box of the sweep the free image box that fits best, the surest first; -1: none."""
    partners, free = np.full(len(scores), -1), np.ones(fit.shape[1], bool)
    for row in np.argsort(-scores, kind="stable") if fit.shape[1] else ():
        best = int(np.where(free, fit[row], -1.0).argmax())
        if free[best] and fit[row, best] >= 0:
            partners[row], free[best] = best, False
    return partners


def measured(
    scene: Scene, image: Array, sweep: Array, partners: Array, share: float
) -> list[Found]:
    """Objects of the sweep's boxes; with a partner, both sensors confirm them."""
    found = []
    for index, partner in enumerate(partners.tolist()):
        box, sure = scene.sweep.in_image[index], sweep[index]
        if partner >= 0:
            box = share * box + (1 - share) * scene.image.in_image[partner]
            sure = 1 - (1 - sure) * (1 - image[partner])
        name, box3d = str(scene.sweep.names[index]), scene.boxes3d[index]
        found.append(Found(name, float(sure), box, "measured", float(sweep[index]), box3d))
    return found


def without_repeats(found: list[Found], measured_most: float, most: float) -> list[Found]:
    """Leave out objects of the image alone that repeat a surer one of their class."""
    kept: list[Found] = []
    for each in sorted(found, key=lambda one: -one.score):
        surer = [one for one in kept if one.name == each.name]
        boxes = np.array([one.box for one in surer]).reshape(-1, 4)
        limits = [measured_most if one.origin == "measured" else most for one in surer]
        is_repeat = (overlaps(each.box[None], boxes)[0] > limits).any()
        if each.origin == "measured" or not is_repeat:
            kept.append(each)
    return kept
