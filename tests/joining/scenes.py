"""Scenes and samples without networks."""

import numpy as np
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.joining.models import CLASSES, COLUMNS, JoinModels, LogisticModel, identity_maps
from sightline.joining.scene import Boxes, Scene
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

CALIBRATION = Calibration(
    image_from_camera=torch.tensor(
        [[720.0, 0, 620, 0], [0, 720, 187, 0], [0, 0, 1, 0]], dtype=torch.float64
    ),
    camera_from_lidar=torch.tensor(
        [[0.0, -1, 0, 0], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]], dtype=torch.float64
    ),
)
"""Camera like KITTI's, 1.65 m above the road."""


def make_sample(points=None, *, image=True, **fields):
    return CameraLidarSample(
        sample_id="000000",
        calibration=CALIBRATION,
        image_size=(375, 1242),
        image=torch.full((3, 375, 1242), 9, dtype=torch.uint8) if image else None,
        points=None if points is None else torch.tensor(points, dtype=torch.float32).reshape(-1, 4),
        **fields,
    )


def detections2d(*boxes):
    """Detections in the image of (class, score, corners)."""
    return Detections2D(
        class_names=tuple(name for name, _, _ in boxes),
        boxes=Boxes2D(torch.tensor([corners for _, _, corners in boxes]).reshape(-1, 4)),
        scores=torch.tensor([score for _, score, _ in boxes]).reshape(-1),
    )


def detections3d(*boxes):
    """Detections in the sweep of (class, score, x, y, z, length, width, height, yaw)."""
    return Detections3D(
        class_names=tuple(name for name, *_ in boxes),
        boxes=Boxes3D(torch.tensor([numbers for _, _, *numbers in boxes]).reshape(-1, 7)),
        scores=torch.tensor([score for _, score, *_ in boxes]).reshape(-1),
    )


def select(found, indices):
    """Some of the detections in a sweep."""
    return Detections3D(
        class_names=tuple(found.class_names[index] for index in indices),
        boxes=Boxes3D(found.boxes.tensor[indices]),
        scores=found.scores[indices],
    )


def flat_scene(sweep, image):
    """Scene of (class, score, corners) of both detectors, without returns."""
    return Scene(
        sweep=_boxes(sweep),
        image=_boxes(image),
        boxes3d=np.tile([10.0, 0, 0, 4, 2, 1.5, 0], (len(sweep), 1)),
        image_size=(375, 1242),
        image_from_camera=CALIBRATION.image_from_camera.numpy(),
        camera_from_level=CALIBRATION.camera_from_lidar.numpy(),
        lidar_height_m=1.73,
        points=np.zeros((0, 3)),
        pixels=np.zeros((0, 2)),
        has_camera=True,
        has_lidar=False,
    )


def _boxes(given):
    return Boxes(
        names=tuple(name for name, _, _ in given),
        scores=np.array([score for _, score, _ in given], dtype=float),
        in_image=np.array([corners for _, _, corners in given], dtype=float).reshape(-1, 4),
        num_points=np.zeros(len(given), dtype=np.int64),
    )


def own_score_models(provenance=None):
    """Models whose score is the detector's own, and of lifted boxes the image box's."""
    kinds = {
        kind: {
            name: LogisticModel(weights=(1.0,) + (0.0,) * (len(columns) - 1), bias=0.0)
            for name in CLASSES
        }
        for kind, columns in COLUMNS.items()
    }
    return JoinModels(**kinds, calibrators=identity_maps(), provenance=provenance or {})
