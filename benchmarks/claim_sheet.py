"""Picture of Sightline's claim: `python -m benchmarks.claim_sheet`.

A simulated frame with both sensors, without the camera, and without the LiDAR: the data of each
sensor, with the fused detector's boxes. Labels are white.
"""

from pathlib import Path

import jsonargparse
import numpy as np
import torch
from jaxtyping import UInt8

from benchmarks.sheet_file import write_sheet
from sightline.corruptions.suites import SUITES
from sightline.data.kitti_object import KittiObjectDataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.results import DRAWN_SCORE
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections2D
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.cells import titled_cell
from sightline.visualization.image import camera_picture, draw_boxes2d, sweep_picture

_CASES = {
    "clean": "Both sensors",
    "camera_blank": "Camera blank",
    "lidar_blank": "LiDAR blank",
}
_WHITE = (245, 245, 245)
_MAX_BYTES = 200_000

Picture = UInt8[np.ndarray, "height width 3"]


def main(
    weights: str = "detection2d-best",
    out: Path = Path("docs/pictures/claim.jpg"),
    data: Path = PACKAGED_FRAMES,
    frame: int = 0,
    width_px: int = 620,
) -> None:
    """Draw a row for each case, the camera on the left and the LiDAR on the right.

    Args:
        weights: Name or file of the weights of a 2D detector with gates.
        out: Picture to write.
        data: KITTI object tree.
        frame: Index of the frame.
        width_px: Width of each sensor's picture.
    """
    torch.set_num_threads(1)
    predictor = DetectionPredictor.load(weights)
    sample = KittiObjectDataset(data)[frame]
    cases = {case.name: case for case in SUITES["dgfn7"].cases}
    rows = [
        _row(title, cases[name].corrupt(sample, 0).sample, predictor, width_px)
        for name, title in _CASES.items()
    ]
    write_sheet(out, np.concatenate(rows), _MAX_BYTES)
    print(out)


def _row(
    title: str, sample: CameraLidarSample, predictor: DetectionPredictor, width_px: int
) -> Picture:
    prediction = predictor(sample)
    assert prediction.camera_gate is not None, "it has gates"
    assert prediction.lidar_gate is not None, "it has gates"
    found = prediction.detections.filter_by_score(DRAWN_SCORE)
    cells = [
        titled_cell(
            name,
            f"{sensor} gate {float(gate.mean()):.2f}",
            _with_boxes(scaled_to_width(picture, width_px), sample, found),
        )
        for name, sensor, picture, gate in (
            (title, "camera", camera_picture(sample), prediction.camera_gate),
            ("", "LiDAR", sweep_picture(sample), prediction.lidar_gate),
        )
    ]
    return np.concatenate(cells, axis=1)


def _with_boxes(picture: Picture, sample: CameraLidarSample, found: Detections2D) -> Picture:
    scale_y, scale_x = (
        new / old for new, old in zip(picture.shape[:2], sample.image_size, strict=True)
    )
    if sample.objects is not None:
        labels = sample.objects
        boxes = labels.boxes2d.resize(scale_x, scale_y)
        picture = draw_boxes2d(picture, boxes, labels.class_names, color=_WHITE, tags=False)
    boxes = found.boxes.resize(scale_x, scale_y)
    return draw_boxes2d(picture, boxes, found.class_names, scores=found.scores)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
