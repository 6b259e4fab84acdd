"""Alignment checks between camera and LiDAR, from edges in both."""

from typing import NamedTuple

from sightline.health.tilt_error import estimate_tilt
from sightline.health.yaw_error import EdgeMatch, estimate_yaw, match_at_zero


class AlignmentChecks(NamedTuple):
    """Checks of edge matches; a larger number is a worse match."""

    turned: float
    """Absolute estimated rotation of the LiDAR about z [degrees]."""
    mismatched: float
    """Advantage of the best angle over the calibration's, in standard deviations of the match
    curve."""
    tilted: float
    """Advantage of the best pitch and roll over the calibration's by upper edges, in standard
    deviations of the match curve."""


MIN_SPREADS = AlignmentChecks(turned=0.4, mismatched=1.0, tilted=1.0)
"""Minimum spreads for limits that also serve other sensors: variation of each check between sound
mounts of other makes, and in streets with fewer edges."""


def check_alignment(match: EdgeMatch) -> AlignmentChecks:
    """Check the edge matches of one or more frames."""
    yaw_deg = estimate_yaw(match).yaw_deg
    return AlignmentChecks(
        turned=abs(yaw_deg),
        mismatched=match_at_zero(match),
        tilted=estimate_tilt(match.tops).behind,
    )
