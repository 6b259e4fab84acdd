"""Health of a sample's sensors, for single samples or along a drive."""

from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from sightline.geometry.arguments import wrong_type
from sightline.geometry.wrong_types import named_arguments
from sightline.health.alignment_checks import check_alignment
from sightline.health.camera_checks import bad_image_regions, check_camera
from sightline.health.lidar_checks import bad_sweep_regions, blind_sectors, check_lidar
from sightline.health.limits import Checks, HealthLimits, SensorLimits, read_limits
from sightline.health.ring_order import level_by_ring
from sightline.health.yaw_error import EdgeMatch, estimate_yaw, match_edges
from sightline.structures.health import Health, SampleHealth
from sightline.structures.sample import CameraLidarSample

_MIN_EDGE_SCORE = 0.2  # minimum score for edges of the scene, e.g. with some beams missing
# Checks that fail for sound sensors of another make: JPEG images, fewer beams.
_SENSOR_SPECIFIC_CHECKS = ("still", "muddy", "blocky", "sparse", "ringless", "holes")
_ABSENT = Health(score=0.0, worst_check="absent")


class HealthMonitor:
    """Health monitor of single samples, without memory."""

    def __init__(self, limits: HealthLimits | None = None) -> None:
        """Take limits; None: those included in Sightline.

        Raises:
            TypeError: `limits` are no limits.
        """
        if not isinstance(limits, HealthLimits | None):
            raise wrong_type("limits", limits, "HealthLimits; read a file by read_limits")
        self.limits = limits or read_limits()

    def __call__(self, sample: CameraLidarSample) -> SampleHealth:
        """Judge a sample; about 35 ms on one core for KITTI's size."""
        return self.judge(sample)[0]

    @named_arguments
    def judge(
        self, sample: CameraLidarSample, earlier: EdgeMatch | None = None
    ) -> tuple[SampleHealth, EdgeMatch | None]:
        """Judge a sample, with the edges of earlier frames for its alignment.

        The yaw is estimated whenever both sensors show edges of the scene, even if the limits do
        not fit this make of sensor; the alignment is judged only if they fit.

        Args:
            sample: The sample.
            earlier: Edge matches of earlier frames. None: only this sample.

        Returns:
            The health; and the edge matches of all these frames, None if this sample has none: then
            earlier matches do not apply to it.
        """
        sample = level_by_ring(sample)
        image = rgb_of(sample)
        points = None if sample.points is None else sample.points.numpy()
        camera, is_clear = _judge(self.limits.camera, image, check_camera)
        lidar, is_whole = _judge(self.limits.lidar, points, check_lidar)
        can_judge = min(camera.score, lidar.score) >= _MIN_EDGE_SCORE
        match = match_edges(sample) if is_clear and is_whole else None
        if match is not None and earlier is not None:
            match = match + earlier
        nothing = np.ones((1, 1), dtype=np.bool_)
        health = SampleHealth(
            sample_id=sample.sample_id,
            camera=camera,
            lidar=lidar,
            alignment=self._alignment(match) if match is not None and can_judge else None,
            yaw_deg=None if match is None else estimate_yaw(match).yaw_deg,
            camera_regions=nothing if image is None else bad_image_regions(image),
            lidar_regions=nothing if points is None else bad_sweep_regions(points),
            blind_sectors=nothing[0] if points is None else blind_sectors(points),
        )
        return health, match

    def _alignment(self, match: EdgeMatch) -> Health:
        return self.limits.alignment.judge(check_alignment(match))


def _judge(
    limits: SensorLimits, delivered: np.ndarray | None, check: Callable[[np.ndarray], Checks]
) -> tuple[Health, bool]:
    """Judge a sensor, and test whether it shows edges of the scene, for any make."""
    if delivered is None:
        return _ABSENT, False
    checks = check(delivered)
    shows_edges = limits.judge(checks, without=_SENSOR_SPECIFIC_CHECKS).score >= _MIN_EDGE_SCORE
    return limits.judge(checks), shows_edges


@named_arguments
def rgb_of(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"] | None:
    """Convert the sample's image to channels last; None if there is none."""
    if sample.image is None:
        return None
    return np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy())
