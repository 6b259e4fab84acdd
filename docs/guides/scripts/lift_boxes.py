"""3D boxes of image boxes: size of the class, height of the box, road, regression, returns."""

import numpy as np

from box_guesses import Guesses, bounds, guess, match
from box_ranges import fitted_range
from joined_evidence import logit
from joined_scene import Scene
from kitti_frame import Array, Steps
from road_depth import LIDAR_HEIGHT_M, depth_on_road, depths_of_returns

HORIZON = 0.015  # spread of the road's slope [rad]
THICKNESS_M = {"Car": 1.5, "Pedestrian": 0.6, "Cyclist": 0.6}


def lift(scene: Scene, index: int, ranges: Steps) -> tuple[Array, Array]:
    """Lift an image box at the yaw that explains its shape best; the box and its evidence."""
    name = str(scene.image.names[index])
    guesses, bottoms = guess(scene, index)
    road = depth_on_road(scene, guesses.box, guesses.size[0])
    if guesses.at_bottom and road is not None:  # the object ends below what is seen
        bottoms = bottoms * np.minimum(road / bottoms[:, 2], 1)[:, None]
    depths = bottoms[:, 2].copy()
    precision = (0.07 * depths) ** -2.0
    total = precision * depths
    if road is not None and not guesses.at_bottom:
        weight = max(HORIZON * road**2 / LIDAR_HEIGHT_M, 0.3) ** -2.0
        precision, total = precision + weight, total + road * weight
    total = np.sqrt(total * precision * fitted_range(scene, guesses.box, ranges[name]))
    returns = depths_of_returns(scene, guesses.box, float(depths.mean()), THICKNESS_M[name])
    if len(returns):
        weight = (0.35 if len(returns) > 2 else 0.6) ** -2.0
        places = np.sort(bottoms[:, None, 2] + guesses.offsets[..., 2], axis=1)
        behind = depths - places[:, :4].mean(axis=1)  # of the centre, behind what is seen
        precision, total = precision + weight, total + (np.median(returns) + behind) * weight
    fused = total / precision
    bottoms = match(guesses, bottoms * (fused / depths)[:, None])
    mounting = scene.frame.mounting
    in_lidar = (bottoms - mounting[:3, 3]) @ mounting[:3, :3]
    errors = misfit(guesses, bottoms, in_lidar[:, 2] + LIDAR_HEIGHT_M, name)
    one = int(errors.argmin())
    row = (
        logit(scene.image.scores[index]),
        np.log(fused[one]),
        np.log(precision[one] ** -0.5 / fused[one]),
        np.log1p(scene.image.returns[index]),
        np.log1p(errors[one]),
        float(guesses.at_left or guesses.at_right or guesses.at_bottom),
    )
    center = in_lidar[one] + np.array([0, 0, guesses.size[2] / 2])
    box = np.concatenate((center, guesses.size, guesses.yaws[one : one + 1]))
    return box, np.array(row, np.float64)


def misfit(guesses: Guesses, bottoms: Array, above: Array, name: str) -> Array:
    """Misfit of each yaw: width and height of the box, road, direction of the street."""
    box, seen, cost = guesses.box, bounds(guesses, bottoms), np.zeros(len(bottoms))
    spread = 0.08 * (box[3] - box[1]) + 2
    if not (guesses.at_left or guesses.at_right):
        cost += ((seen[:, 2] - seen[:, 0] - box[2] + box[0]) / spread) ** 2 / 2
    if not guesses.at_bottom:
        cost += ((seen[:, 3] - seen[:, 1] - box[3] + box[1]) / spread) ** 2 / 2
    cost += 0.3 * (above / (HORIZON * bottoms[:, 2] + 0.15)) ** 2 / 2
    if name != "Pedestrian":
        away = np.abs((guesses.yaws + np.pi / 2) % np.pi - np.pi / 2)
        cost -= np.log(0.8 * np.exp(-((away / np.radians(8)) ** 2) / 2) + 0.06)
    return cost
