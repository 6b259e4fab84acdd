from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from sightline.augmentation.camera_chain import CameraChainConfig
from sightline.augmentation.faults import FewerRings, NoCamera
from sightline.augmentation.sample_changes import ColorJitterConfig, mirror
from sightline.corruptions.drawing import CorruptionSampler
from sightline.data.open import open_dataset
from sightline.detection2d.config import Detection2DConfig, InputConfig
from sightline.detection2d.examples import (
    DetectionExamples,
    ExampleConfig,
    ViewConfig,
    min_iou_crop,
    scaled_crop,
)
from sightline.detection2d.loss import CELL_PX
from sightline.detection2d.placement import lidar_image
from sightline.detection2d.targets import TargetConfig
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.batch import concatenate
from tests.detection2d.frames import SIZE, painted_frame, whole_frames

ANY_SIZE = InputConfig(size=None)
CROPS = ExampleConfig(
    input=ANY_SIZE,
    pad_to=32,
    crop_size=(256, 320),
    view=ViewConfig(scales=(0.5, 1.5)),
    color_jitter=ColorJitterConfig(),
)
PLAIN = ViewConfig(mirror=False)


@pytest.fixture(scope="module")
def sample():
    return open_dataset(PACKAGED_FRAMES, parts={"image", "points", "objects"})[0]


def example(sample, settings, *, seed=0, training=True, faults=()):
    examples = DetectionExamples(settings, faults)
    return examples.prepare(sample, np.random.default_rng(seed), training=training)


def test_a_training_example_shows_objects_where_their_boxes_say(sample):
    """A car's box holds nearer points than what is around it, whatever view was drawn."""
    settings = replace(CROPS, targets=TargetConfig(min_height_px=40.0, max_occlusion=0))
    seen = 0
    for seed in range(12):
        batch = example(sample, settings, seed=seed)
        assert batch.image.shape == batch.lidar.shape == (1, 3, 256, 320)
        for box in batch.targets[0].boxes.long().tolist():
            depth = batch.lidar[0, 0]
            inside = depth[box[1] : box[3], box[0] : box[2]]
            above = depth[max(box[1] - 40, 0) : box[1], box[0] : box[2]]
            if (inside > 0).sum() > 30 and (above > 0).sum() > 30:
                assert inside[inside > 0].median() > above[above > 0].median()
                seen += 1
    assert seen > 5


def test_the_whole_frame_is_stretched_to_the_networks_input(sample):
    size = (200, 500)
    settings = whole_frames(size, view=PLAIN, targets=TargetConfig())
    batch = example(sample, settings)
    assert batch.image.shape == (1, 3, *size)
    car = sample.objects.boxes2d.tensor[0].float()
    scales = torch.tensor([500 / 1242, 200 / 375] * 2)
    torch.testing.assert_close(batch.targets[0].boxes[0], (car + 0.5) * scales - 0.5)


@pytest.mark.parametrize("settings", [CROPS, whole_frames((64, 96))])
def test_an_example_depends_on_its_generator_alone(sample, settings):
    settings = replace(settings, cases=CorruptionSampler(), camera=CameraChainConfig())
    first, again, other = (example(sample, settings, seed=s) for s in (3, 3, 4))
    assert torch.equal(first.image, again.image)
    assert torch.equal(first.lidar, again.lidar)
    assert torch.equal(first.targets[0].boxes, again.targets[0].boxes)
    assert not torch.equal(first.lidar, other.lidar)


def test_mirrored_views_come_as_often_as_not(sample):
    settings = whole_frames((64, 96))
    plain, turned = (lidar_image_of(each, settings) for each in (sample, mirror(sample)))
    found = [example(sample, settings, seed=seed).lidar[0] for seed in range(20)]
    mirrored = [torch.equal(each, turned) for each in found]
    assert all(
        torch.equal(each, plain)
        for each, is_turned in zip(found, mirrored, strict=True)
        if not is_turned
    )
    assert 4 < sum(mirrored) < 16


def lidar_image_of(sample, settings):
    return example(sample, replace(settings, view=PLAIN)).lidar[0]


def test_scoring_shows_the_whole_frame_as_it_is_with_all_its_labels(sample):
    batch = example(sample, CROPS, training=False, faults=(NoCamera(),))
    assert batch.image.shape == (1, 3, 384, 1248)
    torch.testing.assert_close(batch.image[0, :, :375, :1242], sample.image / 255)
    assert not batch.image[0, :, 375:].any()
    (frame,) = batch.frames
    assert frame.objects.class_names == sample.objects.class_names
    np.testing.assert_allclose(frame.objects.boxes2d, sample.objects.boxes2d.tensor)
    boxes = batch.targets[0].boxes
    torch.testing.assert_close(frame.placement.to_image(boxes), boxes)


def only(case):
    return CorruptionSampler(probabilities={case: 1.0})


