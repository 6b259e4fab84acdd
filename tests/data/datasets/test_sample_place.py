import numpy as np
import pytest
import torch

from sightline.data.datasets.sample_dataset import NamedSubset
from sightline.data.open import open_dataset
from sightline.geometry.arguments import sample_index
from sightline.simulation.packaged import PACKAGED_FRAMES


@pytest.mark.parametrize("place", [1, -1, np.int64(1), np.uint8(1), torch.tensor(1)])
def test_whole_numbers_of_any_type_are_places_and_negative_ones_count_from_the_end(place):
    assert sample_index(place, 2) == 1


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (slice(0, 2), r"whole number, got slice\(0, 2, None\); for several samples: \["),
        ("000001", r"got '000001'; for a name: dataset\[dataset.sample_ids.index\('000001'\)\]"),
        (1.0, "got 1.0; for"),
        (None, "got None; for"),
        (True, "got True; for"),
        (np.array([True, False]), r"got array\("),
    ],
)
def test_anything_else_is_told_how_to_ask(place, said):
    with pytest.raises(TypeError, match=said):
        sample_index(place, 2)


def test_data_sets_tell_their_length_and_end_where_it_says():
    dataset = open_dataset(PACKAGED_FRAMES)
    for each in (dataset, NamedSubset(dataset, ["000001", "000000"])):
        with pytest.raises(IndexError, match="a data set of 2 samples has no sample 99; they are"):
            each[99]
        with pytest.raises(IndexError, match="of 2 samples has no sample -3"):
            each[-3]
        assert len(list(each)) == 2
    with pytest.raises(IndexError, match=r"a data set of 0 samples has no sample 0$"):
        sample_index(0, 0)
