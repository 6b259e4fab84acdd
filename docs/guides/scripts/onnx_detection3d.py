"""3D boxes of a KITTI frame from both exported files, by numpy and onnxruntime alone.

python onnx_detection3d.py NAME-proposals.onnx NAME-refinement.onnx IMAGE.png VELODYNE.bin CALIB.txt
"""

import sys
from typing import Any

import numpy as np

from kitti_frame import Array, Frame, Steps, arguments, open_graph, read_frame, seen_points, single
from pillars import Proposals, propose
from regions import cut_regions, decode_regions, run_network, turn_regions
from rotated_boxes import mean_of_two, suppress, turn_to_axes

Session = Any  # onnxruntime's
Detections = list[tuple[str, float, Array]]
Answer = tuple[Array, Array, Array]  # boxes, scores, and the log-odds that their fronts are right


def detect(first: str, second: str, frame: Frame) -> Detections:
    """Find class, score and x, y, z, length, width, height, yaw (LiDAR frame), the surest first."""
    session, steps = open_graph(first, "detection3d", "pillars")
    refiner, rules = open_graph(second, "detection3d", "points")
    if rules["weights"] != steps["weights"]:
        sys.exit(f"{first} and {second} are of different weights; name both files of one export")
    xyz = seen_points(frame, steps["sweep"])
    return refined(refiner, rules, xyz, propose(session, steps, xyz)) if len(xyz) else []


def refined(session: Session, steps: Steps, xyz: Array, given: Proposals) -> Detections:
    """Refine proposals by the second file; without doubtful and overlapping ones."""
    if not len(given.boxes):
        return []
    boxes, scores = refine(session, steps, xyz, given)
    rule = steps["suppression"]
    sure = np.flatnonzero(scores >= np.float32(rule["min_score"]))
    limit = np.nextafter(rule["iou"], 0)  # an equal overlap drops a box
    kept = sure[suppress(boxes[sure], given.classes[sure], scores[sure], limit)]
    boxes[:, 2] -= steps["sweep"]["height_offset_m"]
    names = np.array(steps["classes"])[given.classes]
    return [(str(names[each]), float(scores[each]), boxes[each]) for each in kept]


def refine(session: Session, steps: Steps, xyz: Array, given: Proposals) -> tuple[Array, Array]:
    """Apply the network pass after pass; give boxes and scores."""
    axes, results = steps["axes"], []
    if axes is not None:  # from several axes first, of which the surest goes on
        is_turned = np.isin(np.array(steps["classes"])[given.classes], axes["class_names"])
        boxes, origins, numbers = turn_to_axes(given.boxes, is_turned, axes["number"])
        turned = Proposals(boxes, given.classes[origins], given.scores[origins])
        results = run_passes(session, steps, xyz, turned, axes["passes"])
        worth = np.where(numbers > 0, results[-1][1] / (1 + axes["least_gain"]), results[-1][1])
        table = np.full((axes["number"], len(given.boxes)), -1.0)
        table[numbers, origins] = worth
        places = np.zeros(table.shape, int)
        places[numbers, origins] = np.arange(len(worth))
        best = places[table.argmax(axis=0), np.arange(len(given.boxes))]
        results = [(boxes[best], scores[best], odds[best]) for boxes, scores, odds in results]
    start = given._replace(boxes=results[-1][0]) if results else given
    results += run_passes(session, steps, xyz, start, steps["passes"] - len(results))
    (one, score_one, odds_one), (boxes, scores, odds) = results[0], results[-1]
    is_mean = np.isin(np.array(steps["classes"])[given.classes], steps["mean_with_first"])
    mean = mean_of_two((one, boxes), (odds_one, odds))
    boxes = np.where(is_mean[:, None], mean, boxes)
    return boxes, np.where(is_mean, (score_one + scores) / 2, scores)


def run_passes(
    session: Session, steps: Steps, xyz: Array, given: Proposals, number: int
) -> list[Answer]:
    """Change the boxes so many times, each time from the boxes before; scores from the first."""
    boxes, share, results = given.boxes, steps["decoding"]["quality_share"], []
    for _ in range(number):
        inputs = cut_regions(xyz, boxes, given.classes, steps)
        values, fronts, quality = run_network(session, inputs, steps["regions_a_run"])
        if steps["flip_test"]:
            values_2, fronts_2, quality_2 = run_network(
                session, turn_regions(inputs), steps["regions_a_run"]
            )
            values = (values + values_2 * single([-1, -1, 1, 1, 1, 1, 1, 1])) / 2
            fronts, quality = (fronts - fronts_2) / 2, (quality + quality_2) / 2
        boxes = decode_regions(boxes, values, fronts, steps["decoding"])
        scores = given.scores ** (1 - share) * (1 / (1 + np.exp(-quality))) ** share
        results.append((boxes, scores, np.abs(fronts)))
    return results


if __name__ == "__main__":
    proposals, refinement, *files = arguments(__doc__, 5)
    for name, score, box in detect(proposals, refinement, read_frame(*files)):
        print(name, f"{score:.4f}", *(f"{number:.3f}" for number in box))
