"""Joined objects in the robustness bench."""

import json

import numpy as np
import pytest
import torch

from sightline.cli.robustness import _chosen_task
from sightline.corruptions.suites import find_suite
from sightline.data.formats.kitti_labels import read_results
from sightline.data.open import open_dataset
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.joining.robustness import SCORING, JoinedTask
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.objects import Objects
from sightline.structures.predictions import Perception
from tests.joining.test_predictor import joined

LABELS = PACKAGED_FRAMES / "training" / "label_2"


def true_objects(sample, *, scores3d=0.8):
    """The labels with a 3D box as objects."""
    labels = sample.objects.select(sample.objects.has_box3d)
    ones = torch.ones(len(labels), dtype=torch.float64)
    return Objects(
        class_names=labels.class_names,
        boxes2d=labels.boxes2d,
        boxes3d=labels.boxes3d,
        origins=("measured",) * len(labels),
        scores=0.9 * ones,
        scores3d=scores3d * ones,
        image_support=ones,
        lidar_support=ones,
        num_points=ones.long(),
    )


def prediction(objects, case_name="clean"):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    (case,) = find_suite("dgfn7").select([case_name])
    return BenchPrediction(
        BenchFrame(sample, None), case.corrupt(sample), Perception(objects=objects(sample))
    )


def test_true_objects_have_full_scores_in_the_image_in_space_and_by_centre(tmp_path):
    dataset = open_dataset(PACKAGED_FRAMES, sample_list=("000000",))
    SCORING.store(tmp_path / "000000.txt", prediction(true_objects))
    assert read_results(tmp_path / "000000.txt").scores.tolist()[0] == 0.9
    assert read_results(tmp_path / "3d" / "000000.txt").scores.tolist()[0] == 0.8
    scores = SCORING.score(tmp_path, dataset)
    assert list(scores) == [metric.name for metric in SCORING.metrics]
    for name in ("bbox_0.7_hard_all_points", "3d_0.7_hard_all_points", "bev_0.5_hard_all_points"):
        assert scores[f"Car_{name}"] == 100
    assert scores["Car_centre_2m_hard"] == pytest.approx(100)
    assert scores["Car_centre_0.5-4m_hard"] == pytest.approx(100)


def test_each_place_is_scored_by_its_own_file_and_results_of_others_by_one(tmp_path):
    dataset = open_dataset(PACKAGED_FRAMES, sample_list=("000000",))
    path = tmp_path / "000000.txt"
    SCORING.store(path, prediction(true_objects))
    (tmp_path / "3d" / "000000.txt").write_text("")
    scores = SCORING.score(tmp_path, dataset)
    assert scores["Car_bbox_0.7_hard_all_points"] == 100
    assert scores["Car_3d_0.7_hard_all_points"] == scores["Car_centre_2m_hard"] == 0
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "000000.txt").write_bytes(path.read_bytes())
    scores = SCORING.score(alone, dataset)
    assert scores["Car_3d_0.7_hard_all_points"] == 100
    report = evaluate_objects(alone, LABELS, sample_list=("000000",))
    (entry,) = (
        each
        for each in report.entries
        if (each.class_name, each.metric, each.difficulty) == ("Car", "3d", "moderate")
    )
    assert scores["Car_centre_2m_moderate"] == entry.centres.ap_2m


def test_nothing_found_scores_zero_and_classes_without_objects_have_no_score(tmp_path):
    dataset = open_dataset(PACKAGED_FRAMES, sample_list=("000000",))
    SCORING.store(tmp_path / "000000.txt", prediction(lambda _: Objects.from_json([])))
    scores = SCORING.score(tmp_path, dataset)
    assert scores["Car_centre_0.5-4m_hard"] == 0
    counted = {name for name, value in scores.items() if value is not None}
    classes = set(dataset[0].objects.class_names)
    assert {name.partition("_")[0] for name in counted} <= classes


@pytest.mark.parametrize("case_name", ["clean", "camera_blank", "lidar_blank"])
def test_predictions_and_read_results_are_drawn_on_both_panels(tmp_path, case_name):
    drawn = prediction(true_objects, case_name)
    path = tmp_path / "000000.txt"
    SCORING.store(path, drawn)
    read = drawn._replace(output=SCORING.read(path, drawn.corrupted.sample))
    empty = drawn._replace(output=Perception(objects=Objects.from_json([])))
    panels = [SCORING.draw(each, 300) for each in (drawn, read, empty)]
    for each in panels:
        assert [panel.caption for panel in each] == ["objects", "from above, labels white"]
        assert all(panel.picture.shape[1] == 300 for panel in each)
    for found in panels[:2]:
        for panel, without in zip(found, panels[2], strict=True):
            assert not np.array_equal(panel.picture, without.picture)


class FixedTask(JoinedTask):
    """Joined objects of detectors with fixed predictions."""

    def predictor(self, **options):
        del options
        return joined()


@pytest.mark.parametrize("place", ["", "3d"])
def test_a_run_scores_all_cases_and_is_resumed(tmp_path, place):
    settings = BenchSettings(cases=("camera_blank", "lidar_blank"), workers=1)
    report = run_bench(FixedTask(), PACKAGED_FRAMES, tmp_path / "run", settings)
    assert sorted(report.record.scores) == ["camera_blank", "clean", "lidar_blank"]
    written = (tmp_path / "run" / "robustness.json").read_bytes()
    answer = tmp_path / "run" / "answers" / "lidar_blank" / place / "000001.txt"
    text = answer.read_text()
    assert "Car" in text or place  # lifted boxes have no part there
    answer.unlink()
    run_bench(FixedTask(), PACKAGED_FRAMES, tmp_path / "run", settings)
    assert answer.read_text() == text
    assert (tmp_path / "run" / "robustness.json").read_bytes() == written
    assert json.loads(written)["task"] == "joined"


@pytest.mark.parametrize("options", [{"method": "linear"}, {"weights": "detection2d-best"}])
def test_other_weights_and_methods_are_refused(options):
    with pytest.raises(ValueError, match=f"not by {next(iter(options.values()))}; leave --method"):
        JoinedTask().predictor(**options)


def test_the_command_finds_the_task_by_its_name_or_that_of_its_weights():
    assert isinstance(_chosen_task("joined", None), JoinedTask)
    assert isinstance(_chosen_task(None, "joined"), JoinedTask)
    assert _chosen_task("detection2d", None).name == "detection2d"
