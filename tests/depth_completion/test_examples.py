import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.augmentation.camera_chain import CameraChainConfig
from sightline.augmentation.sample_changes import ColorJitterConfig, thin_rings
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.depth_completion.examples import (
    AugmentationConfig,
    DepthBatch,
    DepthExamples,
    ExampleConfig,
    make_example,
)
from sightline.depth_completion.methods import starting_depth
from sightline.depth_completion.street_depth import street_depth, to_focal_length
from sightline.depth_completion.truth_shaping import (
    TruthShaping,
    pixel_weights,
    widen_near_surfaces,
)
from sightline.evaluation.held_out_frame import split_rings
from sightline.geometry.projection import sparse_depth_map
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.evaluation.held_out_sweeps import turning_sample
from tests.settings import set_unchecked

ALL_FAULTS = ExampleConfig(
    truth="both",
    filled=True,
    crop_size=(64, 128),
    beams=(64, 32, 16, 8),
    augmentation=AugmentationConfig(
        mirror=True,
        yaw_error_deg=0.3,
        outliers=0.05,
        camera_dropout=0.3,
        lidar_occlusion=0.3,
        color_jitter=ColorJitterConfig(),
        camera=CameraChainConfig(share=1.0),
    ),
)


@pytest.fixture(scope="module")
def sample():
    return open_dataset(PACKAGED_FRAMES, parts={"image", "points", "depth"})[0]


class MemoryDataset:
    """A data set of one sample."""

    def __init__(self, sample):
        self.sample = sample
        self.sample_ids = (sample.sample_id,)

    def __len__(self):
        return 1

    def __getitem__(self, index):
        return self.sample


def example(sample, config, *, seed=0, training=True):
    return make_example(sample, config, np.random.default_rng(seed), training=training)


def same(one, other):
    return one.sample_ids == other.sample_ids and all(
        torch.equal(getattr(one, name), getattr(other, name))
        for name in ("image", "sparse_depth_m", "filled_depth_m", "depth_m")
    )


def test_an_example_depends_on_nothing_but_its_generator(sample):
    assert same(example(sample, ALL_FAULTS, seed=3), example(sample, ALL_FAULTS, seed=3))
    assert not same(example(sample, ALL_FAULTS, seed=3), example(sample, ALL_FAULTS, seed=4))


def test_for_validation_nothing_is_perturbed_and_the_whole_crop_is_seen(sample):
    config = replace(ALL_FAULTS, crop_size=None, beams=(64,), truth="held_out")
    batch = example(sample, config, training=False)
    frame = split_rings(sample)
    inputs = frame.with_beams(64)
    sparse_m = sparse_depth_map(inputs.points, inputs.calibration, inputs.image_size)
    assert torch.equal(batch.sparse_depth_m[0, 0], sparse_m)
    assert torch.equal(batch.filled_depth_m[0, 0], starting_depth(sparse_m).depth_m)
    assert torch.equal(batch.depth_m[0, 0], frame.truth_m)
    assert torch.equal(batch.image[0], inputs.image.float() / 255)


def test_scoring_does_without_what_is_for_training_only(sample):
    bare = replace(ALL_FAULTS, augmentation=AugmentationConfig())
    for seed in range(3):
        batch = example(sample, ALL_FAULTS, seed=seed, training=False)
        assert same(batch, example(sample, bare, seed=seed, training=False))


@pytest.mark.parametrize("seed", range(4))
def test_the_network_never_sees_a_return_that_is_its_truth(sample, seed):
    config = ExampleConfig(truth="held_out")
    batch = example(sample, config, seed=seed)
    both = (batch.sparse_depth_m > 0) & (batch.depth_m > 0)
    # Returns of two rings may fall on one pixel; they are then different returns.
    assert (both & (batch.sparse_depth_m == batch.depth_m)).sum() <= 0.5 * both.sum()
    assert both.sum() < 0.05 * (batch.depth_m > 0).sum()


