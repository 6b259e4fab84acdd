"""Calibration of a camera and a LiDAR: intrinsics and extrinsics."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import SupportsFloat

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from sightline.geometry.arguments import short_repr, wrong_type
from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import plain_numbers
from sightline.geometry.mount import camera_fault, mount_doubt, pixel_doubt
from sightline.geometry.rotations import ROTATION_TOLERANCE, rotation_fault
from sightline.geometry.user_warning import warn_user

Matrix = Tensor | np.ndarray | Sequence[Sequence[SupportsFloat]]
"""Rows of numbers of any type, as users have them."""


@checked(remedy="Calibration.from_matrices converts matrices")
@dataclass(frozen=True, kw_only=True, slots=True)
class Calibration:
    """Intrinsics of one rectified camera and extrinsics of the LiDAR, in float64.

    KITTI's `P2` maps the rectified frame of camera 0 to the image of camera 2 and holds the
    baseline between the two in its last column. Depth is therefore its third homogeneous
    coordinate: metres along the optical axis from the centre of camera 2, as in KITTI's depth maps.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> calibration = sightline.open_dataset(PACKAGED_FRAMES)[0].calibration
        >>> cropped = calibration.crop(100, 50)
        >>> cropped.image_from_lidar.shape, cropped.image_from_camera[0, 2].item()
        (torch.Size([3, 4]), 509.5593)

    Raises:
        ValueError: A matrix is not finite or singular, or camera_from_lidar is not rigid.
    """

    image_from_camera: Float64[Tensor, "*batch 3 4"]
    """Pixels from camera metres, homogeneous (KITTI's P2)."""
    camera_from_lidar: Float64[Tensor, "*batch 4 4"]
    """Rectified camera frame from LiDAR frame (KITTI's R0_rect @ Tr_velo_to_cam)."""

    def __post_init__(self) -> None:
        """Check for errors that no later step could repair."""
        for name in ("image_from_camera", "camera_from_lidar"):
            if not getattr(self, name).isfinite().all():
                raise ValueError(f"{name} holds NaN or infinite values; calibrate again")
        intrinsics = self.image_from_camera[..., :3]
        scale = intrinsics.abs().amax(dim=(-2, -1)).clamp(min=1e-300)
        if (torch.linalg.det(intrinsics / scale[..., None, None]).abs() < 1e-12).any():
            raise ValueError(
                "the left 3x3 part of the camera matrix (image_from_camera) is singular, so no "
                "pixel has a ray; expected focal lengths other than zero"
            )
        rotation = self.camera_from_lidar[..., :3, :3]
        is_mirror = torch.linalg.det(rotation) < 0
        error = rotation @ rotation.transpose(-1, -2) - torch.eye(3).to(rotation)
        is_faulty = is_mirror | (error.abs() > ROTATION_TOLERANCE).any(dim=(-2, -1))
        if is_faulty.any():
            fault = rotation_fault(rotation[is_faulty].reshape(-1, 3, 3)[0].cpu().numpy())
            raise ValueError(f"camera_from_lidar holds no rotation: {fault}")
        bottom = self.camera_from_lidar[..., 3, :]
        if (bottom != bottom.new_tensor([0.0, 0.0, 0.0, 1.0])).any():
            raise ValueError(
                "the last row of camera_from_lidar is not 0 0 0 1, so it is not rigid; "
                "build it with rigid_transform"
            )

    @classmethod
    def from_matrices(
        cls,
        camera_matrix: Matrix,
        camera_from_lidar: Matrix,
        *,
        distortion: Sequence[SupportsFloat] | np.ndarray | Tensor | None = None,
    ) -> "Calibration":
        """Make a calibration from a camera matrix and extrinsics.

        Warns, with the likely mistake, of mounts that no vehicle has or pixels that are no squares.

        Examples:
            >>> from sightline import Calibration
            >>> calibration = Calibration.from_matrices(
            ...     [[1100, 0, 959.5], [0, 1100, 599.5], [0, 0, 1]],
            ...     [[0, -1, 0, 0.1], [0, 0, -1, -0.4], [1, 0, 0, -0.3], [0, 0, 0, 1]],
            ... )
            >>> calibration.image_from_camera.dtype
            torch.float64

        Args:
            camera_matrix: 3x3, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels, or 3x4. Pixel
                (0, 0) is the centre of the top-left pixel.
            camera_from_lidar: 4x4 or 3x4: the camera's optical frame (x right, y down, z forward)
                from the LiDAR frame (x forward, y left, z up), metres.
            distortion: Coefficients of the lens, in any model; only zeros are accepted.

        Raises:
            ValueError: A matrix has another shape, is not finite or not of its kind, or the lens
                distorts.
        """
        _refuse_distortion(distortion)
        camera = _numbers(camera_matrix, "camera_matrix", ((3, 3), (3, 4)))
        rigid = _numbers(camera_from_lidar, "camera_from_lidar", ((4, 4), (3, 4)))
        fault = camera_fault(camera)
        if fault is not None:
            raise ValueError(f"camera_matrix {fault}")
        if len(rigid) == 4 and rigid[3, :3].any() and not rigid[:3, 3].any():
            raise ValueError("camera_from_lidar is transposed; give its transpose")
        calibration = cls(
            image_from_camera=torch.from_numpy(np.pad(camera, ((0, 0), (0, 4 - camera.shape[1])))),
            camera_from_lidar=torch.from_numpy(
                rigid if len(rigid) == 4 else np.vstack((rigid, (0.0, 0.0, 0.0, 1.0)))
            ),
        )
        for name, doubt in (
            ("camera_matrix", pixel_doubt(camera)),
            ("camera_from_lidar", mount_doubt(calibration.camera_from_lidar.numpy())),
        ):
            if doubt is not None:
                warn_user(f"{name} {doubt}")
        return calibration

    @property
    def image_from_lidar(self) -> Float64[Tensor, "*batch 3 4"]:
        """Projection matrix: pixels from LiDAR metres, homogeneous."""
        return self.image_from_camera @ self.camera_from_lidar

    def to(self, device: torch.device | str) -> "Calibration":
        """Return the calibration on another device."""
        return Calibration(
            image_from_camera=self.image_from_camera.to(device),
            camera_from_lidar=self.camera_from_lidar.to(device),
        )

    def crop(self, x_min: int, y_min: int) -> "Calibration":
        """Calibration after cropping: pixel (x_min, y_min) of the image becomes pixel (0, 0)."""
        return self._with_pixels(
            scale_x=1.0, scale_y=1.0, shift_x=float(-x_min), shift_y=float(-y_min)
        )

    def resize(self, scale_x: float, scale_y: float) -> "Calibration":
        """Calibration after resizing the image; pixels are squares around their centres."""
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


def _numbers(
    matrix: Matrix, name: str, shapes: Sequence[tuple[int, int]]
) -> Float64[np.ndarray, "rows columns"]:
    numbers = plain_numbers(name, matrix)
    if numbers.shape not in shapes:
        expected = " or ".join(f"{rows}x{columns}" for rows, columns in shapes)
        got = "x".join(map(str, numbers.shape))
        if numbers.ndim < 2:
            got = short_repr(matrix)
        hint = _shape_hint(numbers, shapes)
        raise ValueError(f"{name} is {got}, expected a matrix of {expected} numbers{hint}")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} holds NaN or infinite values; calibrate again")
    return numbers


