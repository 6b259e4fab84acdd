"""Frames, truths and networks for the tests of this folder."""

from dataclasses import asdict, replace

import numpy as np
import torch

from sightline.detection2d.config import (
    PAPER,
    CompactConfig,
    Detection2DConfig,
    InputConfig,
    StreamConfig,
)
from sightline.detection2d.examples import ExampleConfig
from sightline.detection2d.model import Detector
from sightline.detection2d.targets import DetectionTargets
from sightline.files.weights import write_weights
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.projection import unproject_pixels
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample
from tests.geometry.cameras import kitti_like_calibration

SIZE = (264, 272)  # hardly more than what leaves something of the last of SSD's maps
TINY = replace(PAPER, width=0.03, input=InputConfig(size=SIZE))
TINY_COMPACT = Detection2DConfig(
    compact=CompactConfig(
        camera=StreamConfig(channels=(4, 8, 12, 16, 24), blocks=(0, 1, 0, 0)),
        lidar=StreamConfig(channels=(4, 4, 8, 12, 16), blocks=(0, 0, 0, 0)),
        head_channels=8,
        head_convs=1,
    ),
)


def whole_frames(size, **settings):
    """Settings of examples that are whole frames of a size."""
    return ExampleConfig(input=InputConfig(size=size), pad_to=1, crop_size=None, **settings)


def labels(rows, **columns):
    """Rows of (class name, x_min, y_min, x_max, y_max)."""
    count = len(rows)
    boxes = torch.tensor([row[1:] for row in rows], dtype=torch.float64).reshape(-1, 4)
    values = {
        "class_names": tuple(row[0] for row in rows),
        "boxes2d": Boxes2D(boxes),
        "boxes3d": Boxes3D(torch.ones(count, 7, dtype=torch.float64)),
        "truncation": torch.zeros(count, dtype=torch.float64),
        "occlusion": torch.zeros(count, dtype=torch.int64),
        "alpha": torch.zeros(count, dtype=torch.float64),
    }
    return ObjectLabels(**{**values, **columns})


def targets(boxes=(), classes=(), ignored=(), ignored_classes=None):
    flags = torch.ones(len(ignored), 3) if ignored_classes is None else ignored_classes
    return DetectionTargets(
        boxes=torch.tensor(boxes, dtype=torch.float32).reshape(-1, 4),
        class_indices=torch.tensor(classes, dtype=torch.int64),
        ignored_boxes=torch.tensor(ignored, dtype=torch.float32).reshape(-1, 4),
        ignored_classes=torch.as_tensor(flags).bool().reshape(-1, 3),
    )


def painted_frame(number, size=SIZE, *, rows=None):
    """Noise with a bright car, which the LiDAR sees nearer than the wall behind it."""
    rng = np.random.default_rng(number)
    if rows is None:
        left, top = rng.integers(10, size[1] - 120), rng.integers(10, size[0] - 90)
        rows = [("Car", left, top, left + rng.integers(70, 100), top + rng.integers(50, 75))]
    image = rng.integers(40, 90, (3, *size), dtype=np.uint8)
    depth = np.full(size, 40.0, np.float32)
    for _, x_min, y_min, x_max, y_max in rows:
        image[:, y_min:y_max, x_min:x_max] = (230, 200, 60)[number % 3]
        depth[y_min:y_max, x_min:x_max] = 10.0
    y, x = (axis.reshape(-1) for axis in np.mgrid[0 : size[0] : 4, 0 : size[1] : 4])
    calibration = kitti_like_calibration().crop(450, 100)
    pixels = torch.from_numpy(np.stack((x, y), axis=1)).double()
    points = unproject_pixels(pixels, torch.from_numpy(depth[y, x]).double(), calibration)
    reflectance = torch.full((len(points), 1), 0.2)
    return CameraLidarSample(
        sample_id=f"{number:06}",
        calibration=calibration,
        image_size=size,
        image=torch.from_numpy(image),
        points=torch.cat((points.float(), reflectance), dim=1),
        objects=labels(rows),
    )


def write_network(path, config=TINY, *, seed=0):
    """A network with weights drawn at random, as a file; gives the network."""
    torch.manual_seed(seed)
    network = Detector(config).eval()
    write_weights(
        path,
        network.state_dict(),
        task="detection2d",
        config=asdict(config),
        provenance={"sightline": "0.0.1"},
    )
    return network
