"""Doubts about the angles of results: alpha that contradicts rotation_y and the location."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.box_readings import FEWEST_RESULTS, is_clear
from sightline.data.kitti_labels import NO_ALPHA, NO_ROTATION
from sightline.data.scored_boxes import ScoredBoxes

_ALIKE_RAD: Final = 0.05
"""Largest difference of equal angles; KITTI's files have two digits."""
_APART_RAD: Final = 0.5
"""Difference of alpha from its formula from which they contradict each other."""


def remarks_on_alphas(boxes: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence on alphas that are not rotation_y less the bearing of the location."""
    given = boxes.alphas != NO_ALPHA
    alphas = boxes.alphas[given]
    if len(alphas) < FEWEST_RESULTS:
        return
    has_3d = given & boxes.has_3d & (boxes.rotations_y != NO_ROTATION)
    turned, (x, _, z) = boxes.rotations_y[has_3d], boxes.locations[has_3d].T
    bearing = np.arctan2(x, z)
    misfit = angle_between(boxes.alphas[has_3d], turned - bearing)
    if not alphas.any():
        if not len(misfit) or np.median(misfit) > _ALIKE_RAD:
            yield (
                f"alpha of all {len(alphas):,} results is 0: orientation similarity is scored by "
                "it; write rotation_y - atan2(x, z), or -10 where it is unknown."
            )
        return
    alphas = boxes.alphas[has_3d]
    others = {
        "rotation_y itself": turned,
        "that of a negated rotation_y": -turned - bearing,
        "negated": bearing - turned,
        "rotation_y plus the bearing": turned + bearing,
    }
    ending = "KITTI's alpha is rotation_y - atan2(x, z), and only alpha is scored as orientation."
    for name, expected in others.items():
        other = angle_between(alphas, expected)
        better = int(((other < _ALIKE_RAD) & (misfit > 2 * _ALIKE_RAD)).sum())
        worse = int(((misfit < _ALIKE_RAD) & (other > 2 * _ALIKE_RAD)).sum())
        if is_clear(better, worse, len(alphas)):
            yield f"alpha of {better:,} of {len(alphas):,} results is probably {name}: {ending}"
            return
    apart = int((misfit > _APART_RAD).sum())
    if len(alphas) >= FEWEST_RESULTS and apart > len(alphas) / 2:
        yield (
            f"alpha of {apart:,} of {len(alphas):,} results contradicts rotation_y and the "
            f"location by more than {_APART_RAD:g} rad: {ending}"
        )


def angle_between(
    angles: Float64[np.ndarray, " num"],
    others: Float64[np.ndarray, " num"],
    *,
    period: float = 2 * np.pi,
) -> Float64[np.ndarray, " num"]:
    """Compute the absolute difference [rad] of angles that repeat after `period`."""
    apart: Float64[np.ndarray, " num"] = np.abs(
        (angles - others + period / 2) % period - period / 2
    )
    return apart
