"""What the detectors find, as files."""

from dataclasses import replace
from pathlib import Path

from sightline.data import kitti_labels
from sightline.data.object_results import detections3d_from_kitti, kitti_from_detections
from sightline.structures.level import level_calibration, level_detections, mounted_detections
from sightline.structures.predictions import Detections3D, Perception
from sightline.structures.sample import CameraLidarSample


def write_results(path: Path, sample: CameraLidarSample, answer: Detections3D) -> None:
    """Writes KITTI's result file: 2D boxes are the projections of 3D boxes."""
    kitti_labels.write_objects(
        path,
        kitti_from_detections(
            level_detections(answer, sample),
            level_calibration(sample.calibration, sample.level_from_lidar),
            sample.image_size,
        ),
    )


def read_results(path: Path, sample: CameraLidarSample, told: Perception) -> Perception:
    """Adds the 3D boxes of KITTI's result file; one of 2D boxes alone tells nothing.

    Raises:
        FileError: The file is damaged.
    """
    objects = kitti_labels.read_results(path)
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    found = mounted_detections(detections3d_from_kitti(objects, calibration), sample)
    is_of_2d_alone = len(objects) > 0 and len(found.scores) == 0
    return told if is_of_2d_alone else replace(told, detections3d=found)
