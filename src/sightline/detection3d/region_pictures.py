"""Pictures of the second stage's input: regions of interest, and a scene with all proposals."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.detection3d.pictures import LABELLED, PROPOSED, RIGHT, behind_and_above, camera_at
from sightline.detection3d.points.config import ProposalSamplingConfig, RoiPoolingConfig
from sightline.detection3d.points.refinement_training import assign_truths
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.ops.roi_points import roi_points
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.canvas import put_points
from sightline.visualization.cells import MUTED, PAGE, TITLE
from sightline.visualization.colors import RGB
from sightline.visualization.image import draw_boxes3d
from sightline.visualization.lettering import put_text, text_width, with_title

_INSIDE: Final[RGB] = (240, 150, 20)
_AROUND: Final[RGB] = (150, 156, 166)
_HARD: Final[RGB] = (226, 94, 20)
_BETWEEN: Final[RGB] = (240, 228, 66)
_TEXT_PX, _LINE_PX = 11, 21
_REGION_SIZE = (330, 410)  # height, width [px]
_ELEVATION_DEG, _SIDE_DEG = 28.0, 40.0
_DISTANCES = 3.1  # from the box to the camera, in half diagonals
_SCENE_PX = 620


@dataclass(frozen=True, kw_only=True, slots=True)
class DrawnRegion:
    """Region of interest in a picture; box and points are in KITTI's LiDAR frame."""

    sample_id: str
    """Name of the frame."""
    box: tuple[float, ...]
    """x, y, z, length, width, height [m], yaw [rad] of the proposal."""
    score: float
    iou: float
    """3D IoU with the object of highest IoU; 0 without objects."""
    num_inside: int
    """Number of different points in the enlarged box."""


def pool_points(
    points: Float[Tensor, "num_points 4"],
    boxes: Float[Tensor, "num_boxes 7"],
    config: RoiPoolingConfig,
    *,
    seed: int,
) -> tuple[list[Float[Tensor, "_ 3"]], list[int]]:
    """Draw the points of each enlarged box; also give the number of points in each."""
    xyz = points[:, :3].contiguous()
    drawn = roi_points(
        xyz[None], boxes[None], margin_m=config.margin_m, count=config.num_points, seed=seed
    )
    counts = drawn.num_inside[0].tolist()
    pooled = [
        xyz[index] if count else xyz[:0]
        for index, count in zip(drawn.indices[0], counts, strict=True)
    ]
    return pooled, counts


