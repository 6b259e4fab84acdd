"""Pairs of truths and detections by the distance of their centres on the ground, and their errors.

Boxes are rows as in `kitti_object_overlaps`. An object without a 3D part has no centre.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int32, Int64

from sightline.data.formats.kitti_labels import NO_LOCATION
from sightline.ops.compiled import compiled

CENTRE_DISTANCES_M: Final = (0.5, 1.0, 2.0, 4.0)
"""Distances of centres that a match must be below, in nuScenes' detection benchmark."""
_REACH_M: Final = max(CENTRE_DISTANCES_M)


def find_centre_pairs(
    found: Float64[np.ndarray, "num_detections 11"],
    found_code: Int8[np.ndarray, " num_detections"],
    found_offsets: Int64[np.ndarray, " num_offsets"],
    truths: Float64[np.ndarray, "num_truths 11"],
    truth_code: Int8[np.ndarray, " num_truths"],
    truth_offsets: Int64[np.ndarray, " num_offsets"],
) -> tuple[
    Int32[np.ndarray, " num_detections"],
    Int32[np.ndarray, " num_pairs"],
    Float64[np.ndarray, "num_pairs 3"],
]:
    """Find the pairs of one class and frame with centres less than 4 m apart on the ground.

    Args:
        found: Boxes of the detections.
        found_code: Class of each detection; a negative number has no pairs.
        found_offsets: Start of each frame's detections, and the end of the last one's.
        truths: Boxes of the truths.
        truth_code: Class of each truth; neighbouring classes have that of their evaluated class.
        truth_offsets: Start of each frame's truths, and the end of the last one's.

    Returns:
        Number of pairs of each detection. Of each pair, by detection, then by truth: the index of
        the truth in its frame; and three errors: distance of the centres [m], one minus the IoU of
        the boxes with centres and axes aligned, difference of the headings [rad] from 0 to pi.
    """
    capacity = int((np.diff(found_offsets) * np.diff(truth_offsets)).sum())
    per_detection = np.zeros(len(found), dtype=np.int32)
    truth = np.empty(capacity, dtype=np.int32)
    errors = np.empty((capacity, 3))
    num_pairs = _fill(
        found,
        np.where(_has_box3d(found), found_code, np.int8(-1)),
        found_offsets,
        truths,
        np.where(_has_box3d(truths), truth_code, np.int8(-1)),
        truth_offsets,
        per_detection,
        truth,
        errors,
    )
    return per_detection, truth[:num_pairs].copy(), errors[:num_pairs].copy()


def _has_box3d(
    boxes: Float64[np.ndarray, "num_boxes 11"],
) -> Bool[np.ndarray, " num_boxes"]:
    has_size = (boxes[:, 4:7] > 0).all(axis=1)
    has_place = (boxes[:, 7:10] != NO_LOCATION).all(axis=1)
    has_box: Bool[np.ndarray, " num_boxes"] = has_size & has_place
    return has_box


@compiled
def _fill(
    found: Float64[np.ndarray, "num_detections 11"],
    found_code: Int8[np.ndarray, " num_detections"],
    found_offsets: Int64[np.ndarray, " num_offsets"],
    truths: Float64[np.ndarray, "num_truths 11"],
    truth_code: Int8[np.ndarray, " num_truths"],
    truth_offsets: Int64[np.ndarray, " num_offsets"],
    per_detection: Int32[np.ndarray, " num_detections"],
    truth: Int32[np.ndarray, " capacity"],
    errors: Float64[np.ndarray, "capacity 3"],
) -> int:
    """Write the pairs into the last three arrays and return their number."""
    num_pairs = 0
    for frame in range(len(found_offsets) - 1):
        first = truth_offsets[frame]
        for j in range(found_offsets[frame], found_offsets[frame + 1]):
            if found_code[j] < 0:
                continue
            before = num_pairs
            for i in range(first, truth_offsets[frame + 1]):
                if truth_code[i] != found_code[j]:
                    continue
                dx, dz = found[j, 7] - truths[i, 7], found[j, 9] - truths[i, 9]
                distance = math.sqrt(dx * dx + dz * dz)
                if distance < _REACH_M:
                    truth[num_pairs] = i - first
                    errors[num_pairs, 0] = distance
                    errors[num_pairs, 1] = 1.0 - _aligned_iou(found[j], truths[i])
                    errors[num_pairs, 2] = _heading_error(found[j, 10], truths[i, 10])
                    num_pairs += 1
            per_detection[j] = num_pairs - before
    return num_pairs


@compiled
def _aligned_iou(a: Float64[np.ndarray, "11"], b: Float64[np.ndarray, "11"]) -> float:
    """Compute the IoU of two boxes moved and turned onto one another."""
    shared = min(a[4], b[4]) * min(a[5], b[5]) * min(a[6], b[6])
    return float(shared / (a[4] * a[5] * a[6] + b[4] * b[5] * b[6] - shared))


@compiled
def _heading_error(a: float, b: float) -> float:
    """Compute the angle between two headings, 0 to pi."""
    return abs((a - b + math.pi) % (2 * math.pi) - math.pi)
