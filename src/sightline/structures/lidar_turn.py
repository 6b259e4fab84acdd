"""Rotation of a LiDAR in its mount that the calibration does not know, and how to undo it."""

import math
from dataclasses import dataclass, replace

from sightline.geometry.transforms import rigid_inverse, rigid_transform, rotation_about_axes
from sightline.geometry.wrong_types import named_fields
from sightline.structures.sample import CameraLidarSample


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class LidarTurn:
    """Rotation of the LiDAR against its calibration, about the axes of its level frame.

    Raises:
        ValueError: An angle is not finite.
    """

    yaw_deg: float = 0.0
    """About z, counter-clockwise seen from the axis's tip, like the others."""
    pitch_deg: float = 0.0
    """About y."""
    roll_deg: float = 0.0
    """About x."""

    def __post_init__(self) -> None:
        """Check the angles."""
        if not all(map(math.isfinite, (self.yaw_deg, self.pitch_deg, self.roll_deg))):
            raise ValueError(f"a LiDAR turns by finite angles, got {self}")

    def __bool__(self) -> bool:
        """Tell whether there is any rotation."""
        return any((self.yaw_deg, self.pitch_deg, self.roll_deg))

    def to_json(self) -> dict[str, float]:
        """List the angles [degrees], rounded to 0.01."""
        return {name: round(getattr(self, name), 2) for name in self.__dataclass_fields__}


def undo_turn(sample: CameraLidarSample, turn: LidarTurn) -> CameraLidarSample:
    """Correct a sample's calibration by a rotation of its LiDAR; the points stay.

    Labels stay too: those of a file made with the uncorrected calibration deviate from the points.
    """
    if not turn:
        return sample
    rotation = rotation_about_axes(turn.yaw_deg, turn.pitch_deg, turn.roll_deg)
    expected_from_turned = rigid_transform(rotation.T, rotation.new_zeros(3))
    level_from_lidar = sample.level_from_lidar
    if level_from_lidar is not None:
        expected_from_turned = (
            rigid_inverse(level_from_lidar) @ expected_from_turned @ level_from_lidar
        )
    calibration = replace(
        sample.calibration,
        camera_from_lidar=sample.calibration.camera_from_lidar @ expected_from_turned,
    )
    return replace(sample, calibration=calibration)
