from dataclasses import replace

import pytest
import torch

from sightline.simulation.dataset import SimulatedDataset
from tests.simulation.data_sets import TINY
from tests.simulation.small_streets import make_tiny_street


def test_a_data_set_without_files_gives_reduced_samples():
    dataset = SimulatedDataset(2, TINY, make_tiny_street)
    sample = dataset[1]
    assert dataset.sample_ids == ("000000", "000001")
    assert sample.sample_id == "000001"
    assert (sample.points[:, 0] > 0).all()
    with pytest.raises(IndexError, match="of 2 samples has no sample 2; they are numbered"):
        dataset[2]


def test_a_data_set_of_fewer_than_no_frames_is_refused():
    with pytest.raises(ValueError, match="num_frames must not be negative, got -1"):
        SimulatedDataset(-1)


def test_a_sample_without_the_camera_lacks_the_image_alone():
    sample = SimulatedDataset(1, replace(TINY, camera=False), make_tiny_street)[0]
    other = SimulatedDataset(1, TINY, make_tiny_street)[0]
    assert sample.image is None
    assert sample.image_size == other.image_size
    assert torch.equal(sample.points, other.points)
    assert torch.equal(sample.depth, other.depth)
    assert torch.equal(sample.objects.boxes2d.tensor, other.objects.boxes2d.tensor)
