"""Points of users' clouds without an echo: their selection, and counts of losses.

Without PyTorch, for checks that start at once.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from sightline.geometry.user_warning import warn_user

USUAL_LOSS: Final = 0.5
"""Share of points without an echo in a cloud that may include rays into the sky."""

_NO_RANGE_M: Final = 1e-3
"""Largest coordinate of points at the sensor itself. A sweep of nuScenes has 3,756 within 0.31 mm,
and the next one at 0.34 m."""


def echoes(points: Float[np.ndarray, "num_points 4"]) -> Float[np.ndarray, "num_echoes 4"]:
    """Keep the points with an echo: x, y, z are finite, and not all within 1 mm of 0.

    For missing echoes, drivers write values that are not finite, the largest possible ones, or the
    sensor's own place, sometimes with rounding errors. An intensity that is not finite becomes 0,
    as if there were none: `losses` counts both.
    """
    kept: Float[np.ndarray, "num_echoes 4"] = points[is_echo(points)]
    unusable = ~_is_finite(kept[:, 3])
    if unusable.any():
        kept[unusable, 3] = 0
    return kept


def losses(
    points: Float[np.ndarray, "num_points 4"], *, usual_share: float = USUAL_LOSS
) -> tuple[str, ...]:
    """List the unusual losses of `echoes`, each with counts, as the rest of a sentence.

    Points without an echo are usual, up to half of a cloud with rays into the sky; an intensity
    that is not finite is not.

    Args:
        points: x, y, z and intensity.
        usual_share: Share of points without an echo up to which their loss is not listed.
    """
    has_echo = is_echo(points)
    num_left = int(np.count_nonzero(has_echo))
    num_lost = len(points) - num_left
    messages = []
    if num_lost > usual_share * len(points):
        num_not_finite = np.count_nonzero(~_is_finite(points[:, :3]).all(axis=1))
        messages.append(
            f"{num_lost} of {len(points)} points are left out, {num_not_finite} with x, y, z not "
            f"finite and {num_lost - num_not_finite} at 0, 0, 0: "
            + (f"{num_left} are left" if num_left else "none is left, the cloud is empty")
        )
    num_without_intensity = np.count_nonzero(~_is_finite(points[has_echo, 3]))
    if num_without_intensity:
        messages.append(
            f"{num_without_intensity} of {num_left} points have an intensity that is not "
            "finite: it is set to 0"
        )
    return tuple(messages)


def describe_losses(clouds: Sequence[Float[np.ndarray, "_num_points 4"]]) -> tuple[str, ...]:
    """Describe the points without an echo in the checked clouds, in a clause; empty: none."""
    num_points = sum(map(len, clouds))
    num_lost = sum(int(np.count_nonzero(~is_echo(each))) for each in clouds)
    num_non_finite = sum(
        int(np.count_nonzero(~np.isfinite(each[:, :3]).all(axis=1))) for each in clouds
    )
    if not num_lost:
        return ()
    return (
        f"of {num_points} points in {sum(len(each) > 0 for each in clouds)} checked clouds "
        f"{num_lost} have no echo and are left out: {num_non_finite} with non-finite x, y, z, "
        f"{num_lost - num_non_finite} at 0, 0, 0",
    )


def warn_of_losses(
    points: Float[np.ndarray, "num_points 4"], source: str, *, usual_share: float = USUAL_LOSS
) -> None:
    """Warn about the losses of `losses`, with the name of the cloud's file or topic."""
    for loss in losses(points, usual_share=usual_share):
        warn_user(f"{source}: {loss}")


def is_echo(points: Float[np.ndarray, "num_points fields"]) -> Bool[np.ndarray, " num_points"]:
    """Mask of the points with an echo: x, y, z, the first fields, are finite, one beyond 1 mm."""
    places = points[:, :3]
    is_away = (np.abs(places) > _NO_RANGE_M).any(axis=1)
    return np.asarray(_is_finite(places).all(axis=1) & is_away)


def _is_finite(values: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    with np.errstate(over="ignore"):  # values beyond float32, a sweep's type, become infinite
        return np.isfinite(values.astype(np.float32))
