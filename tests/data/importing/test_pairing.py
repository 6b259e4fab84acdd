import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.importing.pairing import pair_nearest
from tests.reference import pairing as reference

times = st.lists(st.integers(0, 30), max_size=12).map(sorted)


@given(camera=times, lidar=times, max_gap=st.integers(0, 6))
def test_pairs_are_those_of_a_look_at_every_two(camera, lidar, max_gap):
    found = pair_nearest(np.array(camera, np.int64), np.array(lidar, np.int64), max_gap)
    assert found.tolist() == reference.pairs(camera, lidar, max_gap)
    assert all(len(set(column)) == len(column) for column in found.T.tolist())


def test_of_a_faster_camera_the_best_images_are_taken():
    camera, lidar = np.arange(0, 1000, 33, np.int64), np.arange(0, 1000, 100, np.int64)
    found = pair_nearest(camera, lidar, 20)
    assert len(found) == len(lidar)
    assert np.abs(camera[found[:, 0]] - lidar[found[:, 1]]).max() <= 16
