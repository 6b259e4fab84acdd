"""One moment as the sensors saw it."""

from dataclasses import dataclass

from beartype import beartype
from jaxtyping import Float32, Float64, UInt8, jaxtyped
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.structures.labels import ObjectLabels


@jaxtyped(typechecker=beartype)
@dataclass(frozen=True, kw_only=True, slots=True)
class CameraLidarSample:
    """A camera image and the LiDAR sweep taken with it.

    LiDAR frame: x forward, y left, z up. Camera frame: x right, y down, z forward. Metres and
    radians; pixel (0, 0) is the centre of the top-left pixel. A sensor that delivered nothing is
    None; a sweep of zero points is a sweep.

    >>> import dataclasses, sightline
    >>> from sightline.simulation.packaged import PACKAGED_FRAMES
    >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
    >>> blind = dataclasses.replace(sample, image=None)  # the camera delivered nothing
    >>> blind.image_size, blind.points.shape[1]
    ((375, 1242), 4)

    Raises:
        ValueError: The image or the depth map is not of `image_size`.
    """

    sample_id: str
    calibration: Calibration
    image_size: tuple[int, int]
    """Height, width [px] of the camera, with or without an image."""
    image: UInt8[Tensor, "3 height width"] | None = None
    """RGB."""
    points: Float32[Tensor, "num_points 4"] | None = None
    """LiDAR frame: x, y, z, reflectance in [0, 1]."""
    objects: ObjectLabels | None = None
    """None where the split has no labels."""
    depth: Float32[Tensor, "height width"] | None = None
    """Ground truth: metres along the optical axis, 0 = unknown."""
    world_from_lidar: Float64[Tensor, "4 4"] | None = None
    """Where the sweep was taken, in the frame of its drive."""
    timestamp_s: float | None = None
    """Seconds since the drive's first frame."""

    def __post_init__(self) -> None:
        """Checks that all maps are of one size."""
        for name, picture in (("image", self.image), ("depth", self.depth)):
            if picture is not None and tuple(picture.shape[-2:]) != self.image_size:
                raise ValueError(
                    f"{name} of sample {self.sample_id} is {picture.shape[-2]}x{picture.shape[-1]} "
                    f"(height x width), expected {self.image_size[0]}x{self.image_size[1]} like "
                    "the camera; resize both or none"
                )
