from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from sightline.data.formats.kitti_labels import parse_objects
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_metric import KittiObjectMetric
from sightline.evaluation.kitti_object_rules import CLASSES, DIFFICULTIES, LOOSE, METRICS
from tests.evaluation.kitti_scenes import random_street, write_frames

FILES = random_street(7, num_frames=12)


def records(files):
    labels = [parse_objects(text.encode(), "labels", with_scores=False) for text, _ in files]
    found = [parse_objects(text.encode(), "results", with_scores=True) for _, text in files]
    return found, labels


def test_frames_given_in_parts_score_as_their_files_do(tmp_path):
    metric = KittiObjectMetric(LOOSE)
    for start in range(0, len(FILES), 5):
        metric.update(*records(FILES[start : start + 5]))
    expected = evaluate_objects(*write_frames(tmp_path, FILES), overlaps=LOOSE)
    assert metric.report().to_json() == replace(expected, remarks=()).to_json()
    scores = metric.compute()
    for entry in expected.entries:
        name = f"{entry.class_name}/{entry.metric}/{entry.difficulty}"
        assert scores[name].item() == pytest.approx(entry.ap_r40)
        assert scores[f"{name}_R11"].item() == pytest.approx(entry.ap_r11)
        points = 0.0 if entry.all_points is None else entry.all_points.ap
        assert scores[f"{name}_all_points"].item() == pytest.approx(points)
    assert any("use that one" in note for note in metric.notes("validation/x"))
    assert (
        metric.notes("validation/x")[-1] == "Checkpoints are still selected by validation/x, R40."
    )
    metric.reset()
    assert metric.report().frames == 0


def test_every_class_metric_and_difficulty_has_a_score_even_without_detections():
    _, labels = records(FILES)
    metric = KittiObjectMetric()
    names = {f"{c}/{m}/{d}" for c, m, d in product(CLASSES, METRICS, DIFFICULTIES)}
    names |= {f"{name}{suffix}" for name in names for suffix in ("_R11", "_all_points")}
    metric.update([parse_objects(b"", "nothing", with_scores=True)] * len(labels), labels)
    assert metric.compute() == dict.fromkeys(names, 0.0)


def test_a_score_without_a_counted_label_is_told_to_select_nothing():
    metric = KittiObjectMetric(LOOSE)
    found, labels = records(FILES)
    unknown = [replace(each, occlusion=np.full(len(each), 3.0)) for each in labels]
    metric.update(found, unknown)
    metric.compute()
    told = "WARNING: no label counts for validation/Car/3d/moderate: there is none, or none by"
    assert metric.notes("validation/Car/3d/moderate")[-1].startswith(told)
    metric.reset()
    nothing = [parse_objects(b"", "nothing", with_scores=True)] * len(labels)
    metric.update(nothing, unknown)
    metric.compute()
    assert metric.notes("validation/Car/3d/moderate")[-1].startswith(told)
    metric.reset()
    metric.update(nothing, labels)
    metric.compute()
    assert "WARNING" not in " ".join(metric.notes("validation/Car/3d/moderate"))
    metric.reset()
    metric.update(found, labels)
    metric.compute()
    assert "WARNING" not in " ".join(metric.notes("validation/Car/3d/moderate"))


def test_frames_and_records_that_do_not_belong_together_are_refused():
    found, labels = records(FILES)
    with pytest.raises(ValueError, match="detections of 12 frames and labels of 11"):
        KittiObjectMetric().update(found, labels[1:])
    with pytest.raises(ValueError, match="have no scores"):
        KittiObjectMetric().update(labels, labels)


def test_processes_add_up_even_where_one_has_no_frames(tmp_path):
    sent = []

    def send(column, group):
        assert group is None
        sent.append(column)
        return [column]

    def receive(column, group):
        assert group is None
        other = sent.pop(0)
        assert (other.dtype, other.shape[1:]) == (column.dtype, column.shape[1:])
        return [other, column]

    idle, busy = KittiObjectMetric(LOOSE), KittiObjectMetric(LOOSE)
    busy.update(*records(FILES))
    idle.sync(send, distributed_available=lambda: True)
    busy.sync(receive, distributed_available=lambda: True)
    expected = evaluate_objects(*write_frames(tmp_path, FILES), overlaps=LOOSE)
    assert busy._score().to_json() == replace(expected, remarks=()).to_json()