def test_cases_come_as_often_as_is_said(sample):
    shares = {"clean": 0.4, "lidar_blank": 0.3, "camera_blank": 0.3}
    settings = replace(CROPS, health=True, cases=CorruptionSampler(probabilities=shares))
    found = [example(sample, settings, seed=seed) for seed in range(40)]
    no_lidar = [batch for batch in found if not batch.lidar.any()]
    no_camera = [batch for batch in found if not batch.image.any()]
    assert 5 < len(no_lidar) < 20
    assert 5 < len(no_camera) < 20
    for batch in found:
        assert bool(batch.lidar.any()) == bool(batch.lidar_health.nansum() > 0)
        assert bool(batch.image.any()) == bool(batch.camera_health.nansum() > 0)


@pytest.mark.parametrize("settings", [CROPS, whole_frames((96, 200))])
@pytest.mark.parametrize(("sensor", "image"), [("camera", "image"), ("lidar", "lidar")])
def test_gates_are_told_where_a_box_is_in_each_view(sample, settings, sensor, image):
    cases = only(f"{sensor}_occlusion")
    settings = replace(settings, health=True, color_jitter=None, cases=cases)
    seen = 0
    for seed in range(10):
        batch = example(sample, settings, seed=seed)
        health = getattr(batch, f"{sensor}_health")
        other = getattr(batch, f"{'lidar' if sensor == 'camera' else 'camera'}_health")
        assert (other.nan_to_num(1) == 1).all()
        levels = F.max_pool2d(getattr(batch, image), CELL_PX, ceil_mode=True).amax(1, keepdim=True)
        assert not levels[is_inside_fault(health)].any()
        if sensor == "camera":
            assert levels[health == 1].bool().float().mean() > 0.99
        seen += bool(is_inside_fault(health).any())
    assert seen > 5


def is_inside_fault(health):
    """Cells that are broken, with all their neighbours: scaled views have blurred edges."""
    return F.max_pool2d(health.nan_to_num(1), 3, stride=1, padding=1) == 0


def test_gates_are_not_told_of_what_is_only_disturbed(sample):
    batch = example(sample, replace(CROPS, health=True, cases=only("camera_noise")))
    assert batch.camera_health.isnan().all()
    assert (batch.lidar_health.nan_to_num(1) == 1).all()


def test_gates_are_told_of_a_camera_that_was_never_there(sample):
    settings = replace(CROPS, health=True, fault_share=1.0, cases=only("lidar_blank"))
    batch = example(sample, settings, faults=(NoCamera(),))
    assert (batch.camera_health == 0).all()
    assert (batch.lidar_health.nan_to_num(0) == 0).all()
    assert (batch.lidar_health == 0).any()


def test_a_case_may_be_the_same_for_all_samples_of_an_update(sample):
    shares = {"clean": 0.4, "lidar_blank": 0.3, "camera_blank": 0.3}
    cases = CorruptionSampler(probabilities=shares, per="update")
    examples = DetectionExamples(replace(CROPS, cases=cases, color_jitter=None))
    kinds = set()
    for seed in range(12):
        shared = examples.for_update(np.random.default_rng(seed))
        batches = [
            shared.prepare(sample, np.random.default_rng(each), training=True) for each in range(3)
        ]
        (seen,) = {(bool(each.image.any()), bool(each.lidar.any())) for each in batches}
        kinds.add(seen)
    assert kinds == {(True, True), (True, False), (False, True)}


def test_a_black_image_stays_black_whatever_becomes_of_its_colours(sample):
    settings = replace(CROPS, camera=CameraChainConfig(share=1.0), cases=only("camera_blank"))
    assert not example(sample, settings).image.any()
    boxed = replace(settings, cases=only("camera_occlusion"), health=True)
    batches = [example(sample, boxed, seed=seed) for seed in range(5)]
    hidden = [is_inside_fault(each.camera_health) for each in batches]
    assert any(where.any() for where in hidden)
    for where, each in zip(hidden, batches, strict=True):
        levels = F.max_pool2d(each.image, CELL_PX).amax(1, keepdim=True)
        assert not levels[where].any()


def test_a_fault_that_goes_by_the_order_of_points_works_in_mirrored_views_too(sample):
    settings = replace(CROPS, fault_share=1.0)
    for seed in range(4):
        few = example(sample, settings, seed=seed, faults=(FewerRings(keep_every=4),))
        all_ = example(sample, settings, seed=seed, faults=(FewerRings(keep_every=1),))
        assert (few.lidar > 0).sum() < 0.5 * (all_.lidar > 0).sum()


def test_examples_of_one_crop_size_make_a_batch(sample):
    batch = concatenate([example(sample, CROPS, seed=seed) for seed in range(2)])
    assert batch.image.shape == (2, 3, 256, 320)
    assert len(batch.targets) == 2