def _shape_hint(numbers: Float64[np.ndarray, "..."], shapes: Sequence[tuple[int, int]]) -> str:
    """Remedy for a matrix of another shape if it is obvious; otherwise empty."""
    flat = next((shape for shape in shapes if numbers.shape == (shape[0] * shape[1],)), None)
    if flat is not None:
        return f"; give .reshape({flat[0]}, {flat[1]})"
    if numbers.shape == (4, 3):
        return "; it is probably transposed"
    if numbers.shape == (4, 4) and (3, 3) in shapes:
        return "; give its first three rows, or, if it is camera_from_lidar, swap the arguments"
    return ""


def _refuse_distortion(distortion: Sequence[SupportsFloat] | np.ndarray | Tensor | None) -> None:
    if distortion is None:
        return
    coefficients = plain_numbers("distortion", distortion).ravel()
    if coefficients.any():
        values = ", ".join(f"{value:.4g}" for value in coefficients)
        raise ValueError(
            f"distortion is {values}, expected zeros: a calibration describes rectified images; "
            "rectify images with sightline.undistort and omit the distortion"
        )


def plain_calibration(value: object) -> Calibration:
    """Check that a value is a calibration.

    Raises:
        TypeError: It is not.
    """
    if not isinstance(value, Calibration):
        raise wrong_type(
            "calibration",
            value,
            "a Calibration; make one by Calibration.from_matrices(camera_matrix, "
            "camera_from_lidar), or use the calibration of a sample",
        )
    return value


def centred_image_size(
    image_from_camera: Float64[Tensor, "3 4"] | Float64[np.ndarray, "3 4"],
) -> tuple[int, int]:
    """Height and width [px] of an image whose centre is the principal point.

    It is a guess for a camera without pictures: KITTI's are 22 px wider and 28 px higher.
    """
    x, y = image_from_camera[:2, 2].tolist()
    return max(round(2 * y + 1), 1), max(round(2 * x + 1), 1)
