"""The health of a sample's sensors, one sample at a time or along a drive."""

import numpy as np
from jaxtyping import Bool, UInt8

from sightline.data.view import is_in_view
from sightline.health.alignment_checks import check_alignment
from sightline.health.camera_checks import check_camera
from sightline.health.lidar_checks import blind_sectors, check_lidar
from sightline.health.limits import HealthLimits, read_limits
from sightline.health.regions import bad_image_regions, bad_sweep_regions
from sightline.health.yaw_error import EdgeMatch, estimate_yaw, match_edges
from sightline.structures.health import Health, SampleHealth
from sightline.structures.sample import CameraLidarSample

_TELLING = 0.2  # score from which edges are the scene's: some beams may be missing
_ABSENT = Health(score=0.0, worst_check="absent")


class HealthMonitor:
    """Judges samples one by one, without memory."""

    def __init__(self, limits: HealthLimits | None = None) -> None:
        """Takes limits; None: those that come with Sightline."""
        self.limits = limits or read_limits()

    def __call__(self, sample: CameraLidarSample) -> SampleHealth:
        """The health of a sample; about 30 ms on one core for KITTI's size."""
        return self.judge(sample, match_edges(sample))

    def judge(self, sample: CameraLidarSample, match: EdgeMatch | None) -> SampleHealth:
        """Likewise, by a match of edges that may be that of several frames."""
        image = rgb_of(sample)
        camera = _ABSENT if image is None else self.limits.camera.judge(check_camera(image))
        lidar = _ABSENT
        cells, sectors = np.ones((1, 1), dtype=np.bool_), np.ones(1, dtype=np.bool_)
        if sample.points is not None:
            points = sample.points.numpy()
            seen = seen_by_camera(sample)
            lidar = self.limits.lidar.judge(check_lidar(points, seen))
            cells, sectors = bad_sweep_regions(points[seen]), blind_sectors(points)
        can_tell = min(camera.score, lidar.score) >= _TELLING
        return SampleHealth(
            sample_id=sample.sample_id,
            camera=camera,
            lidar=lidar,
            alignment=self.limits.alignment.judge(check_alignment(match))
            if match is not None and can_tell
            else None,
            yaw_deg=estimate_yaw(match).yaw_deg if match is not None and can_tell else None,
            camera_regions=np.ones((1, 1), dtype=np.bool_)
            if image is None
            else bad_image_regions(image),
            lidar_regions=cells,
            blind_sectors=sectors,
        )


def rgb_of(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"] | None:
    """The sample's image, colours last; None where there is none."""
    if sample.image is None:
        return None
    return np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy())


def seen_by_camera(sample: CameraLidarSample) -> Bool[np.ndarray, " num_points"]:
    """Which points of the sample's sweep the camera sees."""
    assert sample.points is not None, "only a sweep has points"
    matrix = sample.calibration.image_from_lidar.double().numpy()
    points = sample.points.numpy()
    # What is behind the camera is left out first, in float32 with a margin: half of a whole sweep.
    row = matrix[2].astype(np.float32)
    seen: Bool[np.ndarray, " num_points"] = points[:, :3] @ row[:3] + row[3] > -1
    seen[seen] = is_in_view(points[seen], matrix, sample.image_size)
    return seen
