"""Small data sets on disk for the tests of their readers."""

from pathlib import Path

import numpy as np
import torch

from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_files import (
    write_object_calibration,
    write_points,
    write_raw_calibration,
)
from sightline.data.formats.map_png import write_depth_png
from sightline.geometry.calibration import Calibration

IMAGE_SIZE = (12, 40)
INTRINSICS = ((20.0, 0.0, 19.5), (0.0, 20.0, 5.5), (0.0, 0.0, 1.0))
LABELS = (
    "Car 0.10 0 -1.57 5.00 3.00 20.00 9.00 1.50 1.60 3.90 0.50 1.60 12.00 -1.53\n"
    "DontCare -1 -1 -10 1.00 1.00 4.00 4.00 -1 -1 -1 -1000 -1000 -1000 -10\n"
)


def calibration() -> Calibration:
    """A camera that looks along the LiDAR's x axis, mounted a little ahead of it."""
    image_from_camera = torch.zeros(3, 4, dtype=torch.float64)
    image_from_camera[:, :3] = torch.tensor(INTRINSICS, dtype=torch.float64)
    image_from_camera[0, 3] = 1.25
    camera_from_lidar = torch.tensor(
        [[0.0, -1.0, 0.0, 0.1], [0.0, 0.0, -1.0, -0.2], [1.0, 0.0, 0.0, -0.3], [0, 0, 0, 1]],
        dtype=torch.float64,
    )
    return Calibration(image_from_camera=image_from_camera, camera_from_lidar=camera_from_lidar)


def points(count: int = 24) -> torch.Tensor:
    """Points ahead of the LiDAR, in the image's view."""
    distance = torch.arange(count, dtype=torch.float32) / 5 + 5
    return torch.stack((distance, distance / 50, -distance / 50, distance / 100), dim=1)


def picture(seed: int = 0, size: tuple[int, int] = IMAGE_SIZE) -> np.ndarray:
    """A picture of noise."""
    return np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)


def depth_map(seed: int = 0, size: tuple[int, int] = IMAGE_SIZE) -> np.ndarray:
    """Depths on a third of the pixels, in KITTI's steps."""
    steps = np.random.default_rng(seed).integers(1, 25000, size)
    return np.where(steps % 3 == 0, steps / 256, 0).astype(np.float32)


def write_object_frame(
    root: Path, frame_id: str, split: str = "training", *, seed: int = 0
) -> None:
    """One whole frame of the object tree; each seed has other files."""
    folder = root / split
    write_rgb(folder / "image_2" / f"{frame_id}.png", picture(seed))
    write_points(folder / "velodyne" / f"{frame_id}.bin", points(24 + seed))
    write_object_calibration(folder / "calib" / f"{frame_id}.txt", calibration())
    if split == "training":
        (folder / "label_2").mkdir(exist_ok=True)
        (folder / "label_2" / f"{frame_id}.txt").write_text(
            LABELS.replace("4.00 4.00 -1", f"4.00 {4 + seed / 100:.2f} -1")
        )


def write_object_tree(root: Path, *frame_ids: str) -> Path:
    """Whole training frames."""
    for seed, frame_id in enumerate(frame_ids):
        write_object_frame(root, frame_id, seed=seed)
    return root


def intrinsics_text() -> str:
    """The nine numbers of an `intrinsics` file."""
    return " ".join(str(value) for row in INTRINSICS for value in row)


def write_selection(root: Path, number: str = "0000000005", seed: int = 0) -> str:
    """One frame of the depth benchmark's cropped selection; answers with its name."""
    drive, camera = "2011_09_26_drive_0002_sync", "image_02"
    folder = root / "depth_selection" / "val_selection_cropped"
    name = f"{drive}_image_{number}_{camera}"
    write_rgb(folder / "image" / f"{name}.png", picture(seed))
    for kind, offset in (("velodyne_raw", 0), ("groundtruth_depth", 1)):
        path = folder / kind / f"{drive}_{kind}_{number}_{camera}.png"
        write_depth_png(path, depth_map(seed + offset))
    (folder / "intrinsics").mkdir(exist_ok=True)
    (folder / "intrinsics" / f"{name}.txt").write_text(intrinsics_text())
    return name


def write_depth_drive(root: Path, raw_root: Path, split: str = "val") -> str:
    """One frame of the depth benchmark's drives and of the raw recording; answers with its name."""
    drive, camera, number = "2011_09_26_drive_0002_sync", "image_02", "0000000005"
    for archive, kind, seed in (
        ("data_depth_velodyne", "velodyne_raw", 0),
        ("data_depth_annotated", "groundtruth", 1),
    ):
        folder = root / archive / split / drive / "proj_depth" / kind / camera
        write_depth_png(folder / f"{number}.png", depth_map(seed))
    day = raw_root / "2011_09_26"
    write_rgb(day / drive / camera / "data" / f"{number}.png", picture())
    write_raw_calibration(day, calibration())
    return f"{drive}_image_{number}_{camera}"


def write_drive(folder: Path, num_frames: int = 3, *, official: bool = True) -> Path:
    """A raw drive without poses; times and a day only where official."""
    images = folder / "image_02" / "data" if official else folder / "image_02"
    sweeps = folder / "velodyne_points" / "data" if official else folder / "velodyne"
    for number in range(num_frames):
        write_rgb(images / f"{number:010}.png", picture(number))
        write_points(sweeps / f"{number:010}.bin", points(24 + number))
    write_raw_calibration(folder.parent if official else folder, calibration())
    if official:
        times = [f"2011-09-26 13:02:25.{number}64389445\n" for number in range(num_frames)]
        (folder / "velodyne_points" / "timestamps.txt").write_text("".join(times))
    return folder
