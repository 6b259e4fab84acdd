"""A coarse camera that sees boxes only: which road users KITTI's annotators would have labelled."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sightline.simulation.bodies.models import KITTI_SIZES, ActorModel, RigidShape
from sightline.simulation.scene import Actor, Mesh, Pose
from sightline.simulation.streets.lots import Lot, footprint_corners, footprint_of

FOCAL, CENTER_X, CENTER_Y = 721.5, 609.6, 172.9
WIDTH, HEIGHT = 1242, 375
CAMERA_AHEAD, CAMERA_HEIGHT = 0.27, 1.65
CELL = 4
"""Pixels of the image per side of a cell of the coarse picture."""


class SizesOnly:
    """A source of models that have a size and no shape."""

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """A model of a class, sized as KITTI's."""
        del speed_mps
        size = tuple(KITTI_SIZES[class_name].draw(rng, 1)[0].tolist())
        return ActorModel(class_name=class_name, size_lwh=size, shape=RigidShape(mesh=NOTHING))


NOTHING = Mesh(
    vertices=np.zeros((0, 3), np.float32),
    normals=np.zeros((0, 3), np.float32),
    uvs=np.zeros((0, 2), np.float32),
    faces=np.zeros((0, 3), np.int32),
    materials=np.zeros(0, np.int32),
    colors=np.zeros((0, 3), np.float32),
)


@dataclass(frozen=True)
class Seen:
    """A labelled road user."""

    class_name: str
    distance: float
    left: float
    heading: float
    """Off the ego's [rad]."""
    truncation: float
    visible_share: float


def labelled(
    actors: Sequence[Actor], lots: Sequence[Lot], ego: Pose, time_s: float = 0.0
) -> list[Seen]:
    """Find the labelled road users by painting boxes and walls from far to near."""
    objects = []
    for index, actor in enumerate(actors):
        pose = actor.motion.at(time_s)
        length, width, height = actor.size_lwh
        along = np.array([np.cos(pose.yaw), np.sin(pose.yaw)])
        aside = np.array([-along[1], along[0]])
        signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
        base = np.array([pose.x, pose.y]) + signs @ np.array([along * length, aside * width]) / 2
        objects.append((index, base, pose.z, height))
    for lot in lots:
        footprint = footprint_of(lot)
        if footprint is not None:
            objects.append((-1, footprint_corners(footprint), -1.0, 8.0))
    painted = []
    for index, base, z, height in objects:
        outline = _outline(base, z, height, ego)
        if outline is not None:
            painted.append((outline[0], index, outline[1]))
    painted.sort(key=lambda item: -item[0])
    canvas = np.full((HEIGHT // CELL, WIDTH // CELL), -2)
    areas = {}
    for _, index, box in painted:
        rows, columns = _cells(box)
        canvas[rows, columns] = index
        areas[index] = canvas[rows, columns].size
    seen = []
    for _, index, box in painted:
        if index >= 0:
            visible = int((canvas == index).sum())
            found = _judged(actors[index], time_s, ego, box, visible, areas[index])
            if found is not None:
                seen.append(found)
    return seen


def _in_camera(places: np.ndarray, ego: Pose) -> np.ndarray:
    """Position ahead and left of the camera."""
    cos, sin = np.cos(ego.yaw), np.sin(ego.yaw)
    apart = places - [ego.x, ego.y]
    ahead = apart @ [cos, sin] - CAMERA_AHEAD
    return np.stack((ahead, apart @ [-sin, cos]), axis=1)


def _outline(base, z, height, ego):
    """Nearest depth and box (x_min, y_min, x_max, y_max) in the image, unclipped."""
    seen = _in_camera(base, ego)
    # Walls extend beyond the view: cut them into pieces.
    shares = np.linspace(0, 1, 12)[:, None]
    rim = np.concatenate(
        [seen[row] + shares * (seen[(row + 1) % 4] - seen[row]) for row in range(4)]
    )
    rim = rim[rim[:, 0] > 0.8]
    if len(rim) == 0:
        return None
    x = CENTER_X - FOCAL * rim[:, 1] / rim[:, 0]
    eye = CAMERA_HEIGHT + ego.z
    low = CENTER_Y + FOCAL * (eye - z) / rim[:, 0]
    high = CENTER_Y + FOCAL * (eye - z - height) / rim[:, 0]
    return float(rim[:, 0].min()), np.array([x.min(), high.min(), x.max(), low.max()])


def _cells(box):
    x0, x1 = np.clip(np.round(box[[0, 2]] / CELL), 0, WIDTH // CELL).astype(int)
    y0, y1 = np.clip(np.round(box[[1, 3]] / CELL), 0, HEIGHT // CELL).astype(int)
    return slice(y0, max(y1, y0)), slice(x0, max(x1, x0))


def _judged(actor, time_s, ego, box, visible, area):
    pose = actor.motion.at(time_s)
    ahead, left = _in_camera(np.array([[pose.x, pose.y]]), ego)[0]
    distance = float(np.hypot(ahead, left))
    clipped = np.clip(box, 0, [WIDTH, HEIGHT, WIDTH, HEIGHT])
    whole = (box[2] - box[0]) * (box[3] - box[1])
    inside = (clipped[2] - clipped[0]) * (clipped[3] - clipped[1])
    share = visible / max(area, 1)
    if distance > 78 or clipped[3] - clipped[1] < 15 or visible < 3 or share < 0.12:
        return None
    heading = float((pose.yaw - ego.yaw + np.pi) % (2 * np.pi) - np.pi)
    return Seen(actor.class_name, distance, float(left), heading, 1 - inside / whole, share)
