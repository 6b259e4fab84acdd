import numpy as np
import torch

from sightline.data.formats.kitti_files import (
    read_depth,
    read_image,
    read_points,
    write_image,
    write_points,
)
from tests.data.trees import IMAGE_SIZE, depth_map, picture, points, write_selection


def test_convention_images_are_rgb_channels_first(tmp_path):
    image = torch.from_numpy(picture()).permute(2, 0, 1)
    write_image(tmp_path / "0.png", image)
    read = read_image(tmp_path / "0.png")
    assert read.shape == (3, *IMAGE_SIZE)
    assert read.is_contiguous()
    assert torch.equal(read, image)


def test_sweeps_survive_reading_and_writing_as_tensors(tmp_path):
    write_points(tmp_path / "0.bin", points())
    assert torch.equal(read_points(tmp_path / "0.bin"), points())
    write_points(tmp_path / "0.bin", points(0))
    assert read_points(tmp_path / "0.bin").shape == (0, 4)


def test_depth_maps_are_read_as_tensors_of_metres(tmp_path):
    write_selection(tmp_path)
    path = next(tmp_path.rglob("velodyne_raw/*.png"))
    assert np.array_equal(read_depth(path).numpy(), depth_map())
