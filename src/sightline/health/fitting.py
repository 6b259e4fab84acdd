"""Health limits fitted on clean data of similar sensors."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from sightline.data.datasets.sample_files import sweeps_folder
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.health import alignment_checks, camera_checks, lidar_checks
from sightline.health.alignment_checks import AlignmentChecks, check_alignment
from sightline.health.camera_checks import CameraChecks, check_camera
from sightline.health.lidar_checks import LidarChecks, check_lidar
from sightline.health.limits import HealthLimits, check_enough, fit_limits
from sightline.health.monitor import rgb_of
from sightline.health.ring_order import level_by_ring
from sightline.health.yaw_error import match_edges
from sightline.jobs.progress import track
from sightline.structures.sample import CameraLidarSample


def fit_on_dataset(
    data: Path,
    *,
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    frames: int = 400,
    seed: int = 0,
    transfer: bool = False,
) -> HealthLimits:
    """Fit limits on frames of sound sensors, drawn without replacement if there are more.

    Args:
        data: Folder of the data set, of sensors similar to those to be judged; see `open_dataset`.
        sample_list: Frames to draw from; None: all.
        velodyne: Folder of the sweeps in an object tree: whole sweeps, if whole sweeps will be
            judged. None: velodyne, or else velodyne_reduced.
        frames: Maximum number of frames.
        seed: Seed of the draw.
        transfer: Whether the limits also serve sensors of other makes; see `fit_limits`.

    Raises:
        ValueError: The data are invalid, a frame lacks a sensor, or there are too few frames.
    """
    check_enough(frames)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}")
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts={"image", "points"}
    )
    drawn = np.random.default_rng(seed).permutation(len(dataset))[:frames]
    check_enough(len(drawn))
    samples = (dataset[int(index)] for index in np.sort(drawn))
    provenance: dict[str, str | int] = {
        "data": data.resolve().name,
        "sample_list": sample_list or "all",
        "sweeps": sweeps_folder(dataset),
        "frames": len(drawn),
        "seed": seed,
        "transfer": int(transfer),
    }
    tracked = track(samples, description="checking clean frames", total=len(drawn))
    return fit_on_samples(tracked, provenance, transfer=transfer)


def fit_on_samples(
    samples: Iterable[CameraLidarSample],
    provenance: Mapping[str, str | int],
    *,
    transfer: bool = False,
    camera_spreads: CameraChecks = camera_checks.MIN_SPREADS,
    lidar_spreads: LidarChecks = lidar_checks.MIN_SPREADS,
) -> HealthLimits:
    """Fit limits on samples of sound sensors.

    Args:
        samples: At least a hundred.
        provenance: Description of the samples, stored with the limits.
        transfer: Whether the limits also serve sensors of other makes; see `fit_limits`.
        camera_spreads: Minimum spreads of the camera's checks.
        lidar_spreads: Minimum spreads of the LiDAR's checks.

    Raises:
        ValueError: A sample lacks a sensor, or there are too few samples.
    """
    camera: list[CameraChecks] = []
    lidar: list[LidarChecks] = []
    alignment: list[AlignmentChecks] = []
    for sample in map(level_by_ring, samples):
        image = rgb_of(sample)
        if image is None or sample.points is None:
            raise ValueError(
                f"sample {sample.sample_id} lacks a sensor; limits are fitted on frames with both "
                "sensors"
            )
        camera.append(check_camera(image))
        lidar.append(check_lidar(sample.points.numpy()))
        match = match_edges(sample)
        if match is not None:
            alignment.append(check_alignment(match))
    check_enough(len(camera))
    if len(alignment) < len(camera) / 2:
        raise ValueError(
            f"only {len(alignment)} of {len(camera)} frames show edges that camera and LiDAR both "
            "see; check the calibration (`sightline check`)"
        )
    return HealthLimits(
        camera=fit_limits(camera, camera_spreads, transfer=transfer),
        lidar=fit_limits(lidar, lidar_spreads, transfer=transfer),
        alignment=fit_limits(alignment, alignment_checks.MIN_SPREADS, transfer=transfer),
        provenance=provenance,
    )
