"""What the detectors find, as files."""

from pathlib import Path

from sightline.data.kitti_labels import write_objects
from sightline.data.object_results import kitti_from_detections
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample


def write_results(path: Path, sample: CameraLidarSample, answer: Detections3D) -> None:
    """Writes KITTI's result file: 2D boxes are the projections of 3D boxes."""
    write_objects(path, kitti_from_detections(answer, sample.calibration, sample.image_size))
