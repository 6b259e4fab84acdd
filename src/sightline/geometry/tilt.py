"""Tilt of a LiDAR against the road, and the level frame of the detectors. Without PyTorch."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.geometry.mount import turn_ahead

_LEVEL_DEG: Final = 0.05  # smallest tilt that is one


@dataclass(frozen=True, kw_only=True, slots=True)
class Tilt:
    """Roll and pitch of a LiDAR against the road: the first two of a URDF's roll, pitch, yaw.

    The level LiDAR rolls about x, then pitches about y: a positive pitch lowers its front (x), a
    positive roll its right side.

    Examples:
        >>> from sightline.geometry.tilt import Tilt
        >>> nose_down = Tilt(roll_deg=0.0, pitch_deg=12.0)
        >>> nose_down.level_from_lidar[:3, 0].round(2).tolist()  # where x points
        [0.98, 0.0, -0.21]
    """

    roll_deg: float
    pitch_deg: float

    @classmethod
    def from_up(cls, up: Float64[np.ndarray, "3"]) -> "Tilt":
        """Compute the tilt from the vector up, of any length, in the LiDAR's frame."""
        x, y, z = (up / np.linalg.norm(up)).tolist()
        return cls(
            roll_deg=math.degrees(math.atan2(y, z)),
            pitch_deg=math.degrees(math.asin(min(max(-x, -1.0), 1.0))),
        )

    @property
    def level_from_lidar(self) -> Float64[np.ndarray, "4 4"]:
        """Rotation into a level frame whose x axis lies right above or below the LiDAR's."""
        roll, pitch = math.radians(self.roll_deg), math.radians(self.pitch_deg)
        rolled, pitched = np.eye(4), np.eye(4)
        cos, sin = math.cos(roll), math.sin(roll)
        rolled[1:3, 1:3] = [[cos, -sin], [sin, cos]]
        cos, sin = math.cos(pitch), math.sin(pitch)
        pitched[:3, :3] = [[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]]
        return pitched @ rolled

    @property
    def up(self) -> Float64[np.ndarray, "3"]:
        """Unit vector up, in the LiDAR's frame."""
        vertical: Float64[np.ndarray, "3"] = self.level_from_lidar[2, :3]
        return vertical

    @property
    def angle_deg(self) -> float:
        """Angle between the LiDAR's z axis and up."""
        return math.degrees(math.acos(min(max(float(self.up[2]), -1.0), 1.0)))

    @property
    def is_level(self) -> bool:
        """True if roll and pitch of the LiDAR are both below 0.05 degrees."""
        return max(abs(self.roll_deg), abs(self.pitch_deg)) < _LEVEL_DEG

    def __str__(self) -> str:
        """Format both angles in words."""
        nose = "down" if self.pitch_deg > 0 else "up"
        side = "right" if self.roll_deg > 0 else "left"
        return (
            f"{abs(self.pitch_deg):.1f} degrees nose {nose} (pitch) and {abs(self.roll_deg):.1f} "
            f"degrees to the {side} (roll)"
        )


def level_ahead(
    camera_from_lidar: Float64[np.ndarray, "4 4"], tilt: Tilt | None
) -> Float64[np.ndarray, "4 4"] | None:
    """Compute level_from_lidar, the rotation into the detectors' frame: z up, x along the view.

    Args:
        camera_from_lidar: Extrinsics of the mounted LiDAR.
        tilt: Tilt of the LiDAR. None, or less than 0.05 degrees: it is level.

    Returns:
        The rotation; None if the LiDAR's own frame is suitable: see `turn_ahead`.
    """
    if tilt is not None and tilt.is_level:
        tilt = None
    level_from_lidar = np.eye(4) if tilt is None else tilt.level_from_lidar
    ahead_from_level, angle_deg = turn_ahead(camera_from_lidar @ level_from_lidar.T)
    if tilt is None and not angle_deg:
        return None
    rigid: Float64[np.ndarray, "4 4"] = ahead_from_level @ level_from_lidar
    return rigid
