"""Sample of camera and LiDAR."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Final, Literal, SupportsFloat, SupportsIndex

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from sightline.geometry.arguments import plain_size, plain_text
from sightline.geometry.calibration import Calibration, plain_calibration
from sightline.geometry.checked import checked
from sightline.geometry.cloud_checks import cloud_fault
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.tilt import level_ahead
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.arrays import image_planes, sweep_points, warn_of_view
from sightline.structures.labels import ObjectLabels
from sightline.structures.mounting import plain_height, plain_tilt, pose_of_sweep, warn_of_axes

Sensor = Literal["camera", "lidar"]

SENSOR_FIELDS: Final[Mapping[Sensor, Literal["image", "points"]]] = {
    "camera": "image",
    "lidar": "points",
}
"""Field of a sample that holds the data of each sensor."""

SENSOR_TITLES: Final[Mapping[Sensor, str]] = {"camera": "camera", "lidar": "LiDAR"}
"""Names of the sensors in texts."""

UNNAMED: Final = "sample"
"""Name of a sample from arrays without a name; a data set gives it its own."""

_NUM_DIGEST_DIGITS: Final = 20


@checked(wide=True, remedy="CameraLidarSample.from_arrays converts arrays")
@dataclass(frozen=True, kw_only=True, slots=True)
class CameraLidarSample:
    """A camera image and the LiDAR sweep taken with it.

    LiDAR frame: x forward, y left, z up; it may be rotated about z and tilted by the inverse of
    `level_from_lidar`. Camera frame: x right, y down, z forward. Metres and radians; pixel (0, 0)
    is the centre of the top-left pixel. A sensor that delivered nothing is None; a sweep of zero
    points is valid.

    Examples:
        >>> import dataclasses, sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> blind = dataclasses.replace(sample, image=None)  # the camera delivered nothing
        >>> blind.image_size, blind.points.shape[1]
        ((375, 1242), 4)

    Raises:
        ValueError: The image or the depth map does not have `image_size`.
    """

    sample_id: str
    calibration: Calibration
    image_size: tuple[int, int]
    """Height, width [px] of the camera, with or without an image."""
    image: UInt8[Tensor, "3 height width"] | None = None
    """RGB image."""
    points: Float32[Tensor, "num_points 4"] | None = None
    """Points in the LiDAR frame: x, y, z, reflectance in [0, 1]."""
    objects: ObjectLabels | None = None
    """Object labels; None: the split has none."""
    depth: Float32[Tensor, "height width"] | None = None
    """Ground truth of depth: metres along the optical axis, 0 = unknown."""
    world_from_lidar: Float64[Tensor, "4 4"] | None = None
    """Pose of the LiDAR in the frame of its drive."""
    timestamp_s: float | None = None
    """Seconds since the drive's first frame."""
    lidar_height_m: float | None = None
    """Height of the LiDAR above the road; None: KITTI's height is assumed."""
    level_from_lidar: Float64[Tensor, "4 4"] | None = None
    """Rotation from a tilted or rotated LiDAR's frame to the level frame: x along the camera's
    view, z up. None: the LiDAR's own frame is level. Predictors work in the level frame; their
    predictions are in the LiDAR's own frame, like points and labels."""
    all_around: bool = False
    """Search of the whole turn of the LiDAR by 3D detection. False: the camera's view alone, as
    for KITTI's frames."""

    def __post_init__(self) -> None:
        """Check that all maps have one size."""
        for name, picture in (("image", self.image), ("depth", self.depth)):
            if picture is not None and tuple(picture.shape[-2:]) != self.image_size:
                raise ValueError(
                    f"{name} of sample {self.sample_id} is {picture.shape[-2]}x{picture.shape[-1]} "
                    f"(height x width), expected {self.image_size[0]}x{self.image_size[1]} like "
                    "the camera; resize both or none"
                )

    @property
    def missing_sensors(self) -> tuple[Sensor, ...]:
        """Sensors that delivered nothing."""
        fields = SENSOR_FIELDS.items()
        return tuple(sensor for sensor, field in fields if getattr(self, field) is None)

    @property
    def higher_than_kitti_m(self) -> float:
        """Height of the LiDAR above that of KITTI's, on which detectors are trained [m]."""
        height_m = self.lidar_height_m
        return 0.0 if height_m is None else height_m - KITTI_LIDAR_HEIGHT_M

    @classmethod
    def from_arrays(
        cls,
        calibration: Calibration,
        *,
        image: np.ndarray | Tensor | None = None,
        points: np.ndarray | Tensor | None = None,
        image_size: Sequence[SupportsIndex] | None = None,
        max_intensity: SupportsFloat = 1.0,
        lidar_height_m: SupportsFloat | None = None,
        lidar_tilt_deg: Sequence[SupportsFloat] | np.ndarray | Tensor | None = None,
        sample_id: str = UNNAMED,
        all_around: bool = False,
    ) -> "CameraLidarSample":
        """Create a sample from your arrays; warn of doubtful input and of assumptions.

        The camera may point away from the LiDAR's x axis, and the LiDAR may be tilted by up to some
        20 degrees. Points and all predictions stay in the LiDAR's own frame.

        Examples:
            >>> import numpy as np, sightline
            >>> sample = sightline.CameraLidarSample.from_arrays(
            ...     sightline.Calibration.from_matrices(
            ...         [[1100, 0, 959.5], [0, 1100, 599.5], [0, 0, 1]],
            ...         [[0, -1, 0, 0.1], [0, 0, -1, -0.4], [1, 0, 0, -0.3]],
            ...     ),
            ...     image=np.zeros((1200, 1920, 3), np.uint8),
            ...     points=np.array([[10.0, 1.0, -1.0, 40.0], [20.0, -3.0, 0.5, 255.0]]),
            ...     max_intensity=255.0,
            ...     lidar_height_m=1.9,
            ... )
            >>> sample.points[1].tolist()
            [20.0, -3.0, 0.5, 1.0]

        Args:
            calibration: Calibration, such as from `Calibration.from_matrices`.
            image: RGB or grey of 8 bits: an array of height, width (, 3), or a tensor of
                3, height, width. OpenCV reads BGR: give image[..., ::-1]. Grey is repeated for the
                three channels, with a warning. None: there is no camera.
            points: x, y, z [m] and intensity first; numbers of any type. Rows without an echo (not
                finite, at the origin, or masked in a masked array) are left out, counted by a
                warning (of an organised or masked array only if they are most of it). A missing
                intensity becomes 0 and further columns are left out, both with a warning. None:
                no LiDAR.
            image_size: Height, width [px]; needed only without an image.
            max_intensity: Intensity of a reflectance of 1: often 1, 255 or 65535.
            lidar_height_m: Height of the LiDAR above the road; 0 if the points' origin lies on it.
                None: estimated from the road in the points; if too little of it is visible,
                KITTI's 1.73 m with a warning.
            lidar_tilt_deg: Roll and pitch of the LiDAR against the road, as in a URDF: a positive
                pitch lowers its front. None: estimated from the road in the points, from 4 degrees
                on, with a warning; hills and verges change single sweeps by some 3 degrees.
            sample_id: Name of the sample in errors and of its files. The default becomes the name
                in a data set's `sample_ids`.
            all_around: Whether 3D detection searches the whole turn of the LiDAR, at four times the
                work; else the camera's view alone.

        Raises:
            TypeError: The calibration or the name has another type.
            ValueError: An array has another shape or type, there is neither image nor image_size,
                the image has another size, intensities are not in [0, max_intensity], the points
                are hardly in metres, or height or tilt is not plausible.
        """
        calibration = plain_calibration(calibration)
        sample_id = plain_text("sample_id", sample_id)
        planes = None if image is None else image_planes(image)
        size = _image_size(planes, image_size)
        height_m = None if lidar_height_m is None else plain_height(lidar_height_m)
        tilt = None if lidar_tilt_deg is None else plain_tilt(lidar_tilt_deg)
        sweep = None if points is None else sweep_points(points, max_intensity)
        if sweep is not None and not warn_of_axes(sweep, calibration):
            warn_of_view(sweep, calibration, size)
            pose = pose_of_sweep(sweep, height_m, tilt)
            height_m, tilt = pose.height_m, pose.tilt
        level_from_lidar = level_ahead(calibration.camera_from_lidar.numpy(), tilt)
        return cls(
            sample_id=sample_id,
            calibration=calibration,
            image_size=size,
            image=planes,
            points=sweep,
            lidar_height_m=height_m,
            level_from_lidar=None
            if level_from_lidar is None
            else torch.from_numpy(level_from_lidar),
            all_around=bool(all_around),
        )


