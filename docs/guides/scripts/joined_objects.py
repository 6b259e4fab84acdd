"""Joined objects from the boxes of both detectors."""

from typing import NamedTuple

import numpy as np

from joined_calibration import beta
from joined_evidence import overlaps, score
from joined_pairs import Pairs, lift_unmatched, pair
from joined_scene import Detections, Scene, make_scene
from kitti_frame import Array, Frame, Steps
from refine_lifted import SecondStage, add_refined

FROM_RETURNS = "measured", "refined"


class Found(NamedTuple):
    """An object: its 3D box is measured, refined or lifted from the image, or none."""

    name: str
    score: float
    box: Array  # x_min, y_min, x_max, y_max [px]; no number: outside the image
    origin: str
    score3d: float
    box3d: Array  # x, y, z, length, width, height [m], yaw [rad] in the LiDAR's frame


def join(
    frame: Frame,
    in_image: Detections,
    in_sweep: Detections,
    rule: Steps,
    refine: SecondStage | None = None,
) -> list[Found]:
    """Match the boxes, score them anew, and lift image boxes without a partner.

    The second stage of 3D detection refines sure lifted boxes, which are then matched like others.
    """
    settings, is_refined = rule["settings"], np.zeros(len(in_sweep), bool)
    scene = make_scene(frame, in_image, in_sweep)
    pairs = pair(scene, rule)
    lifted, least = lift_unmatched(scene, pairs, rule), settings["min_proposed_score"]
    sure = {each: box for each, (box, _) in lifted.items() if pairs.image[each] >= least}
    if sure and refine is not None and pairs.kind == "image":
        in_sweep, is_refined = add_refined(scene, sure, pairs.image, in_sweep, refine, settings)
        scene = make_scene(frame, in_image, in_sweep)
        pairs = pair(scene, rule)
        lifted = lift_unmatched(scene, pairs, rule)
    found = measured(scene, pairs, is_refined, settings)
    for index in pairs.unmatched:
        name, box = str(scene.image.names[index]), scene.image.in_image[index]
        origin, score3d, box3d = "none", 0.0, np.zeros(7)
        if index in lifted:
            box3d, row = lifted[index]
            origin, score3d = "lifted", float(score(rule["lifted"][name], row[None])[0])
        found.append(Found(name, float(pairs.image[index]), box, origin, score3d, box3d))
    found = [calibrated(each, pairs.kind, rule["calibrators"]) for each in found]
    return without_repeats(found, settings["min_iou"], settings["max_iou"])


def calibrated(found: Found, kind: str, maps: Steps) -> Found:
    """Calibrate both scores, without a change of their order."""
    in_image = beta(maps[kind][found.name], found.score)
    in_space = beta(maps[f"{kind}_3d"][found.name], found.score3d)
    in_space = 0.0 if found.origin == "none" else in_space
    is_outside = np.isnan(found.box).any()
    return found._replace(score=in_space if is_outside else in_image, score3d=in_space)


def measured(scene: Scene, pairs: Pairs, is_refined: Array, settings: Steps) -> list[Found]:
    """Objects of the sweep's boxes; with a partner, both sensors confirm them."""
    found = []
    for index, partner in enumerate(pairs.partners.tolist()):
        box, score3d = scene.sweep.in_image[index], float(pairs.sweep[index])
        sure = score3d * (1.0 if np.isnan(box).any() else settings["sweep_share"])
        if partner >= 0:  # a refined box stems from the image's
            of_sweep = 0.0 if is_refined[index] else settings["projected_share"]
            box = of_sweep * box + (1 - of_sweep) * scene.image.in_image[partner]
            sure = 1 - (1 - sure) * (1 - pairs.image[partner])
        name, box3d = str(scene.sweep.names[index]), scene.boxes3d[index]
        origin = "refined" if is_refined[index] else "measured"
        found.append(Found(name, float(sure), box, origin, score3d, box3d))
    return found


def without_repeats(found: list[Found], measured_most: float, most: float) -> list[Found]:
    """Leave out objects of the image alone that repeat a surer one of their class."""
    kept: list[Found] = []
    for each in sorted(found, key=lambda one: -one.score):
        surer = [one for one in kept if one.name == each.name]
        boxes = np.array([one.box for one in surer]).reshape(-1, 4)
        limits = [measured_most if one.origin in FROM_RETURNS else most for one in surer]
        is_repeat = (overlaps(each.box[None], boxes)[0] > limits).any()
        if each.origin in FROM_RETURNS or not is_repeat:
            kept.append(each)
    return kept
