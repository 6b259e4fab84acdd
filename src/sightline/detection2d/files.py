"""What the detectors find, as files."""

from pathlib import Path

import numpy as np

from sightline.data.image_file import write_rgb
from sightline.data.kitti_labels import write_objects
from sightline.data.object_results import kitti_from_detections2d
from sightline.detection2d.pictures import gate_picture
from sightline.detection2d.predictor import DetectorAnswer
from sightline.structures.sample import CameraLidarSample


def write_results(path: Path, sample: CameraLidarSample, answer: DetectorAnswer) -> None:
    """Writes KITTI's result file."""
    write_objects(path, kitti_from_detections2d(answer.detections, sample.image_size))


def write_gates(path: Path, sample: CameraLidarSample, answer: DetectorAnswer) -> None:
    """Writes the gates as a PNG of the image's size: the camera's in red, the LiDAR's in green.

    Raises:
        ValueError: The network has no gates.
    """
    if answer.camera_gate is None or answer.lidar_gate is None:
        raise ValueError("the network has no gates; leave the gates out")
    camera, lidar = (
        gate_picture(gate[None], sample.image_size)
        for gate in (answer.camera_gate, answer.lidar_gate)
    )
    write_rgb(path, np.stack((camera, lidar, np.zeros_like(camera)), axis=2))
