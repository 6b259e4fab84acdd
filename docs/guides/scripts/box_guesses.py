"""Boxes of one size at several yaws that explain an image box, in the camera's frame."""

from typing import NamedTuple

import numpy as np

from joined_scene import Scene
from kitti_frame import Array

SIZES = {"Car": (3.88, 1.63, 1.53), "Pedestrian": (0.84, 0.66, 1.76), "Cyclist": (1.76, 0.6, 1.74)}
YAWS, BORDER_PX, NEAREST_M, FARTHEST_M = 16, 1.5, 2.0, 90.0
CORNERS = np.array([(x, y, z) for x in (0.5, -0.5) for y in (0.5, -0.5) for z in (0.0, 1.0)])


class Guesses(NamedTuple):
    """An image box, and boxes of its class's size at all yaws."""

    box: Array  # x_min, y_min, x_max, y_max [px]
    camera: Array  # 3 x 4
    size: Array  # length, width, height [m]
    yaws: Array
    offsets: Array  # yaws x 8 x 3: corners, seen from the centres of the bottoms [m]
    at_left: bool  # whether the image's border cuts the box
    at_right: bool
    at_bottom: bool


def guess(scene: Scene, index: int) -> tuple[Guesses, Array]:
    """Guess boxes as high as the image box; also the centres of their bottoms."""
    box, name, camera = scene.image.in_image[index], scene.image.names[index], scene.frame.camera
    size, (height, width) = np.array(SIZES[name]), scene.size
    count = 1 if name == "Pedestrian" else YAWS
    yaws = np.pi * np.arange(count) / count - (np.pi / 2 if count > 1 else 0)
    cos, sin, (x, y, z) = np.cos(yaws)[:, None], np.sin(yaws)[:, None], (CORNERS * size).T
    corners = np.stack((cos * x - sin * y, sin * x + cos * y, np.tile(z, (count, 1))), axis=2)
    guesses = Guesses(
        box,
        camera,
        size,
        yaws,
        corners @ scene.frame.mounting[:3, :3].T,
        box[0] <= BORDER_PX,
        box[2] >= width - 1 - BORDER_PX,
        box[3] >= height - 1 - BORDER_PX,
    )
    tall = max(box[3] - box[1], 2.0)
    depth = camera[0, 0] * size[2] / tall + size[0] / 4
    middle = np.array([(box[0] + box[2]) / 2, box[3], 1]) * depth
    bottoms = np.tile(np.linalg.solve(camera[:, :3], middle - camera[:, 3]), (count, 1))
    for _ in range(6):  # along their rays
        seen = bounds(guesses, bottoms)
        factor = ((seen[:, 3] - seen[:, 1]) / tall).clip(0.5, 2)
        depths = (bottoms[:, 2] * factor).clip(NEAREST_M, FARTHEST_M)
        bottoms = match(guesses, bottoms * (depths / bottoms[:, 2])[:, None])
    return guesses, bottoms


def bounds(guesses: Guesses, bottoms: Array) -> Array:
    """Bounds of the boxes in the image [px], not cut at its border."""
    matrix = guesses.camera
    flat = (bottoms[:, None] + guesses.offsets) @ matrix[:, :3].T + matrix[:, 3]
    pixels = flat[..., :2] / np.maximum(flat[..., 2:], 0.3)
    return np.concatenate((pixels.min(axis=1), pixels.max(axis=1)), axis=1)


def match(guesses: Guesses, bottoms: Array) -> Array:
    """Move boxes until their middle and lower edge are those of the image box."""
    box = guesses.box
    for _ in range(3):
        seen, scale = bounds(guesses, bottoms), bottoms[:, 2] / guesses.camera[0, 0]
        shift = (box[0] + box[2] - seen[:, 0] - seen[:, 2]) / 2
        if guesses.at_left != guesses.at_right:  # cut off at one side
            shift = box[2] - seen[:, 2] if guesses.at_left else box[0] - seen[:, 0]
        rise = box[1] - seen[:, 1] if guesses.at_bottom else box[3] - seen[:, 3]
        bottoms = bottoms + np.stack((shift * scale, rise * scale, 0 * scale), axis=1)
    return bottoms