def test_the_depth_map_stands_beside_the_rings_that_are_held_out(sample):
    batch = example(sample, ExampleConfig(truth="both"), training=False)
    depth_only = example(sample, ExampleConfig(truth="depth"), training=False)
    assert torch.equal(batch.depth_m[0, 0], split_rings(sample).truth_m)
    assert torch.equal(batch.dense_depth_m, depth_only.depth_m)
    assert depth_only.dense_depth_m is None
    top, left = sample.depth.shape[0] - 352, (sample.depth.shape[1] - 1216) // 2
    dense_m = sample.depth[top:, left : left + 1216]
    assert torch.equal(batch.dense_depth_m[0, 0], torch.where(dense_m <= 90, dense_m, 0.0))


@pytest.mark.parametrize(("beams", "keep_every"), [(64, 1), (16, 4)])
def test_beside_a_true_depth_map_no_ring_is_held_out(sample, beams, keep_every):
    batch = example(sample, ExampleConfig(beams=(beams,)), training=False)
    inputs = thin_rings(sample, keep_every)
    sparse_m = sparse_depth_map(inputs.points, inputs.calibration, inputs.image_size)
    height, width = batch.sparse_depth_m.shape[-2:]
    left = (sample.image_size[1] - width) // 2
    assert torch.equal(batch.sparse_depth_m[0, 0], sparse_m[-height:, left : left + width])


def test_truth_above_the_highest_measurement_is_left_out_where_asked_for(sample):
    plain, in_reach = (
        example(sample, ExampleConfig(shaping=TruthShaping(in_reach=each)), training=False)
        for each in (False, True)
    )
    inside = in_reach.depth_m > 0
    assert torch.equal(in_reach.depth_m[inside], plain.depth_m[inside])
    assert inside.sum() < (plain.depth_m > 0).sum()
    top = plain.depth_m.shape[2] // 8
    assert not inside[:, :, :top].any()


def test_truth_is_shaped_for_training_alone(sample):
    shaping = TruthShaping(contours_px=2, thin_weight=0.5, away_weight=0.3, kept_weight=0.0)
    plain = ExampleConfig(filled=True, filling="second")
    shaped = replace(plain, shaping=shaping)
    scored = example(sample, shaped, training=False)
    assert same(scored, example(sample, plain, training=False))
    assert scored.weight is None
    unshaped, batch = example(sample, plain), example(sample, shaped)
    assert torch.equal(
        batch.filled_depth_m[0, 0], starting_depth(batch.sparse_depth_m[0, 0], "second").depth_m
    )
    maps = [
        each[0, 0].numpy()
        for each in (unshaped.depth_m, unshaped.sparse_depth_m, unshaped.filled_depth_m)
    ]
    assert torch.equal(batch.weight[0, 0], torch.from_numpy(pixel_weights(*maps, shaping)))
    assert torch.equal(batch.depth_m[0, 0], torch.from_numpy(widen_near_surfaces(maps[0], shaping)))
    assert (batch.depth_m < unshaped.depth_m).any()


def test_with_fewer_beams_pixels_are_away_from_those_of_all_beams(sample):
    shaping = TruthShaping(away_weight=0.3)
    config = ExampleConfig(filled=True, filling="second", shaping=shaping, beams=(16,))
    assert torch.equal(
        example(sample, config).weight, example(sample, replace(config, beams=(64,))).weight
    )


def test_truth_beyond_the_reach_of_a_sweep_is_left_out(sample):
    batch = example(sample, ExampleConfig(farthest_m=30.0))
    whole = example(sample, ExampleConfig(farthest_m=256.0))
    near = whole.depth_m <= 30
    assert (~near).any()
    assert torch.equal(batch.depth_m, torch.where(near, whole.depth_m, 0.0))


def test_fewer_beams_give_fewer_measurements(sample):
    counts = [
        int((example(sample, ExampleConfig(beams=(beams,))).sparse_depth_m > 0).sum())
        for beams in (64, 32, 16, 8)
    ]
    assert counts == sorted(counts, reverse=True)
    assert counts[-1] < counts[0] / 5


def test_a_mirror_turns_all_maps_alike(sample):
    config = ExampleConfig(truth="both", filled=True, augmentation=AugmentationConfig(mirror=True))
    plain = example(sample, replace(config, augmentation=AugmentationConfig()))
    batches = [example(sample, config, seed=seed) for seed in range(8)]
    mirrored = next(one for one in batches if not torch.equal(one.image, plain.image))
    for name in ("image", "sparse_depth_m", "filled_depth_m", "depth_m", "dense_depth_m"):
        assert torch.equal(getattr(mirrored, name).flip(-1), getattr(plain, name))


