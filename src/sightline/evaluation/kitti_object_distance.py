"""KITTI's object scores by distance of the objects. Not one of KITTI's own measures."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sightline.evaluation.kitti_object_pairs import MatchingData
from sightline.evaluation.kitti_object_rules import NEVER, MinimumOverlaps
from sightline.evaluation.kitti_object_scores import score_objects
from sightline.evaluation.object_report import DistanceBand, ObjectEntry


def score_by_distance(
    data: MatchingData, overlaps: MinimumOverlaps, edges_m: Sequence[float]
) -> tuple[DistanceBand, ...]:
    """Score each band of horizontal distances from the camera separately.

    A band counts its objects and, as false positives, its detections without any match. An object
    in another band may be found, but is not missed, and a false detection counts in its own band.

    Args:
        data: All frames, their pairs found with the same overlaps.
        overlaps: Overlaps that a match must exceed.
        edges_m: Borders between bands, ascending; the first band begins at 0 and the last has no
            end.

    Raises:
        ValueError: The edges are not ascending from above 0, or a detection has no location.
    """
    check_edges(edges_m)
    if np.isnan(data.detection_range_m).any():
        raise ValueError(
            "scores by distance need detections with 3D locations, and some have none (-1000); "
            "leave the distances out"
        )
    return tuple(
        DistanceBand(from_m=low, to_m=high, entries=_band(data, overlaps, low, high))
        for low, high in pairwise((0.0, *edges_m, math.inf))
    )


def check_edges(edges_m: Sequence[float]) -> None:
    """Check the edges of bands.

    Raises:
        ValueError: They are not ascending from above 0, or one is not finite.
    """
    if not all(low < high < math.inf for low, high in pairwise((0.0, *edges_m))):
        told = ", ".join(f"{edge:g}" for edge in edges_m)
        raise ValueError(f"distances must rise from above 0 and be finite, got {told}")


def _band(
    data: MatchingData, overlaps: MinimumOverlaps, low_m: float, high_m: float
) -> tuple[ObjectEntry, ...]:
    is_counted, is_found = (
        (low_m <= ranges_m) & (ranges_m < high_m)
        for ranges_m in (data.truth_range_m, data.detection_range_m)
    )
    banded = replace(
        data,
        truth_level=np.where(is_counted, data.truth_level, NEVER).astype(np.int8),
        detection_forgiven=data.detection_forgiven | ~is_found[:, None],
    )
    return score_objects(banded, overlaps).entries
