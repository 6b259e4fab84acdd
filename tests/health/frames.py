"""Packaged simulated frames, and faults in them."""

import functools
from dataclasses import replace

import numpy as np
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.simulation.packaged import PACKAGED_FRAMES


@functools.cache
def sound(index=0):
    return KittiObjectDataset(PACKAGED_FRAMES)[index]


def with_image(sample, change):
    """The sample whose image (height, width, RGB) was changed."""
    image = change(np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy()))
    changed = torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)
    return replace(sample, image=changed.contiguous())


def with_points(sample, change):
    """The sample whose points were changed."""
    points = np.ascontiguousarray(change(sample.points.numpy().copy()), dtype=np.float32)
    return replace(sample, points=torch.from_numpy(points))
