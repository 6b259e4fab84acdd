"""Upright boxes in the LiDAR frame, and their conversion from and to KITTI's labels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import Rows, selected_rows
from sightline.geometry.transforms import (
    rigid_inverse,
    transform_points,
    wrap_angle,
    yaw_rotation,
)

_NUM_COORDINATES = 3
# Front left, front right, rear right, rear left; first the bottom four, then the top four: the
# order of KITTI's development kit.
_CORNER_SIGNS = (
    (1, 1, -1),
    (1, -1, -1),
    (-1, -1, -1),
    (-1, 1, -1),
    (1, 1, 1),
    (1, -1, 1),
    (-1, -1, 1),
    (-1, 1, 1),
)


@checked()
@dataclass(frozen=True, slots=True)
class Boxes3D:
    """Upright boxes: x, y, z of the geometric centre, length, width, height, yaw.

    LiDAR frame (x forward, y left, z up), metres and radians. Length, width and height lie along
    the box's own x, y, z. Yaw is counter-clockwise from above, 0 faces +x, in [-pi, pi).

    In the frame of a LiDAR that is tilted against the road, centres are exact and a yaw is the
    heading seen along the LiDAR's z axis. `corners` and `contain` assume that boxes stand along
    that axis, and neglect that they stand on the road. `to_level` converts to a frame where this is
    exact.

    Examples:
        >>> import torch
        >>> from sightline import Boxes3D
        >>> car = Boxes3D(torch.tensor([[12.0, -2.0, -0.9, 4.0, 2.0, 1.5, 0.0]]))
        >>> car.contain(torch.tensor([[13.9, -2.0, -0.9], [14.1, -2.0, -0.9]])).tolist()
        [[True, False]]
        >>> car.corners()[0, 0].tolist()  # front left, at the bottom
        [14.0, -1.0, -1.649999976158142]
    """

    tensor: Float[Tensor, "*batch num_boxes 7"]

    def __len__(self) -> int:
        """Number of boxes (of each batch entry)."""
        return self.tensor.shape[-2]

    def __getitem__(self, index: Rows) -> "Boxes3D":
        """Select boxes of an unbatched set, by indices, mask or slice; one by its number."""
        return Boxes3D(self.tensor[selected_rows(index, len(self.tensor))])

    def __iter__(self) -> Iterator[Float[Tensor, "7"]]:
        """Yield the numbers of each box of an unbatched set."""
        return iter(self.tensor)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:  # noqa: ANN401, FBT001
        """Convert to an array, on the CPU."""
        return np.array(self.tensor.detach().cpu().numpy(), dtype, copy=copy)

    def to(self, device: torch.device | str) -> "Boxes3D":
        """Return the boxes on another device."""
        return Boxes3D(self.tensor.to(device))

    @property
    def centers(self) -> Float[Tensor, "*batch num_boxes 3"]:
        """Geometric centres [m]."""
        return self.tensor[..., :3]

    @property
    def sizes(self) -> Float[Tensor, "*batch num_boxes 3"]:
        """Length, width, height [m]."""
        return self.tensor[..., 3:6]

    @property
    def yaws(self) -> Float[Tensor, "*batch num_boxes"]:
        """Headings [rad]."""
        return self.tensor[..., 6]

    @property
    def bev(self) -> Float[Tensor, "*batch num_boxes 5"]:
        """Boxes from above: x, y, length, width, yaw."""
        return self.tensor[..., [0, 1, 3, 4, 6]]

    def corners(self) -> Float[Tensor, "*batch num_boxes 8 3"]:
        """Compute corners [m]: front left, front right, rear right, rear left; bottom, then top."""
        signs = self.tensor.new_tensor(_CORNER_SIGNS)
        offsets = self.sizes[..., None, :] / 2 * signs
        return self.centers[..., None, :] + offsets @ yaw_rotation(self.yaws).transpose(-1, -2)

    def enlarge(self, margin_m: float) -> "Boxes3D":
        """Move every face outwards by `margin_m`, so that each size grows by twice that."""
        grown = torch.cat((self.centers, self.sizes + 2 * margin_m, self.tensor[..., 6:]), dim=-1)
        return Boxes3D(grown)

    def turn(self, yaw_rad: float) -> "Boxes3D":
        """Turn the boxes about the origin's z axis, counter-clockwise from above."""
        rotation = yaw_rotation(self.tensor.new_tensor(yaw_rad))
        yaws = wrap_angle(self.tensor[..., 6:] + yaw_rad)
        return Boxes3D(torch.cat((self.centers @ rotation.T, self.sizes, yaws), dim=-1))

    def from_level(self, level_from_own: Float64[Tensor, "4 4"]) -> "Boxes3D":
        """Convert boxes of a level frame to a tilted or turned frame; see the class.

        Args:
            level_from_own: Rotation, and translation, into the level frame.
        """
        yaws = self.yaws.double()
        headings = torch.stack((yaws.cos(), yaws.sin(), torch.zeros_like(yaws)), dim=-1)
        return self._moved(rigid_inverse(level_from_own), headings)

    def to_level(self, level_from_own: Float64[Tensor, "4 4"]) -> "Boxes3D":
        """Convert boxes of a tilted or turned frame to the level one: inverse of `from_level`."""
        yaws, up = self.yaws.double(), level_from_own[2, :3]
        cos, sin = yaws.cos(), yaws.sin()
        rise = -(up[0] * cos + up[1] * sin) / up[2]  # slope of the heading, which lies in the road
        return self._moved(level_from_own, torch.stack((cos, sin, rise), dim=-1))

    def _moved(
        self, new_from_old: Float64[Tensor, "4 4"], headings: Float64[Tensor, "*batch num_boxes 3"]
    ) -> "Boxes3D":
        turned = headings @ new_from_old[:3, :3].T
        yaws = wrap_angle(torch.atan2(turned[..., 1], turned[..., 0])).to(self.tensor.dtype)
        centers = transform_points(new_from_old, self.centers)
        return Boxes3D(torch.cat((centers, self.sizes, yaws[..., None]), dim=-1))

    def where(self, mask: Bool[Tensor, " num_boxes"], other: "Boxes3D") -> "Boxes3D":
        """Select boxes where the mask is set, and those of `other` elsewhere."""
        return Boxes3D(torch.where(mask[:, None], self.tensor, other.tensor))

    def to_canonical(
        self, points: Float[Tensor, "*batch num_points 3"]
    ) -> Float[Tensor, "*batch num_boxes num_points 3"]:
        """Transform points [m] to each box's frame: origin in its centre, x along its heading.

        Raises:
            ValueError: Points have other columns than x, y, z.
        """
        if points.shape[-1] != _NUM_COORDINATES:
            raise ValueError(
                f"points have {points.shape[-1]} columns, expected x, y, z; give points[..., :3]"
            )
        # Subtract first: this keeps precision far from the origin.
        offsets = points[..., None, :, :] - self.centers[..., :, None, :]
        return offsets @ yaw_rotation(self.yaws).to(offsets.dtype)

    def contain(
        self, points: Float[Tensor, "*batch num_points 3"]
    ) -> Bool[Tensor, "*batch num_boxes num_points"]:
        """Mask of points in boxes, faces included. Takes O(num_boxes * num_points)."""
        return (self.to_canonical(points).abs() <= self.sizes[..., :, None, :] / 2).all(dim=-1)


