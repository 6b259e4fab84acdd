import pytest
import torch

from sightline.structures.batch import CameraLidarBatch


def batch(names=("000001", "000002"), **changes):
    maps = {"sparse_depth_m": torch.ones(2, 1, 4, 6), "depth_m": torch.full((2, 1, 4, 6), 2.0)}
    return CameraLidarBatch(sample_ids=names, image=torch.zeros(2, 3, 4, 6), **(maps | changes))


def test_to_moves_every_tensor_and_keeps_names_and_gaps():
    moved = batch().to("meta")
    assert moved.sample_ids == ("000001", "000002")
    assert moved.filled_depth_m is None
    assert {
        moved.image.device.type,
        moved.sparse_depth_m.device.type,
        moved.depth_m.device.type,
    } == {"meta"}


def test_its_length_is_the_number_of_samples():
    assert len(batch()) == 2


def test_a_batch_with_a_name_too_few_is_refused():
    with pytest.raises(ValueError, match="got 1 names for 2 images"):
        batch(names=("000001",))


def test_maps_of_another_size_than_the_image_are_refused():
    with pytest.raises(TypeError):
        batch(depth_m=torch.ones(2, 1, 4, 7))


def test_batches_are_joined_in_order_and_what_none_has_stays_out():
    joined = CameraLidarBatch.concatenate((batch(("a", "b")), batch(("c", "d"))))
    assert joined.sample_ids == ("a", "b", "c", "d")
    assert joined.depth_m.shape == (4, 1, 4, 6)
    assert joined.filled_depth_m is None


def test_batches_of_which_some_lack_a_map_are_not_joined():
    with pytest.raises(ValueError, match="depth_m differs between the samples"):
        CameraLidarBatch.concatenate((batch(), batch(depth_m=None)))


def test_no_batches_make_no_batch():
    with pytest.raises(ValueError, match="at least one"):
        CameraLidarBatch.concatenate(())
