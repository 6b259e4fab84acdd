from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.open import open_dataset
from sightline.training.data import PreparedSamples
from sightline.training.sampling import ScoringBatches, TrainingBatches
from sightline.training.sources import SourceConfig
from tests.data import trees
from tests.data.recordings import write_recording
from tests.training import toy

sizes = st.fixed_dictionaries(
    {
        "num_samples": st.integers(1, 40),
        "batch_size": st.integers(1, 4),
        "world": st.integers(1, 4),
        "seed": st.integers(0, 3),
        "epoch": st.integers(0, 3),
    }
)


def epoch_of(rank, sizes, first=0):
    batches = TrainingBatches(
        sizes["num_samples"],
        sizes["batch_size"],
        seed=sizes["seed"],
        rank=rank,
        world=sizes["world"],
    )
    batches.start_at(sizes["epoch"], first)
    return list(batches)


@given(sizes=sizes.filter(lambda s: s["num_samples"] >= s["batch_size"] * s["world"]))
def test_the_ranks_together_make_the_batches_of_one_device(sizes):
    ranks = [epoch_of(rank, sizes) for rank in range(sizes["world"])]
    single = epoch_of(0, sizes | {"world": 1, "batch_size": sizes["batch_size"] * sizes["world"]})
    assert len({len(batches) for batches in ranks}) == 1
    together = [
        sorted(key for batch in batches for key in batch) for batches in zip(*ranks, strict=True)
    ]
    assert together == [sorted(batch) for batch in single]


@given(sizes=sizes.filter(lambda s: s["num_samples"] >= s["batch_size"] * s["world"]))
def test_an_epoch_holds_no_sample_twice_and_leaves_out_less_than_a_batch(sizes):
    keys = [
        key for rank in range(sizes["world"]) for batch in epoch_of(rank, sizes) for key in batch
    ]
    assert len(set(keys)) == len(keys)
    assert sizes["num_samples"] - len(keys) < sizes["batch_size"] * sizes["world"]
    assert all(epoch == sizes["epoch"] for epoch, _ in keys)
    assert all(0 <= index < sizes["num_samples"] for _, index in keys)


@given(
    sizes=sizes.filter(lambda s: s["num_samples"] >= s["batch_size"] * s["world"]), data=st.data()
)
def test_an_epoch_that_begins_later_is_the_rest_of_it(sizes, data):
    whole = epoch_of(0, sizes)
    first = data.draw(st.integers(0, len(whole)))
    assert epoch_of(0, sizes, first) == whole[first:]


def test_another_epoch_and_another_seed_give_another_order():
    sizes = {"num_samples": 40, "batch_size": 4, "world": 1, "seed": 0, "epoch": 0}
    orders = [
        [index for batch in epoch_of(0, sizes | change) for _, index in batch]
        for change in ({}, {"epoch": 1}, {"seed": 1})
    ]
    assert orders[0] != orders[1]
    assert orders[0] != orders[2]


def test_a_shorter_epoch_takes_other_samples_each_time():
    batches = TrainingBatches(40, 4, seed=0, samples_per_epoch=8)
    assert len(batches) == 2
    seen = []
    for epoch in range(2):
        batches.start_at(epoch, 0)
        seen.append({index for batch in batches for _, index in batch})
    assert len(seen[0]) == len(seen[1]) == 8
    assert seen[0] != seen[1]


@given(num_samples=st.integers(1, 20), batch_size=st.integers(1, 4), world=st.integers(1, 4))
def test_scoring_takes_every_sample_once_and_gives_each_rank_the_same_number_of_batches(
    num_samples, batch_size, world
):
    ranks = [
        ScoringBatches(num_samples, batch_size, rank=rank, world=world) for rank in range(world)
    ]
    dealt = [[index for batch in rank for _, index in batch] for rank in ranks]
    assert len({len(rank) for rank in ranks}) == 1
    assert all(len(list(rank)) == len(rank) for rank in ranks)
    assert all(len(batch) <= batch_size for rank in ranks for batch in rank)
    assert sorted(index for indices in dealt for index in indices) == list(range(num_samples))


def test_what_is_drawn_for_a_sample_depends_on_seed_epoch_and_sample_alone(frames):
    def images(workers, seed=0, **settings):
        loader = toy.data(frames, workers=workers, seed=seed, **settings).train_dataloader()
        return {
            name: image
            for batch in loader
            for name, image in zip(batch.sample_ids, batch.image, strict=True)
        }

    plain, with_workers, larger = images(0), images(2), images(0, batch_size=4)
    assert plain.keys() == with_workers.keys()
    assert all(plain[name].equal(with_workers[name]) for name in plain)
    assert all(plain[name].equal(larger[name]) for name in larger)
    other = images(0, seed=1)
    shared = plain.keys() & other.keys()
    assert shared
    assert not any(plain[name].equal(other[name]) for name in shared)