def test_a_patch_overlaps_an_object_or_is_the_whole_frame(sample):
    wholes = 0
    for seed in range(30):
        patch = min_iou_crop(sample, np.random.default_rng(seed))
        wholes += patch is sample
        height, width = patch.image_size
        assert height >= 0.29 * 375
        assert width >= 0.29 * 1242
        assert 0.49 < (height / 375) / (width / 1242) < 2.05
    assert 2 < wholes < 28


def test_a_crop_of_a_small_image_is_as_large_as_the_image_allows(sample):
    view = ViewConfig(scales=(0.5, 0.5))
    part = scaled_crop(sample, (384, 640), 1.0, view, np.random.default_rng(0))
    assert part.image_size == (188, 621)


def test_crops_that_are_aimed_show_an_object(sample):
    view = ViewConfig(object_share=1.0)
    whole = Boxes2D(torch.tensor([[0.0, 0.0, 199.0, 199.0]], dtype=torch.float64))
    for seed in range(10):
        part = scaled_crop(sample, (200, 200), 1.0, view, np.random.default_rng(seed))
        named = part.objects.select(part.objects.has_box3d)
        assert pairwise_iou2d(whole, named.boxes2d).sum() > 0


def test_crops_are_aimed_at_each_class_as_often():
    """A cyclist beside 19 cars is in half of the crops, though each crop shows one place only."""
    right, bottom = SIZE[1] - 1, SIZE[0] - 1
    rows = [("Car", 0, 0, 9, 9)] * 19 + [("Cyclist", right - 9, bottom - 9, right, bottom)]
    crowd = painted_frame(0, rows=rows)
    view = ViewConfig(object_share=1.0)
    class_names = [
        scaled_crop(crowd, (64, 64), 1.0, view, np.random.default_rng(seed)).objects.class_names
        for seed in range(60)
    ]
    assert {"Cyclist" in names for names in class_names} == {
        "Car" not in names for names in class_names
    }
    assert 15 < sum("Cyclist" in names for names in class_names) < 45


def test_the_lidars_image_is_near_and_low_where_it_is_bright(sample):
    image = lidar_image(sample, InputConfig())
    assert ((image >= 0) & (image <= 1)).all()
    rows = [band[band > 0].median() for band in (image[0, 300:], image[0, :175])]
    assert rows[0] > rows[1]
    literal = lidar_image(sample, InputConfig(height_offset_m=0.0))
    assert (literal[1] >= image[1]).all()
    assert not lidar_image(replace(sample, points=None), InputConfig()).any()


def test_the_lidars_image_shows_heights_above_the_road_wherever_the_lidar_sits(sample):
    exact = (sample.points * 1024).round() / 1024  # so that no digit is lost on the way
    image = lidar_image(replace(sample, points=exact), InputConfig())
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = 0.5
    calibration = sample.calibration
    higher = replace(
        sample,
        points=exact - exact.new_tensor([0, 0, 0.5, 0]),
        calibration=replace(
            calibration, camera_from_lidar=calibration.camera_from_lidar @ old_from_new
        ),
        lidar_height_m=KITTI_LIDAR_HEIGHT_M + 0.5,
    )
    differs = (lidar_image(higher, InputConfig()) - image).abs() > 1e-5
    assert differs.float().mean() < 1e-4  # a point on the border of two pixels may fall into either
    untold = lidar_image(replace(higher, lidar_height_m=None), InputConfig())
    assert (untold[1] - image[1]).max() > 0.05


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"crop_size": (64, 64), "view": ViewConfig(min_iou_crop=True)}, "set crop_size to null"),
        ({"fault_share": 1.5}, "fault_share must be from 0 to 1, got 1.5"),
    ],
)
def test_settings_that_do_not_belong_together_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        ExampleConfig(**settings)


def test_examples_take_the_network_s_input_and_refuse_another(sample):
    network = Detection2DConfig(input=InputConfig(size=(64, 96)))
    taken = DetectionExamples(ExampleConfig(crop_size=None)).for_network(network)
    assert taken.for_network(network).settings == taken.settings
    batch = taken.prepare(sample, np.random.default_rng(0), training=False)
    assert batch.image.shape[2:] == (64, 96)
    with pytest.raises(ValueError, match=r"settings\.input is .*, expected the network's .*leave"):
        taken.for_network(replace(network, input=InputConfig(size=(64, 64))))
    any_size = Detection2DConfig(input=InputConfig(size=None))
    with pytest.raises(ValueError, match="frames of any size make no batches"):
        DetectionExamples(ExampleConfig(crop_size=None)).for_network(any_size)


def test_a_sample_without_labels_or_with_points_that_are_not_finite_is_refused(sample):
    with pytest.raises(ValueError, match="000000 has no labels"):
        example(replace(sample, objects=None), CROPS)
    points = sample.points.clone()
    points[0, 3] = torch.inf
    with pytest.raises(ValueError, match="000000 holds 1 points with NaN or infinite"):
        example(replace(sample, points=points), CROPS)
