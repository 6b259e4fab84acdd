"""Files of 3D detections."""

from dataclasses import replace
from pathlib import Path

from sightline.data.formats import kitti_labels
from sightline.data.formats.kitti_conversion import (
    check_boxes,
    detections3d_from_kitti,
    kitti_from_detections,
)
from sightline.structures.level import level_calibration, level_detections, mounted_detections
from sightline.structures.predictions import Detections3D, Perception
from sightline.structures.sample import CameraLidarSample


def write_results(path: Path, sample: CameraLidarSample, detections: Detections3D) -> None:
    """Write KITTI's result file; its 2D boxes are the projections of the 3D boxes.

    Boxes outside the image are left out, as in KITTI's labels; of samples with `all_around` they
    have a 2D box of -1, without an area.

    Raises:
        ValueError: A box or a score is invalid.
    """
    check_boxes(detections)
    kitti_labels.write_objects(
        path,
        kitti_from_detections(
            level_detections(detections, sample),
            level_calibration(sample.calibration, sample.level_from_lidar),
            sample.image_size,
            keeps_unseen=sample.all_around,
        ),
    )


def read_results(path: Path, sample: CameraLidarSample, perception: Perception) -> Perception:
    """Add the 3D boxes of KITTI's result file; a file with 2D boxes alone changes nothing.

    Raises:
        FileError: The file is damaged.
    """
    objects = kitti_labels.read_results(path)
    found = _detections(objects, sample)
    has_only_2d = len(objects) > 0 and len(found.scores) == 0
    return perception if has_only_2d else replace(perception, detections3d=found)


def read_detections(path: Path, sample: CameraLidarSample) -> Detections3D:
    """Read the 3D boxes of KITTI's result file; none if it has 2D boxes alone.

    Raises:
        FileError: The file is damaged.
    """
    return _detections(kitti_labels.read_results(path), sample)


def _detections(objects: kitti_labels.KittiObjects, sample: CameraLidarSample) -> Detections3D:
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    return mounted_detections(detections3d_from_kitti(objects, calibration), sample)
