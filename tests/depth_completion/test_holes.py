from dataclasses import replace

import numpy as np
import pytest

from sightline.augmentation.sample_changes import thin_rings
from sightline.data.open import open_dataset
from sightline.depth_completion.sparse_map import BESIDE_SHARE, find_holes
from sightline.geometry.projection import project_points, sparse_depth_map
from sightline.simulation.packaged import PACKAGED_FRAMES


def holes_of(sample):
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    return find_holes(sparse.numpy())


def without_columns(sample, first, last):
    columns = project_points(sample.points[:, :3].double(), sample.calibration).pixels[:, 0]
    return replace(sample, points=sample.points[(columns < first) | (columns >= last)])


@pytest.fixture(scope="module")
def samples():
    dataset = open_dataset(PACKAGED_FRAMES, parts={"image", "points"})
    return [dataset[index] for index in range(len(dataset))]


@pytest.mark.parametrize("keep_every", [1, 2, 4, 8])
def test_sound_sweeps_have_no_holes_with_64_beams_or_8(samples, keep_every):
    assert not any(holes_of(thin_rings(each, keep_every)).any() for each in samples)


def test_a_hidden_half_is_a_hole_a_little_away_from_the_last_return(samples):
    width = samples[0].image_size[1]
    for sample in samples:
        holes = holes_of(without_columns(sample, width // 2, width))
        assert (holes == holes[0]).all()  # whole columns
        assert not holes[:, : width // 2].any()
        begin = np.argmax(holes[0])
        assert abs(begin - width // 2 - BESIDE_SHARE * width) < 0.02 * width
        assert holes[:, begin:].all()


def test_all_is_a_hole_where_nothing_returned():
    assert find_holes(np.zeros((5, 7), np.float32)).all()


def test_a_single_return_fills_the_columns_around_it():
    sparse = np.zeros((6, 80), np.float32)
    sparse[3, 40] = 9.0
    columns = np.flatnonzero(~find_holes(sparse)[0])
    assert columns.tolist() == [38, 39, 40, 41, 42]  # 2.5 % of 80 columns to either side
