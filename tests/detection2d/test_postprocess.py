import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection2d.config import CLASSES, PostprocessConfig
from sightline.detection2d.placement import Placement
from sightline.detection2d.postprocess import to_detections
from tests.reference import ssd as reference

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
    for corners, said in rows:
        cut = tuple(
            min(max(value, 0), limit)
            for value, limit in zip(corners, (59, 39, 59, 39), strict=True)
        )
        for index, value in enumerate(said):
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
