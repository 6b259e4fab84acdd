import pytest
import torch

from sightline.depth_completion.batch import DepthBatch


def test_maps_of_another_size_than_the_image_are_refused():
    maps = {"sparse_depth_m": torch.ones(2, 1, 4, 6), "depth_m": torch.ones(2, 1, 4, 7)}
    with pytest.raises(TypeError):
        DepthBatch(sample_ids=("a", "b"), image=torch.zeros(2, 3, 4, 6), **maps)
