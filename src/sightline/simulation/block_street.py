"""The embedded default: small street scenes of blocks in KITTI's object format.

Made by rules and chance, from nobody's assets: enough to try every command without a download.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int16

from sightline.data.atomic import atomic_write_text
from sightline.data.depth_png import write_depth_png
from sightline.data.kitti_files import write_image, write_object_calibration, write_points
from sightline.data.kitti_labels import write_objects
from sightline.data.object_labels import kitti_from_labels
from sightline.data.progress import track
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.geometry.transforms import transform_points, wrap_angle
from sightline.simulation.block_rays import NOTHING, cast_rays
from sightline.simulation.block_scene import Thing, build_street
from sightline.simulation.block_sensors import camera_rays, pixel_grid, take_image, take_sweep
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample

KITTI_IMAGE_SIZE = (375, 1242)
DEPTH_FOLDER = "depth_2"
"""Beside KITTI's `image_2`: dense true depth as 16-bit PNG."""

_IMAGE_FROM_CAMERA = (
    (721.5377, 0.0, 609.5593, 44.85728),
    (0.0, 721.5377, 172.854, 0.2163791),
    (0.0, 0.0, 1.0, 0.002745884),
)
# The camera sits 0.27 m ahead of the LiDAR and 0.08 m below it.
_CAMERA_FROM_LIDAR = (
    (0.0, -1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0, -0.08),
    (1.0, 0.0, 0.0, -0.27),
    (0.0, 0.0, 0.0, 1.0),
)
_DEPTH_LIMIT_M = 120.0
_MIN_VISIBLE_SHARE = 0.1  # of an object's pixels: one hidden farther is not labelled
_MIN_VISIBLE_PIXELS = 25
_VISIBLE, _PARTLY = 0.9, 0.5  # shares above which an object counts as visible, as partly occluded


@dataclass(frozen=True, kw_only=True)
class BlockStreetFrame:
    """A frame of the embedded data set and what only its maker knows."""

    sample: CameraLidarSample
    """With labels and dense true depth."""
    instances: Int16[np.ndarray, "height width"]
    """Index of the labelled object that each pixel shows; -1 for the rest."""
    visible_shares: tuple[float, ...]
    """Of each labelled object's pixels, how many nothing hides."""


def make_block_street_frame(
    index: int,
    *,
    seed: int = 0,
    image_size: tuple[int, int] = KITTI_IMAGE_SIZE,
    full_sweep: bool = False,
) -> BlockStreetFrame:
    """Builds a street by chance and looks at it; the same arguments give the same frame.

    Args:
        index: Number of the frame; each is another street.
        seed: Of the whole set.
        image_size: Height, width [px]; the view is KITTI's at any size of that shape.
        full_sweep: Keep the points that the camera does not see, too.
    """
    rng = np.random.default_rng([seed, index])
    things = build_street(rng)
    calibration = block_street_calibration(image_size)
    image_from_lidar = calibration.image_from_lidar.numpy()
    view = take_image(things, image_from_lidar, image_size)
    points = torch.from_numpy(take_sweep(things, rng))
    if not full_sweep:
        points = points[project_points(points[:, :3], calibration).in_image(image_size)]
    depth = view.hits.distances.reshape(image_size)
    depth = np.where(depth <= _DEPTH_LIMIT_M, depth, np.float32(0))
    owners = _owners(things)[view.hits.blocks].reshape(image_size)
    objects, seen = _label(things, owners, calibration, image_size)
    renumbered = np.full(len(things) + 1, -1, np.int16)  # the last answers to -1: no road user
    renumbered[[user.thing for user in seen]] = np.arange(len(seen))
    sample = CameraLidarSample(
        sample_id=f"{index:06d}",
        calibration=calibration,
        image_size=image_size,
        image=torch.from_numpy(np.ascontiguousarray(view.image.transpose(2, 0, 1))),
        points=points,
        objects=objects,
        depth=torch.from_numpy(depth),
    )
    return BlockStreetFrame(
        sample=sample,
        instances=renumbered[owners],
        visible_shares=tuple(user.visible_share for user in seen),
    )


def write_block_street(
    out: Path,
    *,
    frames: int = 2,
    seed: int = 0,
    image_size: tuple[int, int] = KITTI_IMAGE_SIZE,
    full_sweep: bool = False,
) -> None:
    """Writes a set of street scenes as KITTI's object tree, with true depth and a list `demo`.

    Each file is written aside and renamed; the same arguments write the same bytes.

    Args:
        out: Folder that gets `training/` and `ImageSets/demo.txt`.
        frames: How many.
        seed: Another seed gives other streets.
        image_size: Height, width [px].
        full_sweep: Write whole turns of the LiDAR instead of what the camera sees.
    """
    training = out / "training"
    for index in track(range(frames), description="building streets", total=frames):
        sample = make_block_street_frame(
            index, seed=seed, image_size=image_size, full_sweep=full_sweep
        ).sample
        name = sample.sample_id
        assert sample.image is not None, "a made frame has an image"
        assert sample.points is not None, "a made frame has a sweep"
        assert sample.objects is not None, "a made frame has labels"
        assert sample.depth is not None, "a made frame has depth"
        write_image(training / f"image_2/{name}.png", sample.image)
        write_points(training / f"velodyne/{name}.bin", sample.points)
        write_object_calibration(training / f"calib/{name}.txt", sample.calibration)
        objects = kitti_from_labels(sample.objects, sample.calibration)
        write_objects(training / f"label_2/{name}.txt", objects)
        write_depth_png(training / f"{DEPTH_FOLDER}/{name}.png", sample.depth.numpy())
    names = "".join(f"{index:06d}\n" for index in range(frames))
    atomic_write_text(out / "ImageSets" / "demo.txt", names)


