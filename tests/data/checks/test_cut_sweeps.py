"""Sweeps whose end a broken copy lost, and whole ones that look a little like them."""

import numpy as np
import pytest

from sightline.data.check import check_tree
from sightline.data.checks.cut_sweeps import cut_sweeps
from sightline.data.datasets.sample_files import warn_of_missing_sensors
from sightline.data.open import open_dataset
from tests.data.trees import write_object_tree

NAMES = tuple(f"{number:06d}" for number in range(5))
RING_POINTS = 330


def rings(seed, *, last_deg=-24.0):
    """A sweep of 40 rings on a level road and on walls, stored from the highest to the lowest."""
    rng = np.random.default_rng(seed)
    elevation = np.radians(np.linspace(2, last_deg, 40)).repeat(RING_POINTS)
    azimuth = np.radians(np.tile(np.linspace(-40, 40, RING_POINTS), 40))
    road_m = np.where(elevation < 0, -1.73 / np.sin(np.minimum(elevation, -1e-3)), np.inf)
    range_m = np.minimum(np.tile(rng.uniform(20, 60, RING_POINTS), 40), road_m)
    level_m = range_m * np.cos(elevation)
    sweep = (level_m * np.cos(azimuth), level_m * np.sin(azimuth), range_m * np.sin(elevation))
    return np.stack((*sweep, rng.uniform(0, 1, len(elevation))), axis=1).astype("<f4")


@pytest.fixture
def tree(tmp_path):
    root = write_object_tree(tmp_path, *NAMES)
    for number, path in enumerate(paths_of(root)):
        path.write_bytes(rings(number)[number:].tobytes())  # of different lengths
    return root


def paths_of(root):
    return sorted((root / "training" / "velodyne").iterdir())


def cut(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content)) // 4096 * 4096])


def test_a_cut_sweep_is_told_by_check_and_counted_before_predictions(tree):
    assert not cut_sweeps(paths_of(tree))
    for place in (1, 3):
        cut(paths_of(tree)[place], 0.6)
    told = [each.path.stem for each in check_tree(tree) if "cut short" in each.problem]
    assert told == [NAMES[1], NAMES[3]]
    said = "clouds of 2 of 5 frames were probably cut short by a copy, the first is 000001;"
    dataset = open_dataset(tree)
    with pytest.warns(UserWarning, match=said):
        warn_of_missing_sensors(dataset, tree, ("image", "points"))


def test_a_faulty_sweep_does_not_hide_a_cut_one(tree):
    cut(paths_of(tree)[1], 0.6)
    flat = rings(2)[2:]
    flat[:, 2] = 0
    paths_of(tree)[2].write_bytes(flat[:-5].tobytes())
    write = paths_of(tree)[2].with_name("000005.bin").write_bytes
    write(rings(5)[5:].tobytes())
    assert [path.stem for path in cut_sweeps(paths_of(tree))] == [NAMES[1]]


def test_a_whole_sweep_that_ends_at_a_block_is_sound(tree):
    path = paths_of(tree)[2]
    whole = rings(2)
    left_out = len(whole) % 256
    path.write_bytes(whole[left_out:].tobytes())
    assert path.stat().st_size % 4096 == 0
    assert not cut_sweeps(paths_of(tree))


def test_a_sweep_without_low_rings_that_ends_at_no_block_is_sound(tree):
    paths_of(tree)[2].write_bytes(rings(2)[:6001].tobytes())
    assert not cut_sweeps(paths_of(tree))


def test_sweeps_of_different_lidars_do_not_tell_which_is_cut(tree):
    for place in (0, 4):
        other = rings(place, last_deg=-15.0)[place:]
        paths_of(tree)[place].write_bytes(other.tobytes())
    cut(paths_of(tree)[1], 0.5)
    assert not cut_sweeps(paths_of(tree))
