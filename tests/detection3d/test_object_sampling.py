"""Pasted road users: where they stand, what they hide, and what their labels say."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.object_sampling import (
    BankedObject,
    ObjectBank,
    ObjectSamplingConfig,
    collect_objects,
    paste_objects,
    visible_together,
)
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle
from sightline.structures.labels import ObjectLabels
from tests.data.scenes import sample_of
from tests.detection3d.scenes import box_surface, sweep_of
from tests.geometry.cameras import kitti_like_calibration
from tests.reference import compact3d as reference

CAR_BOX = [8.1, 2.3, -1.0, 4.1, 1.7, 1.5, 0.4]
degree = st.integers(-6, 6).map(lambda step: math.radians(0.125 * step + 0.01))
point = st.tuples(st.sampled_from([5.0, 5.9, 6.1, 9.0]), degree, degree)


def place(entry):
    distance, azimuth, elevation = entry
    return (
        distance * math.cos(azimuth),
        distance * math.sin(azimuth),
        distance * math.tan(elevation),
    )


@given(scene=st.lists(point, max_size=12), pasted=st.lists(point, max_size=6))
def test_points_hide_each_other_as_looking_at_every_pair_says(scene, pasted):
    clouds = [[place(entry) for entry in cloud] for cloud in (scene, pasted)]
    tensors = [torch.tensor(cloud, dtype=torch.float64).reshape(-1, 3) for cloud in clouds]
    seen = visible_together(*tensors, slack_m=1.0)
    expected = reference.visible_together(*clouds, 1.0)
    assert (seen.scene.tolist(), seen.pasted.tolist()) == expected


def street():
    """A sample with a car on level ground, and a DontCare without a box."""
    points = sweep_of([CAR_BOX])
    labels = sample_of().objects
    boxes = torch.tensor([CAR_BOX, [0.0] * 7], dtype=torch.float64)
    return sample_of(
        points=points,
        objects=replace(labels, boxes3d=Boxes3D(boxes)),
        calibration=kitti_like_calibration(),
        image_size=(375, 1242),
        image=None,
        depth=None,
    )


def bank_of(*boxes, name="Car", lift_m=0.0):
    generator = torch.Generator().manual_seed(0)
    objects = []
    for x, y, z, *rest in boxes:
        box = [x, y, z + lift_m, *rest]
        points = box_surface(box, 200, generator)
        points = torch.cat((points, torch.ones(200, 1)), dim=1)
        objects.append(
            BankedObject(class_name=name, box=torch.tensor(box, dtype=torch.float64), points=points)
        )
    return ObjectBank(objects)


def pasted_frames(bank, count, **settings):
    sample, config = street(), ObjectSamplingConfig(max_objects=1, **settings)
    for seed in range(count):
        frame = paste_objects(sample, bank, np.random.default_rng(seed), config)
        if len(frame.objects) > len(sample.objects):
            yield frame


def test_the_bank_takes_objects_with_enough_points_of_the_wanted_classes():
    sample = street()
    found = collect_objects(sample)
    assert [entry.class_name for entry in found] == ["Car"]
    assert found[0].box.tolist() == pytest.approx(CAR_BOX)
    inside = Boxes3D(sample.objects.boxes3d.tensor[:1]).contain(sample.points[:, :3].double())[0]
    assert torch.equal(found[0].points, sample.points[inside])
    assert collect_objects(sample, ObjectSamplingConfig(min_points=10_000)) == []
    assert collect_objects(sample, ObjectSamplingConfig(class_names=("Cyclist",))) == []


def test_an_object_is_seen_from_the_same_side_at_the_same_distance_and_stands_on_the_ground():
    bank = bank_of([6.0, -3.0, -1.0, 3.6, 1.6, 1.5, 1.2], lift_m=0.7)  # another street was higher
    frames = list(pasted_frames(bank, 60))
    assert len(frames) > 10
    angles = set()
    for frame in frames:
        box = frame.objects.boxes3d.tensor[-1]
        assert math.hypot(box[0], box[1]) == pytest.approx(math.hypot(6.0, 3.0))
        assert box[2].item() == pytest.approx(-1.75 + 0.75, abs=0.05)
        seen_from = wrap_angle(box[6] - torch.atan2(box[1], box[0])).item()
        own = 1.2 - math.atan2(-3.0, 6.0)
        assert min(abs(seen_from - own), abs(seen_from + own)) < 1e-6  # mirrored or not
        angles.add(seen_from > 0)
        inside = Boxes3D(box[None]).enlarge(0.01).contain(frame.points[:, :3].double())[0]
        assert int((frame.points[inside, 3] == 1).sum()) >= 5
        assert int((frame.points[:, 3] == 1).sum()) == int((frame.points[inside, 3] == 1).sum())
    assert angles == {True, False}


def test_labels_of_pasted_objects_are_those_of_whole_visible_ones():
    frame = next(pasted_frames(bank_of([12.0, 0.0, -1.0, 3.6, 1.6, 1.5, 1.2]), 50))
    labels, calibration = frame.objects, frame.calibration
    assert isinstance(labels, ObjectLabels)
    assert labels.class_names == ("Car", "DontCare", "Car")
    corners = Boxes3D(labels.boxes3d.tensor[2:]).corners()[0]
    uvw = torch.cat((corners, torch.ones(8, 1)), dim=1).double() @ calibration.image_from_lidar.T
    pixels = uvw[:, :2] / uvw[:, 2:]
    expected = [*pixels.amin(dim=0).tolist(), *pixels.amax(dim=0).tolist()]
    assert labels.boxes2d.tensor[2].tolist() == pytest.approx(expected, abs=1.0)
    assert (labels.truncation[2], labels.occlusion[2]) == (0, 0)


def test_pasted_objects_keep_clear_of_others_and_of_what_stands_on_the_ground():
    own_place = bank_of(CAR_BOX)
    for frame in pasted_frames(own_place, 40):
        x, y = frame.objects.boxes3d.tensor[-1, :2].tolist()
        assert math.hypot(x - CAR_BOX[0], y - CAR_BOX[1]) > 1.7 + 0.3
    walls = torch.tensor([[8.0, 0.25 * k, -0.5, 0.2] for k in range(-60, 61)])
    sample = street()
    sample = replace(sample, points=torch.cat((sample.points, walls)))
    bank = bank_of([8.0, 0.0, -1.0, 4.0, 1.6, 1.5, 0.0])
    config = ObjectSamplingConfig(max_objects=1, max_bearing_deg=10.0)
    for seed in range(20):
        frame = paste_objects(sample, bank, np.random.default_rng(seed), config)
        assert frame is sample


def test_what_lies_behind_a_pasted_object_is_gone_and_a_hidden_object_is_left_out():
    bank = bank_of([4.0, 0.0, -1.0, 3.6, 1.6, 1.5, 1.57])
    frames = list(pasted_frames(bank, 20, max_bearing_deg=5.0))
    assert frames
    for frame in frames:
        pasted = frame.points[:, 3] == 1
        seen = reference.visible_together(
            frame.points[~pasted, :3].tolist(), frame.points[pasted, :3].tolist(), 1.0
        )
        assert all(seen[0])
        assert int((~pasted).sum()) < len(street().points) - 20
    wall = torch.cartesian_prod(
        torch.tensor([2.0]), torch.linspace(-3, 3, 1000), torch.linspace(-1.7, 0.5, 200)
    )
    wall = torch.cat((wall, torch.zeros(len(wall), 1)), dim=1)
    sample = street()
    walled = replace(sample, points=torch.cat((sample.points, wall)))
    config = ObjectSamplingConfig(max_objects=1, max_bearing_deg=5.0)
    for seed in range(20):
        assert paste_objects(walled, bank, np.random.default_rng(seed), config) is walled


def test_no_ground_no_object_and_an_empty_bank_pastes_nothing():
    sample, bank = street(), bank_of([6.0, 0.0, -1.0, 3.6, 1.6, 1.5, 0.0])
    bare = replace(sample, points=sample.points[:0])
    for seed in range(5):
        rng = np.random.default_rng(seed)
        assert paste_objects(bare, bank, rng) is bare
        assert paste_objects(sample, ObjectBank([]), rng) is sample
        other = ObjectSamplingConfig(class_names=("Cyclist",))
        assert paste_objects(sample, bank, rng, other) is sample


def test_the_same_seed_pastes_the_same_and_several_objects_keep_clear_of_each_other():
    bank = bank_of([6.0, 0.0, -0.9, 0.8, 0.6, 1.7, 0.0], [9.0, 2.0, -0.9, 0.8, 0.6, 1.7, 0.0])
    frames = [
        paste_objects(
            street(), bank, np.random.default_rng(4), ObjectSamplingConfig(max_objects=30)
        )
        for _ in range(2)
    ]
    assert torch.equal(frames[0].points, frames[1].points)
    boxes = frames[0].objects.boxes3d.tensor[2:]
    assert len(boxes) > 3
    distance = (boxes[:, None, :2] - boxes[:, :2]).norm(dim=2) + 9 * torch.eye(len(boxes))
    assert distance.min() > 0.6


def test_what_is_missing_or_out_of_range_is_refused():
    with pytest.raises(ValueError, match="sample random 0 needs a sweep and labels; give it both"):
        collect_objects(sample_of(objects=None))
    with pytest.raises(ValueError, match="class_names must hold one or more different ones"):
        ObjectSamplingConfig(class_names=())
    with pytest.raises(ValueError, match="min_points must be at least 1, got 0"):
        ObjectSamplingConfig(min_points=0)
    with pytest.raises(ValueError, match="max_bearing_deg must be from 0 to 180, got 181"):
        ObjectSamplingConfig(max_bearing_deg=181.0)
    with pytest.raises(ValueError, match="slack_m must be finite and not negative, got -1"):
        ObjectSamplingConfig(slack_m=-1.0)
