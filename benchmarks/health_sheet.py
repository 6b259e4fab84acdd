"""Health of sensors that fail, as a picture: `python -m benchmarks.health_sheet DATA OUT.png`.

The frames of a data set in order, with faults that begin and end: a covered lens, false echoes, a
missing camera, a LiDAR that turns in its mount.
"""

from pathlib import Path

import jsonargparse
import numpy as np
import torch

from sightline.augmentation.faults import FalseEchoes, Fault, NoCamera, TurnedLidar
from sightline.corruptions.occlusion import CameraOcclusion
from sightline.corruptions.pixel_box import BoxDrawing
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.health.sequence import DriveMonitor
from sightline.visualization.health_timeline import draw_health

_FAULTS: tuple[tuple[range, Fault], ...] = (
    (range(6, 14), CameraOcclusion(box=BoxDrawing(placement="uniform"))),
    (range(18, 26), FalseEchoes(share=0.1)),
    (range(28, 34), NoCamera()),
    (range(44, 60), TurnedLidar(yaw_deg=1.0)),
)


def main(
    data: Path,
    out: Path,
    sample_list: str | None = None,
    velodyne: Velodyne = "velodyne",
    frames: int = 60,
) -> None:
    """Write the picture.

    Args:
        data: KITTI object tree or raw drive.
        out: PNG to write.
        sample_list: List of frames.
        velodyne: Folder of the sweeps in an object tree.
        frames: Number of frames, from the first.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts={"image", "points"}
    )
    monitor = DriveMonitor()
    states = []
    for number in range(min(frames, len(dataset))):
        sample = dataset[number]
        for when, fault in _FAULTS:
            if number in when:
                sample = fault(sample, np.random.default_rng(3))
        states.append(monitor(sample))
    write_rgb(out, draw_health(states))


if __name__ == "__main__":
    jsonargparse.auto_cli(main)
