"""Contact sheet of the simulator: `python -m benchmarks.contact_sheet`.

Twelve frames from twelve seeds: the image with boxes, the LiDAR on the image, and the view from
above, as docs/pictures/street_simulator.jpg.
"""

from pathlib import Path

import cv2
import jsonargparse
import numpy as np
from jaxtyping import UInt8

from sightline.files.atomic import atomic_write_bytes
from sightline.geometry.boxes2d import Boxes2D
from sightline.jobs.progress import track
from sightline.simulation.dataset import sample_of
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye
from sightline.visualization.image import draw_boxes2d, draw_boxes3d, draw_points

_HEIGHT_PX = 160
_GAP_PX = 4
_JPEG_QUALITY = 80
_VIEW = BirdsEyeView(x_min_m=-3.0, x_max_m=47.0, y_min_m=-25.0, y_max_m=25.0, pixels_per_m=6.4)


def main(
    out: Path = Path("docs/pictures/street_simulator.jpg"),
    first_seed: int = 0,
    frames: int = 12,
    *,
    hard_negatives: bool = False,
) -> None:
    """Simulate the frames and draw them, in two columns of three pictures each.

    Args:
        out: Picture to write.
        first_seed: Seed of the first frame; the others follow.
        frames: Number of frames, even.
        hard_negatives: Whether streets have many objects that look like people and cars.
    """
    seeds = range(first_seed, first_seed + frames)
    rows = [
        _row(
            sample_of(simulate_frame(SimulationConfig(seed=seed, hard_negatives=hard_negatives), 0))
        )
        for seed in track(seeds, description="simulating")
    ]
    columns = [np.concatenate(rows[start::2]) for start in (0, 1)]
    sheet = np.concatenate(columns, axis=1)
    _, encoded = cv2.imencode(".jpg", sheet[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    atomic_write_bytes(out, encoded.tobytes())
    print(out)


def _row(sample: CameraLidarSample) -> UInt8[np.ndarray, "height width 3"]:
    assert sample.image is not None, "a simulated sample has an image"
    assert sample.points is not None, "a simulated sample has a sweep"
    assert sample.objects is not None, "a simulated sample has labels"
    image = sample.image.numpy().transpose(1, 2, 0)
    objects = sample.objects.select(sample.objects.has_box3d)
    boxes = draw_boxes3d(
        image, objects.boxes3d, objects.class_names, sample.calibration, tags=False
    )
    boxes = draw_boxes2d(boxes, Boxes2D(objects.boxes2d.tensor), objects.class_names, tags=False)
    dimmed = np.rint(image * 0.55).astype(np.uint8)
    sweep = draw_points(dimmed, sample.points, sample.calibration)
    above = draw_birds_eye(sample.points, objects.boxes3d, objects.class_names, view=_VIEW)
    return np.concatenate([_scaled(picture) for picture in (boxes, sweep, above)], axis=1)


def _scaled(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "height_px width_px 3"]:
    width = round(picture.shape[1] * _HEIGHT_PX / picture.shape[0])
    small = cv2.resize(picture, (width, _HEIGHT_PX), interpolation=cv2.INTER_AREA)
    framed = cv2.copyMakeBorder(
        small, 0, _GAP_PX, 0, _GAP_PX, cv2.BORDER_CONSTANT, value=(255, 255, 255)
    )
    return framed.astype(np.uint8, copy=False)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