def block_street_calibration(image_size: tuple[int, int]) -> Calibration:
    """KITTI's camera 2 on a mount without tilt, for an image of (height, width)."""
    kitti = Calibration(
        image_from_camera=torch.tensor(_IMAGE_FROM_CAMERA, dtype=torch.float64),
        camera_from_lidar=torch.tensor(_CAMERA_FROM_LIDAR, dtype=torch.float64),
    )
    return kitti.resize(image_size[1] / KITTI_IMAGE_SIZE[1], image_size[0] / KITTI_IMAGE_SIZE[0])


def _owners(things: Sequence[Thing]) -> Int16[np.ndarray, " num_blocks_and_two"]:
    """The road user that each block belongs to, or -1; ends so that GROUND and NOTHING fit."""
    owners = [
        index if thing.class_name else -1
        for index, thing in enumerate(things)
        for _ in thing.blocks
    ]
    return np.array([*owners, -1, -1], np.int16)


class _SeenUser(NamedTuple):
    """A road user that the camera sees."""

    thing: int
    """Its index in the scene."""
    box: Boxes2D
    truncation: float
    visible_share: float


def _label(
    things: Sequence[Thing],
    owners: Int16[np.ndarray, "height width"],
    calibration: Calibration,
    image_size: tuple[int, int],
) -> tuple[ObjectLabels, list[_SeenUser]]:
    """Labels of the road users that can be seen, and what is known of them besides."""
    pixels = pixel_grid(image_size)
    seen = [
        user
        for index, thing in enumerate(things)
        if thing.class_name
        and (user := _look_for(index, thing, owners == index, pixels, calibration)) is not None
    ]
    rows = [things[user.thing].box3d for user in seen]
    boxes3d = Boxes3D(torch.tensor(rows, dtype=torch.float64).reshape(-1, 7))
    _, locations, rotation_y = kitti_from_boxes3d(boxes3d, calibration.camera_from_lidar)
    bearing = torch.atan2(locations[:, 0], locations[:, 2])
    nothing = torch.zeros(0, 4, dtype=torch.float64)
    shares = [user.visible_share for user in seen]
    labels = ObjectLabels(
        class_names=tuple(things[user.thing].class_name or "" for user in seen),
        boxes2d=Boxes2D(torch.cat([nothing, *(user.box.tensor for user in seen)])),
        boxes3d=boxes3d,
        truncation=torch.tensor([user.truncation for user in seen], dtype=torch.float64),
        occlusion=torch.tensor(
            [0 if share > _VISIBLE else 1 if share > _PARTLY else 2 for share in shares],
            dtype=torch.int64,
        ),
        alpha=wrap_angle(rotation_y - bearing),
    )
    return labels, seen


def _look_for(
    index: int,
    thing: Thing,
    visible: Bool[np.ndarray, "height width"],
    pixels: Float64[np.ndarray, "2 num_pixels"],
    calibration: Calibration,
) -> _SeenUser | None:
    """What the camera sees of a road user; None if that is too little."""
    box = _project(thing, calibration)
    if box is None:
        return None
    clipped = box.clip((visible.shape[0], visible.shape[1]))
    lower, upper = clipped.tensor[0].numpy().reshape(2, 2, 1)
    within = pixels[:, ((pixels >= lower) & (pixels <= upper)).all(axis=0)]
    origin, directions = camera_rays(calibration.image_from_lidar.numpy(), within)
    alone = cast_rays([thing.blocks], origin, directions, ground_z=None).blocks != NOTHING
    num_visible = int(np.count_nonzero(visible))
    share = num_visible / max(int(np.count_nonzero(alone)), 1)
    if share < _MIN_VISIBLE_SHARE or num_visible < _MIN_VISIBLE_PIXELS:
        return None
    return _SeenUser(
        thing=index,
        box=_fit(clipped, within[:, alone]),
        truncation=1 - float(clipped.area() / box.area()),
        visible_share=share,
    )


def _fit(box: Boxes2D, pixels: Float64[np.ndarray, "2 num_pixels"]) -> Boxes2D:
    """The box less what lies beyond an object's pixels: its part in the image may be smaller."""
    lower = torch.from_numpy(pixels.min(axis=1) - 0.5)
    upper = torch.from_numpy(pixels.max(axis=1) + 0.5)
    first = torch.maximum(box.tensor[:, :2], lower)
    last = torch.minimum(box.tensor[:, 2:], upper)
    return Boxes2D(torch.cat((first, last), dim=1))


def _project(thing: Thing, calibration: Calibration) -> Boxes2D | None:
    """The 2D box around a thing's blocks, beyond the image too; None if not wholly in front."""
    rows = [(*block.center, *block.size, block.yaw) for block in thing.blocks]
    corners = Boxes3D(torch.tensor(rows, dtype=torch.float64)).corners().reshape(-1, 3)
    homogeneous = transform_points(calibration.image_from_lidar, corners)
    if float(homogeneous[:, 2].min()) < 0.1:
        return None
    pixels = homogeneous[:, :2] / homogeneous[:, 2:]
    return Boxes2D(torch.cat((pixels.amin(dim=0), pixels.amax(dim=0)))[None])
