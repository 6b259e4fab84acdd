"""Picture of Sightline's claim: `python -m benchmarks.claim_sheet`.

A simulated frame with both sensors, without the camera, without the LiDAR, and with 16 of 64 beams:
joined objects in the camera's picture (without a camera: in the sweep's) and from above. Labels are
white.
"""

from pathlib import Path
from typing import Final

import jsonargparse
import numpy as np
import torch
from jaxtyping import UInt8

import sightline
from benchmarks.joined_frames import CASES
from benchmarks.sheet_file import write_sheet
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.objects import Objects
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import (
    BirdsEyeView,
    draw_birds_eye,
    put_boxes_from_above,
)
from sightline.visualization.cells import titled_cell
from sightline.visualization.image import camera_picture, draw_boxes2d, sweep_picture
from sightline.visualization.objects import OBJECTS_LEGEND, box_styles, draw_objects
from sightline.visualization.zoom import zoomed

_STATES: Final = {
    "clean": "Both sensors",
    "camera_blank": "Camera blank",
    "lidar_blank": "LiDAR blank",
    "beams_16_from_0": "16 beams",
}
_WHITE = (245, 245, 245)
_MAX_BYTES = 250_000
_HALF_WIDTH_M = 20.0
_ABOVE_PX = 250

Picture = UInt8[np.ndarray, "height width 3"]


def main(
    weights: str = "joined",
    out: Path = Path("docs/pictures/claim.jpg"),
    data: Path = PACKAGED_FRAMES,
    frame: int = 0,
    width_px: int = 800,
    min_score: float = 0.3,
) -> None:
    """Draw a row for each state, the image on the left and the view from above on the right.

    Args:
        weights: Name of the weights of a task that joins objects.
        out: Picture to write.
        data: KITTI object tree.
        frame: Index of the frame.
        width_px: Width of the image.
        min_score: Objects of a lower score are not drawn.
    """
    torch.set_num_threads(1)
    predictor = sightline.load(weights)
    sample = KittiObjectDataset(data)[frame]
    rows = []
    for name, title in _STATES.items():
        changed = CASES[name](sample, 0)
        objects = predictor(changed).objects
        assert objects is not None, "the predictor joins objects"
        kept = objects.select((objects.scores >= min_score).nonzero()[:, 0])
        rows.append(_row(title, changed, kept, width_px))
    write_sheet(out, np.concatenate(rows), _MAX_BYTES)
    print(out)


def _row(title: str, sample: CameraLidarSample, objects: Objects, width_px: int) -> Picture:
    height, width = sample.image_size
    size = (round(height * width_px / width), width_px)
    fitted, scaled = zoomed(sample, Perception(objects=objects), size)
    assert scaled.objects is not None, "it was given"
    picture = sweep_picture(fitted) if sample.image is None else camera_picture(fitted)
    if fitted.objects is not None:
        labels = fitted.objects
        picture = draw_boxes2d(
            picture, labels.boxes2d, labels.class_names, color=_WHITE, tags=False
        )
    cells = (
        titled_cell(title, OBJECTS_LEGEND, draw_objects(picture, scaled.objects, fitted)),
        titled_cell("", "from above", _above(sample, objects, size[0])),
    )
    return np.concatenate(cells, axis=1)


def _above(sample: CameraLidarSample, objects: Objects, height_px: int) -> Picture:
    pixels_per_m = _ABOVE_PX / (2 * _HALF_WIDTH_M)
    view = BirdsEyeView(
        x_min_m=-2.0,
        x_max_m=height_px / pixels_per_m - 2.0,
        y_min_m=-_HALF_WIDTH_M,
        y_max_m=_HALF_WIDTH_M,
        pixels_per_m=pixels_per_m,
    )
    picture = draw_birds_eye(
        sample.points, calibration=sample.calibration, image_size=sample.image_size, view=view
    )
    if sample.objects is not None:
        labels = sample.objects
        put_boxes_from_above(picture, view, labels.boxes3d, labels.class_names, color=_WHITE)
    put_boxes_from_above(
        picture,
        view,
        objects.boxes3d,
        objects.class_names,
        styles=box_styles(objects, sample),
    )
    return picture


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
