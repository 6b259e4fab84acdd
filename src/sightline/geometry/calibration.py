"""What relates the LiDAR to the camera and the camera to its image."""

from dataclasses import dataclass

import torch
from beartype import beartype
from jaxtyping import Float64, jaxtyped
from torch import Tensor

_ROTATION_TOLERANCE = 1e-3


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """One rectified camera and where the LiDAR sits, in float64.

    KITTI's `P2` maps the rectified frame of camera 0 to the image of camera 2 and holds the
    baseline between the two in its last column. Depth is therefore its third homogeneous
    coordinate: metres along the optical axis from the centre of camera 2, as in KITTI's depth maps.

    >>> import sightline
    >>> from sightline.simulation.packaged import PACKAGED_FRAMES
    >>> calibration = sightline.open_dataset(PACKAGED_FRAMES)[0].calibration
    >>> calibration.image_from_lidar.shape, calibration.crop(100, 50).image_from_camera[0, 2].item()
    (torch.Size([3, 4]), 509.5593)

    Raises:
        ValueError: A matrix is not finite or singular, or camera_from_lidar is not rigid.
    """

    image_from_camera: Float64[Tensor, "*batch 3 4"]
    """Pixels from camera metres, homogeneous (KITTI's P2)."""
    camera_from_lidar: Float64[Tensor, "*batch 4 4"]
    """Rectified camera frame from LiDAR frame (KITTI's R0_rect @ Tr_velo_to_cam)."""

    def __post_init__(self) -> None:
        """Checks what no later step could repair."""
        for name in ("image_from_camera", "camera_from_lidar"):
            if not getattr(self, name).isfinite().all():
                raise ValueError(f"{name} holds NaN or infinite values; calibrate again")
        intrinsics = self.image_from_camera[..., :3]
        scale = intrinsics.abs().amax(dim=(-2, -1)).clamp(min=1e-300)
        if (torch.linalg.det(intrinsics / scale[..., None, None]).abs() < 1e-12).any():
            raise ValueError(
                "the left 3x3 part of image_from_camera (P2) is singular, so no pixel has a ray; "
                "expected focal lengths other than zero"
            )
        rotation = self.camera_from_lidar[..., :3, :3]
        error = rotation @ rotation.transpose(-1, -2) - torch.eye(3).to(rotation)
        if (error.abs() > _ROTATION_TOLERANCE).any() or (torch.linalg.det(rotation) < 0).any():
            raise ValueError(
                "camera_from_lidar (R0_rect @ Tr_velo_to_cam) does not hold a rotation; expected "
                "orthonormal rows and determinant +1"
            )
        bottom = self.camera_from_lidar[..., 3, :]
        if (bottom != bottom.new_tensor([0.0, 0.0, 0.0, 1.0])).any():
            raise ValueError(
                "the last row of camera_from_lidar is not 0 0 0 1, so it is no rigid transform; "
                "build it with rigid_transform"
            )

    @property
    def image_from_lidar(self) -> Float64[Tensor, "*batch 3 4"]:
        """Pixels from LiDAR metres, homogeneous."""
        return self.image_from_camera @ self.camera_from_lidar

    def to(self, device: torch.device | str) -> "Calibration":
        """The same calibration on another device."""
        return Calibration(
            image_from_camera=self.image_from_camera.to(device),
            camera_from_lidar=self.camera_from_lidar.to(device),
        )

    def crop(self, x_min: int, y_min: int) -> "Calibration":
        """The calibration of the image cut so that pixel (x_min, y_min) becomes pixel (0, 0)."""
        return self._with_pixels(
            scale_x=1.0, scale_y=1.0, shift_x=float(-x_min), shift_y=float(-y_min)
        )

    def resize(self, scale_x: float, scale_y: float) -> "Calibration":
        """The calibration of the resized image; pixels are squares around their centres."""
        return self._with_pixels(
            scale_x=scale_x,
            scale_y=scale_y,
            shift_x=(scale_x - 1) / 2,
            shift_y=(scale_y - 1) / 2,
        )

    def _with_pixels(
        self, *, scale_x: float, scale_y: float, shift_x: float, shift_y: float
    ) -> "Calibration":
        new_from_old = self.image_from_camera.new_tensor(
            [[scale_x, 0.0, shift_x], [0.0, scale_y, shift_y], [0.0, 0.0, 1.0]]
        )
        return Calibration(
            image_from_camera=new_from_old @ self.image_from_camera,
            camera_from_lidar=self.camera_from_lidar,
        )
