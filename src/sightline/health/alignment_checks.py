"""What is wrong between camera and LiDAR, told by the edges that both see."""

from typing import NamedTuple

from sightline.health.tilt_error import estimate_tilt
from sightline.health.yaw_error import EdgeMatch, estimate_yaw, match_at_zero


class AlignmentChecks(NamedTuple):
    """What is looked at in how edges match; each number grows as the match gets worse."""

    turned: float
    """Degrees that the LiDAR seems turned by, about z, either way."""
    mismatched: float
    """How much better edges match at the best angle than as the calibration says, in standard
    deviations of the curve."""
    tilted: float
    """Likewise of upper edges, over all angles of pitch and roll."""


LEAST_SPREADS = AlignmentChecks(turned=0.4, mismatched=1.0, tilted=1.0)
"""By how much each differs between sound mounts of other makes, and streets harder to tell: least
spreads for limits that shall serve them, too."""


def check_alignment(match: EdgeMatch) -> AlignmentChecks:
    """Looks at how the edges of one or more frames match."""
    yaw_deg = estimate_yaw(match).yaw_deg
    return AlignmentChecks(
        turned=abs(yaw_deg),
        mismatched=match_at_zero(match),
        tilted=estimate_tilt(match.tops).behind,
    )
