"""Limits from clean data: what is usual of sensors like these."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from sightline.data.object_tree import Velodyne
from sightline.data.open import open_dataset, sweeps_folder
from sightline.data.progress import track
from sightline.health import alignment_checks, camera_checks, lidar_checks
from sightline.health.alignment_checks import AlignmentChecks, check_alignment
from sightline.health.camera_checks import CameraChecks, check_camera
from sightline.health.lidar_checks import LidarChecks, check_lidar
from sightline.health.limits import HealthLimits, check_enough, fit_limits
from sightline.health.monitor import rgb_of
from sightline.health.yaw_error import match_edges
from sightline.structures.level import level_sample
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
    """Limits fitted on frames of sound sensors, drawn without replacement where there are more.

    Args:
        data: Folder of the data set, of sensors like those that are to be judged; see
            `open_dataset`.
        sample_list: Which frames it is drawn from; None: all.
        velodyne: Folder of the sweeps in an object tree: whole ones, where whole ones are judged.
            None: velodyne, or else velodyne_reduced.
        frames: How many, at most.
        seed: Of the drawing.
        transfer: Whether the limits shall serve sensors of other makes, too; see `fit_limits`.

    Raises:
        ValueError: The data is at fault, a frame lacks a sensor, or there are too few frames.
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
    shown = track(samples, description="looking at clean frames", total=len(drawn))
    return fit_on_samples(shown, provenance, transfer=transfer)


def fit_on_samples(
    samples: Iterable[CameraLidarSample],
    provenance: Mapping[str, str | int],
    *,
    transfer: bool = False,
    camera_spreads: CameraChecks = camera_checks.LEAST_SPREADS,
    lidar_spreads: LidarChecks = lidar_checks.LEAST_SPREADS,
) -> HealthLimits:
    """Limits fitted on samples of sound sensors.

    Args:
        samples: At least a hundred.
        provenance: What is written down about them.
        transfer: Whether the limits shall serve sensors of other makes, too; see `fit_limits`.
        camera_spreads: Least spreads of the camera's checks.
        lidar_spreads: Least spreads of the LiDAR's checks.

    Raises:
        ValueError: A sample lacks a sensor, or there are too few.
    """
    camera: list[CameraChecks] = []
    lidar: list[LidarChecks] = []
    alignment: list[AlignmentChecks] = []
    for sample in map(level_sample, samples):
        image = rgb_of(sample)
        if image is None or sample.points is None:
            raise ValueError(
                f"sample {sample.sample_id} lacks a sensor: limits are fitted on frames that have "
                "both"
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
            "see: look whether the calibration fits (`sightline check`)"
        )
    return HealthLimits(
        camera=fit_limits(camera, camera_spreads, transfer=transfer),
        lidar=fit_limits(lidar, lidar_spreads, transfer=transfer),
        alignment=fit_limits(alignment, alignment_checks.LEAST_SPREADS, transfer=transfer),
        provenance=provenance,
    )