def yaw_from_kitti_rotation(rotation_y: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Convert KITTI's rotation_y to yaw in the LiDAR frame; its own inverse.

    KITTI turns about the camera's downward y axis from the camera's x axis, which is -y of the
    LiDAR frame; the small tilt between the sensors is neglected, as is usual in the field.
    """
    return wrap_angle(-rotation_y - math.pi / 2)


def boxes3d_from_kitti(
    dimensions_hwl: Float[Tensor, "num_boxes 3"],
    bottom_centers: Float[Tensor, "num_boxes 3"],
    rotation_y: Float[Tensor, " num_boxes"],
    camera_from_lidar: Float[Tensor, "4 4"],
) -> Boxes3D:
    """Make boxes from KITTI label columns: (h, w, l), bottom centre, rotation about camera y.

    Args:
        dimensions_hwl: Height, width, length [m].
        bottom_centers: Centre of the bottom face in the rectified camera frame [m].
        rotation_y: Radians.
        camera_from_lidar: Extrinsics of the frame's calibration.
    """
    raised = bottom_centers.clone()
    raised[:, 1] -= dimensions_hwl[:, 0] / 2  # camera y points down
    centers = transform_points(rigid_inverse(camera_from_lidar), raised)
    yaws = yaw_from_kitti_rotation(rotation_y)
    return Boxes3D(torch.cat((centers, dimensions_hwl.flip(-1), yaws[:, None]), dim=-1))


def kitti_from_boxes3d(
    boxes: Boxes3D, camera_from_lidar: Float[Tensor, "4 4"]
) -> tuple[Float[Tensor, "num_boxes 3"], Float[Tensor, "num_boxes 3"], Float[Tensor, " num_boxes"]]:
    """Compute the columns of a KITTI label: the inverse of `boxes3d_from_kitti`.

    Returns:
        Height, width, length [m]; bottom centres in the rectified camera frame [m]; rotation_y
        [rad], in [-pi, pi).
    """
    bottom_centers = transform_points(camera_from_lidar, boxes.centers)
    bottom_centers[:, 1] += boxes.sizes[:, 2] / 2
    return boxes.sizes.flip(-1), bottom_centers, yaw_from_kitti_rotation(boxes.yaws)
