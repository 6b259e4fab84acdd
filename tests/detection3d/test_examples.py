"""Examples made of frames: what is to be found, what is ignored, exact batches."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.detection3d.examples import (
    Detection3DExampleConfig,
    Detection3DExamples,
    SceneChangeConfig,
)
from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig, make_truth
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.transforms import rotation_about_axes
from sightline.structures.batch import concatenate
from tests.detection3d.frames import NAMES, SWEEP, simulated_frames

SETTINGS = Detection3DExampleConfig(input=SWEEP, class_names=NAMES)


@pytest.fixture(scope="module")
def frames():
    return simulated_frames()


def example(sample, settings=SETTINGS, *, seed=0, training=True):
    rng = np.random.default_rng(seed)
    return Detection3DExamples(settings).prepare(sample, rng, training=training)


def test_an_example_has_so_many_points_and_its_objects_hold_some(frames):
    for seed in range(3):
        batch = example(frames[0], seed=seed)
        assert batch.points[0].shape == (SWEEP.num_points, 4)
        truth = batch.truths[0]
        assert len(truth.boxes)
        assert batch.frames is None


def test_a_batch_holds_its_samples_one_after_the_other(frames):
    batch = concatenate([example(each) for each in frames])
    assert batch.sample_ids == ("000000", "000001")
    alone = example(frames[1])
    assert torch.equal(batch.points[1], alone.points[0])
    assert torch.equal(batch.truths[1].boxes, alone.truths[0].boxes)
    moved = batch.to("cpu")
    assert torch.equal(moved.points[0], batch.points[0])


def test_scoring_takes_the_frame_as_it_is_with_all_labels(frames):
    batch = example(frames[0], training=False)
    frame = batch.frames[0]
    assert frame.objects.class_names == frames[0].objects.class_names
    expected = batch.truths[0].boxes
    labelled = frames[0].objects.boxes3d.tensor
    assert all((labelled == box).all(dim=1).any() for box in expected)


def test_each_draw_is_another_and_each_seed_the_same(frames):
    first, again, other = (example(frames[0], seed=seed) for seed in (1, 1, 2))
    assert torch.equal(first.points[0], again.points[0])
    assert first.seeds == again.seeds
    assert not torch.equal(first.points[0], other.points[0])


def test_the_height_offset_moves_points_and_boxes_alike(frames):
    config = replace(SETTINGS, changes=None)
    high = replace(config, input=replace(SWEEP, height_offset_m=0.25))
    plain, raised = (example(frames[0], each) for each in (config, high))
    torch.testing.assert_close(raised.truths[0].boxes[:, 2], plain.truths[0].boxes[:, 2] + 0.25)


@pytest.mark.parametrize("training", [True, False])
def test_a_higher_lidar_is_learned_from_and_scored_as_it_is_detected_in(frames, training):
    sample, calibration = frames[0], frames[0].calibration
    exact = (sample.points * 1024).round() / 1024  # so that no digit is lost on the way
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = 0.5
    boxes = sample.objects.boxes3d.tensor
    higher = replace(
        sample,
        points=exact - exact.new_tensor([0, 0, 0.5, 0]),
        objects=replace(
            sample.objects, boxes3d=Boxes3D(boxes - boxes.new_tensor([0, 0, 0.5, 0, 0, 0, 0]))
        ),
        calibration=replace(
            calibration, camera_from_lidar=calibration.camera_from_lidar @ old_from_new
        ),
        lidar_height_m=KITTI_LIDAR_HEIGHT_M + 0.5,
    )
    settings = replace(SETTINGS, changes=None)
    expected, given = (
        example(each, settings, training=training)
        for each in (replace(sample, points=exact), higher)
    )
    torch.testing.assert_close(given.points[0], expected.points[0])
    torch.testing.assert_close(given.truths[0].boxes, expected.truths[0].boxes)
    if not training:
        frame, as_kitti = given.frames[0], expected.frames[0]
        np.testing.assert_allclose(frame.objects.locations, as_kitti.objects.locations, atol=1e-6)
        torch.testing.assert_close(
            frame.calibration.camera_from_lidar, calibration.camera_from_lidar
        )


def shuffled(sample):
    order = torch.from_numpy(np.random.default_rng(0).permutation(len(sample.points)))
    return replace(sample, points=sample.points[order])


def test_the_rings_of_a_high_or_tilted_lidar_are_found_in_any_order_of_its_points(frames):
    few = replace(SETTINGS, changes=SceneChangeConfig(mirror=False, turn_deg=0.0, beams=(16,)))
    few = replace(few, input=replace(SWEEP, num_points=None))
    expected = len(example(shuffled(frames[0]), few).points[0])
    high = replace(shuffled(frames[0]), lidar_height_m=KITTI_LIDAR_HEIGHT_M + 0.6)
    tilt = torch.eye(4, dtype=torch.float64)
    tilt[:3, :3] = rotation_about_axes(0.0, 4.0, 0.0)
    tilted = replace(shuffled(frames[0]), level_from_lidar=tilt)
    for each in (high, tilted):
        kept = len(example(each, few).points[0])
        assert 0.8 < kept / expected < 1.2


def test_rings_that_are_not_found_name_the_setting(frames):
    few = replace(SETTINGS, changes=SceneChangeConfig(beams=(16,)))
    cube = torch.rand(2000, 4, generator=torch.Generator().manual_seed(0))
    points = cube * cube.new_tensor([20, 20, 4, 1]) - cube.new_tensor([0, 10, 2, 0])
    settings = r"init_args\.settings\.changes\.beams '\[64\]'\)$"
    with pytest.raises(ValueError, match=f"000000: .*{settings}"):
        example(replace(frames[0], points=points), few)


def truth_of(sample, points, **settings):
    return make_truth(sample.objects, points, ("Car",), SweepConfig(), SweepTruthConfig(**settings))


def test_objects_without_points_or_that_look_like_ours_are_ignored(frames):
    sample = frames[0]
    objects = sample.objects
    place = objects.class_names.index("Car")
    box = objects.boxes3d.tensor[place]
    inside = torch.cat((box[:3].float(), torch.zeros(1)))[None]
    found = truth_of(sample, inside)
    cars = [name for name in objects.class_names if name in ("Car", "Van", "Truck")]
    assert torch.equal(found.boxes, box[None])
    assert len(found.ignored_boxes) == len(cars) - 1
    assert found.classes.tolist() == [0]
    assert not len(truth_of(sample, inside, min_points=2).boxes)
    van = replace(objects, class_names=tuple(
        "Van" if index == place else name for index, name in enumerate(objects.class_names)
    ))  # fmt: skip
    seen_as_van = truth_of(replace(sample, objects=van), inside)
    assert not len(seen_as_van.boxes)
    assert len(seen_as_van.ignored_boxes) == len(cars)
    as_background = truth_of(replace(sample, objects=van), inside, ignored_names=())
    assert len(as_background.ignored_boxes) < len(cars)


def test_a_learned_class_is_ignored_for_itself_though_it_looks_like_another(frames):
    names = tuple("Van" if each == "Car" else each for each in frames[0].objects.class_names)
    objects = replace(frames[0].objects, class_names=names)
    config = SweepTruthConfig(min_points=10_000)
    truth = make_truth(objects, frames[0].points, ("Car", "Van"), SweepConfig(), config)
    assert not len(truth.boxes)
    num_vans = sum(name == "Van" for name in names)
    assert truth.ignored_classes[:, 1].sum() == num_vans
    assert truth.ignored_classes[:, 0].sum() == sum(name == "Truck" for name in names)


def test_a_frame_without_labels_and_a_cache_with_changes_are_refused(frames, tmp_path):
    with pytest.raises(ValueError, match="000000 has no labels"):
        example(replace(frames[0], objects=None))
    with pytest.raises(ValueError, match=r"set settings\.changes to null"):
        Detection3DExamples(replace(SETTINGS, changes=SceneChangeConfig()), cache=tmp_path)


def test_a_sweep_of_which_nothing_is_seen_is_an_example_without_points(frames):
    batch = example(replace(frames[0], points=frames[0].points[:0]))
    assert batch.points[0].shape == (0, 4)
    assert not len(batch.truths[0].boxes)
