"""The health of a sample's sensors, one sample at a time or along a drive."""

from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from sightline.health.alignment_checks import check_alignment
from sightline.health.camera_checks import check_camera
from sightline.health.lidar_checks import blind_sectors, check_lidar
from sightline.health.limits import Checks, HealthLimits, SensorLimits, read_limits
from sightline.health.regions import bad_image_regions, bad_sweep_regions
from sightline.health.yaw_error import EdgeMatch, estimate_yaw, match_edges
from sightline.structures.health import Health, SampleHealth
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample

_TELLING = 0.2  # score from which edges are still the scene's, as with some beams missing
# Checks that sound sensors of another make fail: pictures saved as JPEG, fewer beams.
_OF_MAKE = ("still", "muddy", "blocky", "sparse", "ringless", "holes")
_ABSENT = Health(score=0.0, worst_check="absent")


class HealthMonitor:
    """Judges samples one by one, without memory."""

    def __init__(self, limits: HealthLimits | None = None) -> None:
        """Takes limits; None: those that come with Sightline."""
        self.limits = limits or read_limits()

    def __call__(self, sample: CameraLidarSample) -> SampleHealth:
        """The health of a sample; about 35 ms on one core for KITTI's size."""
        return self.judge(sample)[0]

    def judge(
        self, sample: CameraLidarSample, earlier: EdgeMatch | None = None
    ) -> tuple[SampleHealth, EdgeMatch | None]:
        """The health of a sample, its alignment by the edges of earlier frames, too.

        The yaw is estimated wherever both sensors show edges of the scene, also if limits for
        another make of sensor do not fit; the alignment is judged where they fit.

        Args:
            sample: The sample.
            earlier: How the edges of earlier frames match. None: by this sample alone.

        Returns:
            The health; and how the edges of all these frames match, None where this sample's tell
            nothing: then those of earlier ones tell nothing of it.
        """
        sample = level_sample(sample)
        image = rgb_of(sample)
        points = None if sample.points is None else sample.points.numpy()
        camera, is_clear = _judge(self.limits.camera, image, check_camera)
        lidar, is_whole = _judge(self.limits.lidar, points, check_lidar)
        can_judge = min(camera.score, lidar.score) >= _TELLING
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
    """The health of a sensor, and whether it shows edges of the scene, whatever its make."""
    if delivered is None:
        return _ABSENT, False
    checks = check(delivered)
    shows_edges = limits.judge(checks, without=_OF_MAKE).score >= _TELLING
    return limits.judge(checks), shows_edges


def rgb_of(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"] | None:
    """The sample's image, colours last; None where there is none."""
    if sample.image is None:
        return None
    return np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy())
