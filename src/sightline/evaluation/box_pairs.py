"""Boxes of results beside those of labels of one frame: distances, overlaps and nearest pairs."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float64

from sightline.data.checks.result_boxes import ScoredBoxes
from sightline.evaluation.kitti_object_overlaps import ground_and_space_overlap

MAX_DISTANCE_M: Final = 1.0
"""Largest distance from above of a result at a labelled object."""


def nearest_results(results: ScoredBoxes, labels: ScoredBoxes) -> list[tuple[int, int]]:
    """List the labels with a result nearby, each with the nearest one."""
    if not len(results.names):
        return []
    distances_m = ground_distances_m(results, labels)
    near = np.flatnonzero(distances_m.min(axis=1) < MAX_DISTANCE_M)
    return [(label, int(distances_m[label].argmin())) for label in near.tolist()]


def same_class(
    results: ScoredBoxes, labels: ScoredBoxes
) -> Bool[np.ndarray, "num_labels num_results"]:
    """Mask of the pairs of one class."""
    return np.asarray(labels.names[:, None] == results.names[None], dtype=bool)


def ground_distances_m(
    results: ScoredBoxes, labels: ScoredBoxes
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the distances from above of boxes of one class; infinite otherwise."""
    offsets = labels.locations[:, None, ::2] - results.locations[None, :, ::2]
    is_same = same_class(results, labels)
    distances_m = np.where(is_same, np.hypot(*np.moveaxis(offsets, -1, 0)), np.inf)
    return np.where(np.isnan(distances_m), np.inf, distances_m)


def space_ious(
    results: ScoredBoxes, labels: ScoredBoxes, possible: Bool[np.ndarray, "num_labels num_results"]
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the IoU of upright boxes where it is possible, 0 elsewhere."""
    ious = np.zeros(possible.shape)
    result_rows, label_rows = _rows(results), _rows(labels)
    reach_m = np.nan_to_num(np.linalg.norm(results.sizes_hwl, axis=1))
    reach_m = reach_m + np.nan_to_num(np.linalg.norm(labels.sizes_hwl, axis=1))[:, None]
    near = possible & (ground_distances_m(results, labels) < reach_m)
    for label, result in np.argwhere(near).tolist():
        ious[label, result] = ground_and_space_overlap(result_rows[result], label_rows[label])[1]
    return ious


def _rows(boxes: ScoredBoxes) -> Float64[np.ndarray, "num_boxes 11"]:
    """Arrange boxes as rows of `kitti_object_overlaps`."""
    columns = (boxes.boxes2d, boxes.sizes_hwl, boxes.locations, boxes.rotations_y[:, None])
    return np.concatenate(columns, axis=1)
