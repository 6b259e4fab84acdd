"""Small data sets in KITTI's layouts."""

from pathlib import Path

import torch

from sightline.data.formats.kitti_files import write_image, write_object_calibration, write_points
from sightline.geometry.calibration import Calibration

IMAGE_SIZE = (24, 32)


def small_calibration() -> Calibration:
    """Calibration of a camera at the LiDAR's origin that looks along its x axis."""
    return Calibration(
        image_from_camera=torch.tensor(
            [[20.0, 0, 16, 0], [0, 20, 12, 0], [0, 0, 1, 0]], dtype=torch.float64
        ),
        camera_from_lidar=torch.tensor(
            [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64
        ),
    )


def write_object_tree(root: Path, num_frames: int, *, num_points: int = 200) -> Path:
    """Write frames 000000 and following, with points in front of the camera."""
    generator = torch.Generator().manual_seed(0)
    for number in range(num_frames):
        name = f"{number:06}"
        ahead = 5 + 40 * torch.rand(num_points, generator=generator)
        aside = (torch.rand(num_points, 2, generator=generator) - 0.5) * ahead[:, None]
        points = torch.cat((ahead[:, None], aside, ahead[:, None] / 50), dim=1)
        write_points(root / "training" / "velodyne" / f"{name}.bin", points)
        write_object_calibration(root / "training" / "calib" / f"{name}.txt", small_calibration())
        image = torch.zeros(3, *IMAGE_SIZE, dtype=torch.uint8)
        image[:, 0] = 255  # images of one colour cause a warning
        image[1, 0, : number + 1] = 128  # as do equal images
        write_image(root / "training" / "image_2" / f"{name}.png", image)
    return root


def contents_of(folder: Path) -> dict[str, bytes]:
    """Bytes of every file of a folder, by name."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
