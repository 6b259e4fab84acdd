"""Doubts about alpha, the observation angle of objects, in results and in labels."""

from collections.abc import Iterator
from operator import itemgetter
from typing import Final, Literal

import numpy as np

from sightline.data.checks.result_boxes import (
    MIN_RESULTS,
    ScoredBoxes,
    angle_between,
    is_clearly_better,
)
from sightline.data.formats.kitti_labels import NO_ALPHA, NO_ROTATION

ALPHA_REMEDY: Final = "write rotation_y - atan2(x, z)"
_EQUAL_ANGLES_RAD: Final = 0.05
"""Largest difference of equal angles; KITTI's files have two digits."""
_CONTRADICTION_RAD: Final = 0.5
"""Difference of alpha from its formula from which they contradict each other; the labels of 90
frames of KITTI's deviate by up to 0.08."""


def remarks_on_alphas(results: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on alphas that are not rotation_y minus the bearing of the location."""
    doubt = _doubt(results, "results")
    if doubt is None:
        return
    if not np.ptp(results.alphas[results.alphas != NO_ALPHA]):
        yield (
            f"{doubt}: orientation similarity is scored by it; {ALPHA_REMEDY}, or {NO_ALPHA:g} "
            "where it is unknown."
        )
        return
    yield (
        f"{doubt}: KITTI's alpha is rotation_y - atan2(x, z), and only alpha is scored as "
        "orientation."
    )


def doubt_about_labels(labels: ScoredBoxes) -> str | None:
    """Clause on alphas of labels by which no orientation can be scored; None: they are sound.

    Labels in degrees, of which another check tells, raise no doubt.
    """
    is_unknown = labels.alphas == NO_ALPHA
    angles = (labels.alphas[~is_unknown], labels.rotations_y[labels.rotations_y != NO_ROTATION])
    if any((np.abs(each) > 2 * np.pi).any() for each in angles):
        return None
    if is_unknown.all() and len(is_unknown) >= MIN_RESULTS:
        return f"alpha of all {len(is_unknown):,} labels is {NO_ALPHA:g}, KITTI's number for none"
    return _doubt(labels, "labels")


def _doubt(boxes: ScoredBoxes, kind: Literal["results", "labels"]) -> str | None:
    """Clause on alphas that contradict rotation_y and the location of most boxes."""
    has_alpha = boxes.alphas != NO_ALPHA
    alphas = boxes.alphas[has_alpha]
    if len(alphas) < MIN_RESULTS:
        return None
    has_3d = has_alpha & boxes.has_3d & (boxes.rotations_y != NO_ROTATION)
    rotations, (x, _, z) = boxes.rotations_y[has_3d], boxes.locations[has_3d].T
    bearing = np.arctan2(x, z)
    error = angle_between(boxes.alphas[has_3d], rotations - bearing)
    if not np.ptp(alphas):
        is_sound = len(error) and np.median(error) <= _EQUAL_ANGLES_RAD
        return None if is_sound else f"alpha of all {len(alphas):,} {kind} is {alphas[0]:g}"
    alphas = boxes.alphas[has_3d]
    others = {
        "rotation_y itself": rotations,
        "half a turn off, or rotation_y is": rotations - bearing + np.pi,
        "that of a negated rotation_y, or rotation_y is negated": -rotations - bearing,
        "negated": bearing - rotations,
        "rotation_y plus the bearing": rotations + bearing,
    }
    found: list[tuple[int, str]] = []
    for name, expected in others.items():
        other = angle_between(alphas, expected)
        better = int(((other < _EQUAL_ANGLES_RAD) & (error > 2 * _EQUAL_ANGLES_RAD)).sum())
        worse = int(((error < _EQUAL_ANGLES_RAD) & (other > 2 * _EQUAL_ANGLES_RAD)).sum())
        if is_clearly_better(better, worse, len(alphas)):
            found.append((better, name))
    if found:
        better, name = max(found, key=itemgetter(0))
        return f"alpha of {better:,} of {len(alphas):,} {kind} is probably {name}"
    contradicting = int((error > _CONTRADICTION_RAD).sum())
    if len(alphas) >= MIN_RESULTS and contradicting > len(alphas) / 2:
        return (
            f"alpha of {contradicting:,} of {len(alphas):,} {kind} contradicts rotation_y and the "
            f"location by more than {_CONTRADICTION_RAD:g} rad"
        )
    return None
