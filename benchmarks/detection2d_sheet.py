"""A 2D detector on frames with failing sensors: `python -m benchmarks.detection2d_sheet`.

Each frame clean and in each case of suite dgfn7: the image with detections (labels in white), the
camera's gate over it and the LiDAR's over the sweep. Partly affected regions are outlined. The
picture takes 600 KB at most.
"""

from pathlib import Path

import jsonargparse
import numpy as np
from jaxtyping import UInt8

from benchmarks.sheet_file import write_sheet
from sightline.corruptions.suites import SUITES
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.results import prediction_row
from sightline.jobs.progress import track
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample

_MAX_BYTES = 600_000


def main(
    weights: str,
    out: Path = Path("docs/pictures/detection2d.jpg"),
    data: Path = PACKAGED_FRAMES,
    frames: int = 1,
    seed: int = 3,
    width_px: int = 460,
) -> None:
    """Draw the frames side by side, a row for each case.

    Args:
        weights: Name or file of trained weights.
        out: Picture to write.
        data: KITTI object tree.
        frames: Number of frames, evenly spread over the data.
        seed: Seed of the cases' random draws.
        width_px: Width of each of a frame's three pictures.
    """
    predictor = DetectionPredictor.load(weights)
    dataset = KittiObjectDataset(data)
    indices = np.linspace(0, len(dataset) - 1, frames).round().astype(int).tolist()
    columns = [
        _column(dataset[index], predictor, seed, width_px)
        for index in track(indices, description="detecting")
    ]
    height = max(len(column) for column in columns)  # KITTI's images differ by a few rows
    filled = [np.pad(each, ((0, height - len(each)), (0, 0), (0, 0))) for each in columns]
    sheet = np.concatenate(filled, axis=1)
    write_sheet(out, sheet, _MAX_BYTES)
    print(out)


def _column(
    sample: CameraLidarSample, predictor: DetectionPredictor, seed: int, width_px: int
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw all cases of a frame, one below the other."""
    rows = []
    for case in SUITES["dgfn7"].cases:
        corrupted = case.corrupt(sample, seed)
        masks = (corrupted.camera_mask, corrupted.lidar_mask)
        title = f"{case.name}  {sample.sample_id}"
        result = predictor(corrupted.sample)
        rows.append(prediction_row(title, corrupted.sample, result, masks=masks, width_px=width_px))
    return np.concatenate(rows)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