def test_a_dropped_camera_is_a_black_image(sample):
    batch = example(sample, ExampleConfig(augmentation=AugmentationConfig(camera_dropout=1.0)))
    assert not batch.image.any()
    assert batch.sparse_depth_m.any()


def test_a_part_of_the_sweep_is_hidden_and_its_truth_stays(sample):
    plain = ExampleConfig(truth="both", filled=True)
    whole = example(sample, plain)
    hidden = example(sample, replace(plain, augmentation=AugmentationConfig(lidar_occlusion=1.0)))
    lost = whole.sparse_depth_m.ne(0) & hidden.sparse_depth_m.eq(0)
    assert lost.sum() > 0.02 * whole.sparse_depth_m.ne(0).sum()
    assert torch.equal(hidden.sparse_depth_m[~lost], whole.sparse_depth_m[~lost])
    assert torch.equal(hidden.depth_m, whole.depth_m)
    assert torch.equal(hidden.dense_depth_m, whole.dense_depth_m)
    assert hidden.filled_depth_m.all()


def test_a_fixed_crop_is_the_bottom_centre(sample):
    config = ExampleConfig(crop_size=(96, 256), augmentation=AugmentationConfig(random_crop=False))
    batch = example(sample, config)
    whole = example(sample, replace(config, crop_size=None))
    assert torch.equal(batch.depth_m, whole.depth_m[..., 256:, 480:736])


def test_the_preparation_asks_for_a_depth_map_where_that_is_the_truth(sample):
    assert "depth" not in DepthExamples(ExampleConfig(truth="held_out")).parts
    preparation = DepthExamples(ExampleConfig(truth="both"))
    assert "depth" in preparation.parts
    example = preparation.prepare(sample, np.random.default_rng(0), training=False)
    assert example.image.shape == (1, 3, 352, 1216)


def test_truth_that_the_data_lacks_is_named(sample):
    with pytest.raises(ValueError, match="has no true depth, but truth is both"):
        example(replace(sample, depth=None), ExampleConfig(truth="both"))
    with pytest.raises(ValueError, match="has no sweep"):
        example(replace(sample, points=None), ExampleConfig())


def test_a_crop_larger_than_the_image_is_refused_with_both_sizes(sample):
    with pytest.raises(ValueError, match=r"crop_size is 400x500 .* the sample's 352x1216"):
        example(sample, ExampleConfig(crop_size=(400, 500)))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"beams": ()}, "beams must be some of 64, 32, 16, 8"),
        ({"beams": (64, 12)}, "beams must be some of"),
        ({"farthest_m": 300.0}, "farthest_m must be above 0 and at most 256"),
        ({"farthest_m": 0.0}, "farthest_m must be above 0"),
        ({"crop_size": (-8, 64)}, r"crop_size must be at least 1 x 1 .* got \(-8, 64\)"),
        ({"augmentation": {"outliers": 1.5}}, "outliers must be from 0 to 1"),
        ({"augmentation": {"lidar_occlusion": -0.1}}, "lidar_occlusion must be from 0 to 1"),
        ({"augmentation": {"yaw_error_deg": -1.0}}, "yaw_error_deg must be from 0 to 90"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, message):
    augmentation, others = wrong.get("augmentation", {}), dict(wrong)
    others.pop("augmentation", None)
    with pytest.raises(ValueError, match=message):
        ExampleConfig(augmentation=AugmentationConfig(**augmentation), **others)


def test_a_truth_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="truth must be one of depth, held_out, both, got 'rings'"):
        set_unchecked(ExampleConfig(), truth="rings")


STREET = ExampleConfig(filled=True, filling="street", focal_px=200.0)


def test_examples_at_another_focal_length_are_of_the_resized_sample(sample):
    batch = example(sample, STREET, training=False)
    small = to_focal_length(sample, 200.0)
    height, width = batch.image.shape[-2:]
    rows, columns = small.image_size[0] - height, (small.image_size[1] - width) // 2
    window = slice(rows, None), slice(columns, columns + width)
    assert (height, width) == (96, 320)  # of 104 x 344, multiples of 32
    assert torch.equal(batch.image[0], small.image[:, *window] / 255)
    assert torch.equal(batch.depth_m[0, 0], small.depth[window].where(small.depth[window] <= 90, 0))
    torch.testing.assert_close(batch.filled_depth_m[0, 0], street_depth(small)[window])


