"""Files of 2D detections."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from sightline.data import kitti_labels
from sightline.data.image_file import write_rgb
from sightline.data.object_results import detections2d_from_kitti, kitti_from_detections2d
from sightline.detection2d.pictures import gate_picture
from sightline.detection2d.predictor import DetectorAnswer
from sightline.structures.predictions import Detections2D, Perception
from sightline.structures.sample import CameraLidarSample


def write_results(path: Path, sample: CameraLidarSample, answer: DetectorAnswer) -> None:
    """Write KITTI's result file."""
    kitti_labels.write_objects(path, kitti_from_detections2d(answer.detections, sample.image_size))


def read_results(path: Path, told: Perception) -> Perception:
    """Add the 2D boxes of KITTI's result file.

    Raises:
        FileError: The file is damaged.
    """
    return replace(told, detections2d=_read_detections(path))


def read_answer(path: Path, sample: CameraLidarSample) -> DetectorAnswer:
    """Read the 2D boxes of KITTI's result file as a detector's answer, without gates.

    Raises:
        FileError: The file is damaged.
    """
    del sample
    return DetectorAnswer(detections=_read_detections(path))


def _read_detections(path: Path) -> Detections2D:
    return detections2d_from_kitti(kitti_labels.read_results(path))


def write_gates(path: Path, sample: CameraLidarSample, answer: DetectorAnswer) -> None:
    """Write the gates as a PNG of the image's size: the camera's in red, the LiDAR's in green.

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