@pytest.mark.filterwarnings("ignore:.*are empty in the checked frames")
def test_sources_of_every_kind_mix_and_repeats_weigh_them(tmp_path):
    trees.write_object_tree(tmp_path / "object", "000003", "000007")
    trees.write_drive(tmp_path / "drive", 1)
    depth = trees.write_selection(tmp_path / "depth")
    sources = (
        SourceConfig(path=Path("object"), repeat=2),
        SourceConfig(path=tmp_path / "drive"),
        SourceConfig(path=Path("depth")),
    )
    loader = toy.data(tmp_path, training=sources, batch_size=1).train_dataloader()
    seen = [name for batch in loader for name in batch.sample_ids]
    assert sorted(seen) == sorted(["000003", "000003", "000007", "000007", "0000000000", depth])


@pytest.mark.parametrize("is_absolute", [False, True])
@pytest.mark.parametrize("split", ["", "training"])
def test_no_frame_is_both_trained_and_validated_on_however_its_folder_is_named(
    frames, split, is_absolute
):
    base = frames if is_absolute else Path()
    trained = SourceConfig(path=Path(), sample_list="train")
    validated = SourceConfig(path=base / split, sample_list="val")
    data = toy.data(frames, training=(trained,), validation=(validated,), batch_size=1)
    names = [
        {name for batch in loader for name in batch.sample_ids}
        for loader in (data.train_dataloader(), data.val_dataloader())
    ]
    assert [len(each) for each in names] == [8, 1]
    assert names[0].isdisjoint(names[1])


def test_a_doubt_about_data_that_are_used_twice_is_told_once(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"), lidar_height_m=2.31)
    source = SourceConfig(path=tmp_path)
    data = toy.data(tmp_path, training=(source,), validation=(source,), test=(source,))
    with pytest.warns(UserWarning, match=r"lidar_height_m is 2.31") as told:
        loaders = (data.train_dataloader(), data.val_dataloader(), data.test_dataloader())
    assert len(loaders) == 3
    assert len(told) == 1


def test_repeats_do_not_count_outside_of_training(frames):
    source = SourceConfig(path=Path(), repeat=3)
    data = toy.data(frames, validation=(source,), test=(source,))
    for loader in (data.val_dataloader(), data.test_dataloader()):
        assert [name for batch in loader for name in batch.sample_ids] == [
            f"{number:06}" for number in range(9)
        ]


def test_nothing_is_drawn_outside_of_training(frames):
    first, second = (
        next(iter(toy.data(frames, seed=seed, test=(SourceConfig(path=Path()),)).test_dataloader()))
        for seed in (0, 1)
    )
    assert first.image.equal(second.image)


def test_an_epoch_draws_nothing_from_the_global_generators(frames):
    # Python's own is left out: beartype draws from it which element of a tuple to check.
    numpy_state = np.random.get_state()[1].tolist()  # noqa: NPY002
    torch_state = torch.get_rng_state()
    for workers in (0, 1):
        assert list(toy.data(frames, workers=workers).train_dataloader())
    assert np.random.get_state()[1].tolist() == numpy_state  # noqa: NPY002
    assert torch.equal(torch.get_rng_state(), torch_state)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"samples_per_epoch": 0}, "samples_per_epoch must be at least 1"),
        ({"workers": -1}, "workers must be at least 0, got -1: set --data.init_args.workers"),
    ],
)
def test_settings_out_of_range_are_refused(frames, settings, expected):
    with pytest.raises(ValueError, match=expected):
        toy.data(frames, **settings)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"batch_size": 10}, "an epoch of 9 samples does not fill a batch of 10; set a smaller"),
        ({"samples_per_epoch": 10}, "only 9 training samples"),
        ({"training": ()}, r"set --data\.init_args\.training"),
        ({"training": (SourceConfig(path=Path("gone")),)}, "gone: does not exist"),
    ],
)
def test_data_that_does_not_suffice_is_refused(frames, settings, expected):
    with pytest.raises(ValueError, match=expected):
        toy.data(frames, **settings).train_dataloader()
    before_any_validation = toy.data(frames, **settings)
    before_any_validation.trainer = SimpleNamespace(
        global_rank=0, world_size=1, limit_val_batches=1.0
    )
    with pytest.raises(ValueError, match=expected):
        before_any_validation.setup("fit")


def test_a_source_that_never_comes_is_refused():
    with pytest.raises(ValueError, match="repeat must be at least 1, got 0"):
        SourceConfig(path=Path(), repeat=0)


def test_what_a_batch_shares_is_drawn_for_training_batches_only(frames):
    drawn_numbers = []

    class Sharing(toy.ToyPreparation):
        def __init__(self, number=-1):
            super().__init__()
            self.number = number

        def for_update(self, rng):
            return Sharing(int(rng.integers(1_000_000)))

        def collate(self, prepared):
            drawn_numbers.append(self.number)
            return super().collate(prepared)

    def numbers(*, training):
        dataset = open_dataset(frames)
        samples = PreparedSamples([(dataset, 1)], Sharing(), seed=0, training=training)
        keys = ([(0, 0), (0, 1)], [(0, 1), (0, 0)], [(1, 0), (1, 1)])
        drawn_numbers.clear()
        for each in keys:
            samples.__getitems__(each)
        return list(drawn_numbers)

    drawn = numbers(training=True)
    assert len(set(drawn)) == 3
    assert drawn == numbers(training=True)
    assert numbers(training=False) == [-1, -1, -1]
