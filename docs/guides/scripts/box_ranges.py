"""Distance of an image box by the fitted regression on its size and place in the image."""

import numpy as np

from box_guesses import BORDER_PX
from joined_scene import Scene
from kitti_frame import Array
from road_depth import depth_on_road


def fitted_range(scene: Scene, box: Array, weights: list[float]) -> float:
    """Depth [m] of the centre of the bottom, by the weights of the box's class."""
    focal, (rows, columns) = scene.frame.camera[0, 0], scene.size
    width, height = np.maximum(box[2:] - box[:2], 2)
    z, a = np.log(focal / height), np.log(width / height)
    road = depth_on_road(scene, box, 0.0)
    r = 1.5 if road is None else np.clip(np.log(road / 1.6) - z, -1.5, 1.5)
    side = float(box[0] <= BORDER_PX or box[2] >= columns - 1 - BORDER_PX)
    bottom, top = float(box[3] >= rows - 1 - BORDER_PX), float(box[1] <= BORDER_PX)
    aside = abs((box[0] + box[2]) / 2 - scene.frame.camera[0, 2]) / focal
    row = (
        1, r, z, a, side, bottom, top, r * r, r * z, r * a, z * z, z * a, a * a,
        bottom * r, side * a, side * r, aside, r**3,
    )  # fmt: skip
    return float(np.exp(z + np.dot(row, weights)))