def _image_size(
    image: UInt8[Tensor, "3 height width"] | None, image_size: Sequence[SupportsIndex] | None
) -> tuple[int, int]:
    """Height and width [px] of the image, or the given ones without an image."""
    if image_size is None and image is None:
        raise ValueError("a sample without an image needs image_size: give height and width")
    actual = None if image is None else (image.shape[1], image.shape[2])
    size = actual if image_size is None else plain_size("image_size", image_size)
    assert size is not None, "one of them is given"
    if actual is not None and size != actual:
        raise ValueError(
            f"the image is {actual[0]}x{actual[1]} (height x width), but image_size is "
            f"{size[0]}x{size[1]}; give image_size only if there is no image"
        )
    return size


def copy_of_sensors(sample: CameraLidarSample) -> CameraLidarSample:
    """Copy a sample with its image and points, for code that may change them in place."""
    image, points = (
        None if each is None else each.clone() for each in (sample.image, sample.points)
    )
    return replace(sample, image=image, points=points)


def check_points(sample: CameraLidarSample) -> None:
    """Check a sample's sweep: one NaN would spread through a network, other scales mislead it.

    Raises:
        ValueError: A coordinate or a reflectance is NaN or infinite, or the points are no cloud in
            metres with reflectances in [0, 1] (`cloud_fault`).
    """
    if sample.points is None:
        return
    is_finite = sample.points.isfinite().all(dim=1)
    if not is_finite.all():
        raise ValueError(
            f"the sweep of sample {sample.sample_id} holds {int((~is_finite).sum())} points with "
            f"NaN or infinite values, the first is point {int(is_finite.int().argmin())} of "
            f"{len(sample.points)} (from 0); leave them out"
        )
    fault = cloud_fault(sample.points.numpy(), 1.0)
    if fault is not None:
        raise ValueError(
            f"the sweep of sample {sample.sample_id} has {fault[0]}; give x, y, z in metres and "
            "reflectances in [0, 1], as CameraLidarSample.from_arrays makes them"
        )


@named_arguments
def digest_sample(sample: CameraLidarSample) -> str:
    """Compute a digest of all that a sample holds, by which kept results are matched to data."""
    digest = hashlib.sha256()
    _add_to(digest, sample)
    return digest.hexdigest()[:_NUM_DIGEST_DIGITS]


def _add_to(digest: "hashlib._Hash", value: object) -> None:
    if is_dataclass(value):
        for each in fields(value):
            digest.update(each.name.encode())
            _add_to(digest, getattr(value, each.name))
    elif isinstance(value, Tensor):
        digest.update(f"{value.dtype} {tuple(value.shape)}".encode())
        digest.update(value.contiguous().numpy().tobytes())
    else:
        digest.update(repr(value).encode())