def region_picture(
    region: DrawnRegion,
    points: Float[Tensor, "num_points 3"],
    truths: Float[Tensor, "num_objects 7"],
    config: RoiPoolingConfig,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a region's pooled points, proposal, enlarged box and objects, from behind at the side.

    Orange: the proposal and the points in it; grey: the enlarged box and the points around; white:
    objects. The text above has the frame's name and the box.
    """
    box = torch.tensor([region.box], dtype=torch.float64)
    margin = box.new_tensor([0, 0, 0, *(2 * config.margin_m,) * 3, 0])
    camera = _beside(box[0] + margin, _REGION_SIZE)
    canvas = np.zeros((*_REGION_SIZE, 3), np.uint8)
    is_inside = first_box_of_points(points[None].double(), box[None])[0] >= 0
    for chosen, color in ((points[~is_inside], _AROUND), (points[is_inside], _INSIDE)):
        _put_cloud(canvas, chosen, camera, color, diameter_px=3.0)
    near = truths[(truths[:, :2] - box[0, :2]).norm(dim=1) < box[0, 3:5].norm() + config.margin_m]
    for boxes, color in ((box + margin, _AROUND), (near, LABELLED), (box, _INSIDE)):
        canvas = draw_boxes3d(
            canvas, Boxes3D(boxes), ("",) * len(boxes), camera, color=color, tags=False
        )
    x, y, z, length, width, height, yaw = region.box
    repeated = "" if region.num_inside >= config.num_points else ", repeated"
    lines = (
        (f"{region.sample_id}: score {region.score:.2f}, IoU {region.iou:.2f}", TITLE),
        (f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, yaw {yaw:.2f} rad", MUTED),
        (f"length {length:.2f}, width {width:.2f}, height {height:.2f} m", MUTED),
        (f"{config.num_points} points from {region.num_inside:,}{repeated}", MUTED),
    )
    return np.concatenate((_text_block(lines, canvas.shape[1]), canvas))


def regions_legend(width: int, config: RoiPoolingConfig) -> UInt8[np.ndarray, "height width 3"]:
    """Legend of `region_picture`."""
    return _legend(
        (
            ("proposal, and points in it", _INSIDE),
            (f"enlarged by {config.margin_m:g} m, and points around", _AROUND),
            ("object", LABELLED),
        ),
        width,
    )


def proposals_picture(
    title: str,
    pooled: Float[Tensor, "num_points 3"],
    proposals: Float[Tensor, "num_proposals 7"],
    truths: Float[Tensor, "num_objects 7"],
    limits: ProposalSamplingConfig,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the pooled points of a scene with all proposals by kind: from above and in 3D.

    Kinds are those of the sampling: foreground, hard and easy background, and those between, which
    are no samples. Objects are white.
    """
    iou = assign_truths(pairwise_iou_3d(proposals.double(), truths.double()), truths.double()).iou
    is_foreground, is_background = iou >= limits.foreground_iou, iou < limits.background_iou
    is_easy = iou < limits.easy_iou
    low, high, easy = limits.background_iou, limits.foreground_iou, limits.easy_iou
    groups = (
        (f"easy background, IoU below {easy:g}", is_easy, PROPOSED),
        (f"between, {low:g} to {high:g}", ~is_foreground & ~is_background, _BETWEEN),
        (f"hard background, {easy:g} to {low:g}", is_background & ~is_easy, _HARD),
        (f"foreground, {high:g} or more", is_foreground, RIGHT),
    )
    view = BirdsEyeView(pixels_per_m=_SCENE_PX / 44.0)
    above = draw_birds_eye(pooled, view=view)
    scene_px = above.shape[0] // 2 - 2 * _TEXT_PX
    camera = behind_and_above(scene_px, _SCENE_PX)
    bare = np.zeros((scene_px, _SCENE_PX, 3), np.uint8)
    _put_cloud(bare, pooled, camera, (205, 210, 218), diameter_px=1.8)
    scene = bare
    for _, chosen, color in groups:
        boxes = Boxes3D(proposals[chosen])
        names = ("",) * len(boxes)
        put_boxes_from_above(above, view, boxes, names, color=color)
        scene = draw_boxes3d(scene, boxes, names, camera, color=color, tags=False)
    objects, names = Boxes3D(truths), ("",) * len(truths)
    put_boxes_from_above(above, view, objects, names, color=LABELLED)
    bare = draw_boxes3d(bare, objects, names, camera, color=LABELLED, tags=False)
    right = np.concatenate(
        (
            with_title(scene, "in 3D: all proposals"),
            with_title(bare, "the same points, and objects"),
        )
    )
    above = with_title(above, f"{title}: all proposals from above")
    rows = max(len(above), len(right))
    body = np.concatenate([_padded(each, rows) for each in (above, right)], axis=1)
    entries = [(f"{name}: {int(chosen.sum())}", color) for name, chosen, color in groups[::-1]]
    return np.concatenate((body, _legend([*entries, ("object", LABELLED)], body.shape[1])))


def _beside(box: Float[Tensor, "7"], size: tuple[int, int]) -> Calibration:
    """Camera that sees a box from the LiDAR's side, turned by 40 degrees and from above."""
    x, y, z = box[:3].tolist()
    azimuth = math.atan2(y, x) + math.radians(_SIDE_DEG)
    down = math.radians(_ELEVATION_DEG)
    ahead = (
        math.cos(azimuth) * math.cos(down),
        math.sin(azimuth) * math.cos(down),
        -math.sin(down),
    )
    away = _DISTANCES * float(box[3:6].norm()) / 2
    place = (x - away * ahead[0], y - away * ahead[1], z - away * ahead[2])
    return camera_at(place, ahead, focal_px=1.15 * size[1], size=size)


def _put_cloud(
    canvas: UInt8[np.ndarray, "height width 3"],
    points: Float[Tensor, "num_points 3"],
    camera: Calibration,
    color: RGB,
    *,
    diameter_px: float,
) -> None:
    """Draw points in one colour."""
    projected = project_points(points, camera)
    pixels = projected.pixels[projected.in_image((canvas.shape[0], canvas.shape[1]))].numpy()
    colors = np.broadcast_to(np.array(color, np.uint8), (len(pixels), 3)).copy()
    put_points(canvas, pixels, colors, diameter_px=diameter_px)


def _text_block(
    lines: Sequence[tuple[str, RGB]], width: int
) -> UInt8[np.ndarray, "height width 3"]:
    block = np.full((len(lines) * _LINE_PX + 8, width, 3), PAGE, np.uint8)
    for number, (text, color) in enumerate(lines):
        baseline = (number + 1) * _LINE_PX - 4
        put_text(block, text, 8, baseline, height_px=_TEXT_PX, color=color)
    return block


def _legend(entries: Sequence[tuple[str, RGB]], width: int) -> UInt8[np.ndarray, "height width 3"]:
    """Line of coloured squares with their names; as many lines as are needed."""
    rows: list[list[tuple[int, str, RGB]]] = [[]]
    left = 8
    for text, color in entries:
        needed = _TEXT_PX + 8 + text_width(text, _TEXT_PX) + 24
        if rows[-1] and left + needed > width:
            rows.append([])
            left = 8
        rows[-1].append((left, text, color))
        left += needed
    block = np.full((len(rows) * _LINE_PX + 10, width, 3), PAGE, np.uint8)
    for number, row in enumerate(rows):
        baseline = (number + 1) * _LINE_PX - 2
        for left, text, color in row:
            block[baseline - _TEXT_PX : baseline, left : left + _TEXT_PX] = color
            put_text(block, text, left + _TEXT_PX + 8, baseline, height_px=_TEXT_PX, color=TITLE)
    return block


def _padded(
    picture: UInt8[np.ndarray, "height width 3"], rows: int
) -> UInt8[np.ndarray, "new_height width 3"]:
    """Fill a picture up to a height with the page's colour."""
    page = np.full((rows, *picture.shape[1:]), PAGE, np.uint8)
    page[: len(picture)] = picture
    return page
