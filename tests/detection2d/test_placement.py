from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.scene_changes import resize
from sightline.detection2d.config import CLASSES, InputConfig, PostprocessConfig
from sightline.detection2d.placement import Placement, place, to_detections
from tests.detection2d.frames import painted_frame
from tests.reference import ssd as reference

KEPT = InputConfig(size=None)


def seen_by(focal_px, size=(120, 400)):
    """A frame of a camera of this focal length."""
    sample = resize(painted_frame(0), *size)
    matrix = sample.calibration.image_from_camera.clone()
    matrix[0, 0] = matrix[1, 1] = focal_px
    return replace(sample, calibration=replace(sample.calibration, image_from_camera=matrix))


@pytest.mark.parametrize(
    ("focal_px", "scale", "size"),
    [
        (707.0, 1.0, (120, 400)),
        (722.0, 1.0, (120, 400)),
        (1500.0, 1.0, (60, 200)),
        (1500.0, 0.5, (30, 100)),
        (361.0, 1.0, (120, 400)),
        (361.0, 0.5, (60, 200)),
        (1e9, 1.0, (1, 1)),
    ],
)
def test_frames_of_a_longer_focal_length_are_shrunk_to_kittis(focal_px, scale, size):
    given, _ = place(seen_by(focal_px), replace(KEPT, scale=scale))
    assert given.image_size == size
    assert given.image.shape[1:] == size


def test_boxes_go_back_to_the_frames_own_pixels():
    sample = seen_by(1100.0)
    given, placement = place(sample, KEPT)
    boxes = given.objects.boxes2d.tensor
    assert (boxes < sample.objects.boxes2d.tensor).all()
    torch.testing.assert_close(placement.to_image(boxes), sample.objects.boxes2d.tensor)


def test_a_network_of_one_size_sees_every_camera_at_that_size():
    given, _ = place(seen_by(1500.0), InputConfig(size=(90, 300)))
    assert given.image_size == (90, 300)


def test_a_limit_that_is_none_is_refused():
    with pytest.raises(ValueError, match="longest_focal_px must be from 1 to"):
        InputConfig(longest_focal_px=0.0)
    with pytest.raises(ValueError, match="size must have up to 8388608 pixels, got"):
        InputConfig(size=(8192, 8192))


SEEN = Placement(image_size=(40, 60), scale_x=1.0, scale_y=1.0)
whole = st.integers(-5, 70)
box = st.tuples(whole, whole, st.integers(0, 30), st.integers(0, 30)).map(
    lambda b: (b[0], b[1], b[0] + b[2], b[1] + b[3])
)
score = st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.9])


@given(
    rows=st.lists(st.tuples(box, st.tuples(score, score, score)), max_size=8),
    config=st.builds(
        PostprocessConfig,
        min_score=st.sampled_from([0.0, 0.1, 0.4]),
        nms_iou=st.sampled_from([0.0, 0.45, 1.0]),
        max_detections=st.sampled_from([1, 3, 100]),
    ),
)
def test_detections_are_those_of_plain_loops(rows, config):
    boxes = torch.tensor([row[0] for row in rows], dtype=torch.float32).reshape(-1, 4)
    scores = torch.tensor([row[1] for row in rows]).reshape(-1, 3)
    entries = []
    for corners, values in rows:
        cut = tuple(
            min(max(value, 0), limit)
            for value, limit in zip(corners, (59, 39, 59, 39), strict=True)
        )
        for index, value in enumerate(values):
            if value > config.min_score and reference.area(cut) > 0:
                entries.append((value, CLASSES[index], cut))
    kept = []
    for entry in sorted(entries, key=lambda each: -each[0]):
        others = [each for each in kept if each[1] == entry[1]]
        if all(reference.iou(each[2], entry[2]) <= config.nms_iou for each in others):
            kept.append(entry)
    found = to_detections(scores, boxes, SEEN, config)
    assert found.class_names == tuple(each[1] for each in kept[: config.max_detections])
    assert found.boxes.tensor.tolist() == [list(each[2]) for each in kept[: config.max_detections]]


def test_boxes_go_back_into_the_frames_own_pixels():
    placement = Placement(image_size=(100, 400), scale_x=0.5, scale_y=2.0)
    scores, boxes = torch.tensor([[0.0, 0.0, 0.8]]), torch.tensor([[9.5, 19.5, 49.5, 99.5]])
    found = to_detections(scores, boxes, placement, PostprocessConfig())
    assert found.class_names == ("Cyclist",)
    assert found.boxes.tensor.tolist() == [[19.5, 9.5, 99.5, 49.5]]


def test_of_thousands_of_boxes_the_surest_are_looked_at():
    low = torch.rand(4000, 2, generator=torch.Generator().manual_seed(0)) * torch.tensor([50.0, 30])
    scores = torch.zeros(4000, 3)
    scores[:, 0] = torch.linspace(0.1, 0.9, 4000)
    config = PostprocessConfig(nms_iou=1.0, max_detections=10_000)
    found = to_detections(scores, torch.cat((low, low + 4), dim=1), SEEN, config)
    assert len(found.scores) == 2000
    assert found.scores.min() == pytest.approx(float(scores[2000, 0]))