def test_images_smaller_than_the_crop_are_padded_as_in_use(sample):
    config = replace(STREET, crop_size=(128, 384))
    batch, whole = (example(sample, each, training=False) for each in (config, STREET))
    height, width = whole.image.shape[-2:]
    assert batch.image.shape[-2:] == (128, 384)
    for name in ("image", "sparse_depth_m", "filled_depth_m", "depth_m"):
        given, padded = getattr(whole, name), getattr(batch, name)
        assert torch.equal(padded[..., -height:, :width], given)
    assert not batch.depth_m[..., :-height, :].any()
    assert not batch.sparse_depth_m[..., width:].any()
    assert torch.equal(batch.image[..., 0, 0], whole.image[..., 0, 0])
    assert torch.equal(batch.image[..., -1, -1], whole.image[..., -1, -1])


@pytest.mark.parametrize(
    ("augmentation", "least", "most"),
    [
        (AugmentationConfig(lidar_dropout=1.0), 0.0, 0.0),
        (AugmentationConfig(lidar_sector=1.0), 0.1, 0.95),
    ],
    ids=["no returns", "a wedge lost"],
)
def test_examples_may_lack_returns_but_not_their_truth(sample, augmentation, least, most):
    plain = example(sample, replace(STREET, augmentation=AugmentationConfig()), training=True)
    batch = example(sample, replace(STREET, augmentation=augmentation), training=True)
    share = float((batch.sparse_depth_m > 0).sum() / (plain.sparse_depth_m > 0).sum())
    assert least <= share <= most
    assert torch.equal(batch.depth_m, plain.depth_m)


def test_maps_of_another_size_than_the_image_are_refused():
    maps = {"sparse_depth_m": torch.ones(2, 1, 4, 6), "depth_m": torch.ones(2, 1, 4, 7)}
    with pytest.raises(TypeError):
        DepthBatch(sample_ids=("a", "b"), image=torch.zeros(2, 3, 4, 6), **maps)


def test_training_data_without_a_true_depth_in_reach_is_refused(tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(PACKAGED_FRAMES, tree)
    examples = DepthExamples()
    dataset = open_dataset(tree, parts=examples.parts)
    rng = np.random.default_rng(0)
    assert examples.for_training([dataset], rng) is examples
    maps = sorted((tree / "training/depth").iterdir())
    for path in maps[:-1]:
        write_depth_png(path, np.zeros(dataset[0].image_size, np.float32))
    assert examples.for_training([dataset], rng) is examples  # one is enough
    write_depth_png(maps[-1], np.full(dataset[0].image_size, 200, np.float32))
    with pytest.raises(ValueError, match=f"of {len(maps)} training frames, {maps[0].stem} to"):
        examples.for_training([dataset], rng)
    held_out = DepthExamples(ExampleConfig(truth="held_out"))
    assert held_out.for_training([dataset], rng) is held_out


def test_of_a_lidar_with_16_beams_densities_that_fit_are_drawn(capsys):
    whole = turning_sample(16, image_size=(96, 128), step=0.06)
    config = ExampleConfig(truth="held_out", beams=(64, 32, 16, 8))
    for seed in range(8):
        example(whole, config, seed=seed)
    rng = np.random.default_rng(0)
    datasets = [MemoryDataset(whole), MemoryDataset(whole)]
    DepthExamples(config).for_training(datasets, rng)
    told = capsys.readouterr().err
    assert told.count("the LiDAR has 16 beams (sample turn)") == 1
    assert told.endswith("beams 64, 32, 16, 8 only 16, 8 are drawn, which divide them\n")
    dense = replace(config, beams=(64, 32))
    message = r"turn: none of the beams 64, 32 divides the 16 .*settings\.beams '\[16, 8\]'$"
    for refused in (
        lambda: example(whole, dense),
        lambda: DepthExamples(dense).for_training(datasets, rng),
    ):
        with pytest.raises(ValueError, match=message):
            refused()
