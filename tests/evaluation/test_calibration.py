import io
import json
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy.special import expit

from sightline.data.formats.kitti_labels import read_labels, read_results
from sightline.data.sharding import write_shards
from sightline.evaluation.calibration import (
    CalibrationSettings,
    ScoredFrames,
    evaluate_calibration,
    write_calibrated,
)
from sightline.evaluation.calibration_errors import find_outcomes, optimal_lrp
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_matching import (
    count_at,
    count_by_frame,
    index_pairs,
    select,
)
from sightline.evaluation.kitti_object_pairs import find_pairs
from sightline.evaluation.kitti_object_rules import CLASSES, DIFFICULTIES, METRICS, STRICT
from tests.data.trees import write_object_tree
from tests.evaluation.kitti_scenes import Line, random_crowd, random_street, text_of, write_frames
from tests.reference import calibration as reference
from tests.reference import kitti_object


def telling(files):
    """The same files with scores that grow with the overlap, and are far too sure."""
    rng = np.random.default_rng(0)
    by_hand = kitti_object.Evaluation(files)
    written = []
    for (labels, results), (truths, found) in zip(files, by_hand.frames, strict=True):
        lines = []
        for line, detection in zip(results.splitlines(), found, strict=True):
            best = max((by_hand.overlap(detection, t, "bbox") for t in truths), default=0)
            score = float(expit(12 * (best - 0.4) + rng.normal()))
            lines.append(" ".join([*line.split()[:-1], repr(score)]) + "\n")
        written.append((labels, "".join(lines)))
    return written


SAME_FRAMES = pytest.mark.filterwarnings("ignore:calibrators are fitted on 60 of the 60")


@pytest.fixture
def street(tmp_path):
    results, labels = write_frames(tmp_path, telling(random_street(1, 60)))
    return ScoredFrames(results_dir=results, labels_dir=labels)


def read_pairs(folders):
    results, labels = folders
    names = sorted(path.name for path in labels.iterdir())
    found = [read_results(results / name) for name in names]
    return find_pairs(found, [read_labels(labels / name) for name in names], STRICT.as_array())


@pytest.mark.parametrize("make", [random_street, random_crowd])
@pytest.mark.parametrize("metric", METRICS)
def test_outcomes_and_lrp_are_those_counted_by_hand(tmp_path, make, metric):
    files = make(4, 50)
    data = read_pairs(write_frames(tmp_path, files))
    by_hand = kitti_object.Evaluation(files)
    for code, name in enumerate(CLASSES):
        minimum = kitti_object.STRICT[name][METRICS.index(metric)]
        for level in range(len(DIFFICULTIES)):
            task = select(
                data,
                index_pairs(data),
                code=code,
                metric=METRICS.index(metric),
                difficulty=level,
                min_overlap=minimum,
            )
            frames = [
                kitti_object.Frame(by_hand, truths, found, name, metric, level)
                for truths, found in by_hand.frames
            ]
            for threshold in (-10.0, 0.25):
                found = find_outcomes(task, threshold)
                expected = [
                    (frame.detections[j].score, is_true, overlap)
                    for frame in frames
                    for j, is_true, overlap in reference.outcomes(frame, threshold)
                ]
                assert found.score.tolist() == [each[0] for each in expected]
                assert found.is_true.tolist() == [each[1] for each in expected]
                assert found.overlap == pytest.approx(np.array([each[2] for each in expected]))
                counts = count_at(task, np.array([threshold]))
                assert found.is_true.sum() == counts.tp[0]
                assert (~found.is_true).sum() == counts.fp[0]
            lrp = optimal_lrp(count_by_frame(task), task.n_gt, minimum)
            if task.n_gt == 0:
                assert lrp is None
                continue
            assert lrp.error == pytest.approx(reference.optimal_lrp(frames, minimum))
            if lrp.threshold is not None:
                at = find_outcomes(task, lrp.threshold)
                assert lrp.false_negatives == pytest.approx(1 - at.is_true.sum() / task.n_gt)
                assert lrp.false_positives == pytest.approx(1 - at.is_true.mean())
                if at.is_true.any():
                    misplaced = 1 - at.overlap[at.is_true].mean()
                    assert lrp.localization == pytest.approx(misplaced)


def test_scores_that_are_the_precision_have_no_error(tmp_path):
    car = Line()
    half = [replace(car, score=0.5), replace(car, score=0.5).moved(image=500, ground=50)]
    folders = write_frames(tmp_path, [(car.text(), text_of(half))] * 4)
    data = ScoredFrames(results_dir=folders[0], labels_dir=folders[1])
    entry = evaluate_calibration(data).entries[0]
    assert (entry.n_gt, entry.n_true, entry.n_false) == (4, 4, 4)
    assert entry.uncalibrated.precision.error == 0
    assert entry.uncalibrated.overlap.error == pytest.approx(0)
    assert entry.lrp.error == pytest.approx(0.5)
    assert entry.lrp.localization == pytest.approx(0)


def test_any_overlap_counts_boxes_that_lie_badly(tmp_path):
    car = Line()
    shifted = replace(car, score=0.5).moved(image=50)  # IoU 1/3
    folders = write_frames(tmp_path, [(car.text(), shifted.text())])
    data = ScoredFrames(results_dir=folders[0], labels_dir=folders[1])
    calibration = evaluate_calibration(data).entries[0].uncalibrated
    assert calibration.overlap.error == pytest.approx(0.5)
    assert calibration.any_overlap.error == pytest.approx(0.5 - 1 / 3)


def test_calibrated_results_have_less_error_and_the_same_order(street, tmp_path):
    (tmp_path / "more").mkdir()
    folders = write_frames(tmp_path / "more", telling(random_street(9, 200)))
    fit_on = ScoredFrames(results_dir=folders[0], labels_dir=folders[1])
    report = evaluate_calibration(street, fit_on=fit_on, calibrators=("platt", "isotonic"))
    car = report.entries[0]
    for each in car.calibrated.values():
        assert each.precision.error < 0.6 * car.uncalibrated.precision.error
    written = write_calibrated(street, tmp_path / "out", report, "platt")
    assert written == 60
    few = replace(street, sample_list=street.sample_list or ["000001", "000002"])
    assert write_calibrated(few, tmp_path / "out", report, "platt") == len(few.sample_list)
    with pytest.raises(ValueError, match="made with calibrator platt instead of isotonic"):
        write_calibrated(street, tmp_path / "out", report, "isotonic")
    again = ScoredFrames(results_dir=tmp_path / "out", labels_dir=street.labels_dir)
    entry = evaluate_calibration(again).entries[0]
    assert entry.uncalibrated.precision.error == pytest.approx(
        car.calibrated["platt"].precision.error
    )
    assert [
        each.ap_r40 for each in evaluate_objects(again.results_dir, again.labels_dir).entries
    ] == [each.ap_r40 for each in evaluate_objects(street.results_dir, street.labels_dir).entries]


@pytest.mark.parametrize(("measured", "shared"), [(slice(60), 30), (slice(30, 60), 0)])
def test_calibrators_fitted_on_measured_frames_are_told(street, measured, shared):
    names = sorted(path.stem for path in street.labels_dir.iterdir())
    fit_on = replace(street, sample_list=names[:30])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        chosen = replace(street, sample_list=names[measured])
        evaluate_calibration(chosen, fit_on=fit_on, calibrators=("temperature",))
    said = [str(each.message) for each in told]
    assert len(said) == (shared > 0)
    assert all("fitted on 30 of the 60 measured frames (000000" in each for each in said)


def test_calibrators_are_fitted_on_labels_in_shards(street, tmp_path):
    names = sorted(path.stem for path in street.labels_dir.iterdir())
    tree = write_object_tree(tmp_path / "tree", *names)
    for path in street.labels_dir.iterdir():
        shutil.copy(path, tree / "training" / "label_2")
    write_shards(tree, tmp_path / "shards", frames_per_shard=len(names))
    packed = replace(street, labels_dir=tmp_path / "shards" / "training" / "label_2")
    reports = []
    for given in (packed, street):
        with pytest.warns(UserWarning, match="fitted on 60 of the 60 measured frames"):
            reports.append(evaluate_calibration(given, fit_on=given, calibrators=("temperature",)))
    errors = [each.entries[0].calibrated["temperature"].precision.error for each in reports]
    assert errors[0] == errors[1]


@SAME_FRAMES
def test_fitted_to_overlaps_the_error_of_overlaps_is_less(street):
    settings = CalibrationSettings(target="overlap", metric="3d")
    report = evaluate_calibration(
        street, fit_on=street, calibrators=("isotonic",), settings=settings
    )
    for entry in report.entries:
        assert entry.calibrated["isotonic"].overlap.error < 0.02
        assert entry.calibrated["isotonic"].precision.error > 0.02


@SAME_FRAMES
def test_the_report_is_json_and_a_table_of_80_columns(street):
    report = evaluate_calibration(street, fit_on=street, calibrators=("temperature",))
    written = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert [entry["class"] for entry in written["entries"]] == list(CLASSES)
    entry = written["entries"][0]
    assert entry["calibrated"]["temperature"]["calibrator"]["slope"] > 0
    assert sum(each["count"] for each in entry["as_they_are"]["bins"]) == (
        entry["n_true"] + entry["n_false"]
    )
    console = Console(width=80)
    with console.capture() as capture:
        console.print(report.table())
    assert "temperature" in capture.get()
    assert "…" not in capture.get()


def test_results_without_any_detection_are_told_not_shown_as_an_empty_table(street, capsys):
    for path in street.results_dir.iterdir():
        path.write_text("")
    Console(width=80).print(evaluate_calibration(street).table())
    assert "nothing was found in any frame" in capsys.readouterr().out


def test_results_with_placeholders_for_2d_boxes_are_not_called_none(street, capsys):
    line = "Car -1 -1 -10 -1 -1 -1 -1 1.5 1.6 3.9 1 1.6 20 0.1 0.9\n"
    for path in street.results_dir.iterdir():
        path.write_text(line)
    Console(width=200).print(evaluate_calibration(street).table())
    printed = capsys.readouterr().out
    assert "nothing was found" not in printed
    assert "results is of a class and has values that bbox measures" in " ".join(printed.split())


def test_scores_that_are_no_probabilities_are_refused(tmp_path):
    folders = write_frames(tmp_path, random_street(1, 3))
    data = ScoredFrames(results_dir=folders[0], labels_dir=folders[1])
    with pytest.raises(ValueError, match=r"00000\d\.txt: has a score of .*, expected 0 to 1"):
        evaluate_calibration(data)


def test_a_class_without_results_to_fit_on_is_refused(street, tmp_path):
    (tmp_path / "none").mkdir()
    folders = write_frames(tmp_path / "none", [(Line().text(), "")])
    fit_on = ScoredFrames(results_dir=folders[0], labels_dir=folders[1])
    with pytest.raises(ValueError, match="has no Car that counts"):
        evaluate_calibration(street, fit_on=fit_on, calibrators=("platt",))


def test_calibrators_without_results_to_fit_on_are_refused(street):
    with pytest.raises(ValueError, match="give both"):
        evaluate_calibration(street, calibrators=("platt",))
    with pytest.raises(ValueError, match="give both"):
        evaluate_calibration(street, fit_on=street)


@SAME_FRAMES
def test_results_are_not_overwritten_and_only_fitted_calibrators_are_applied(street, tmp_path):
    report = evaluate_calibration(street, fit_on=street, calibrators=("platt",))
    with pytest.raises(ValueError, match="results to be calibrated: name another folder"):
        write_calibrated(street, street.results_dir, report, "platt")
    with pytest.raises(ValueError, match="holds the labels: name another folder"):
        write_calibrated(street, street.labels_dir, report, "platt")
    with pytest.raises(ValueError, match="no calibrator isotonic was fitted"):
        write_calibrated(street, tmp_path / "out", report, "isotonic")


@pytest.mark.parametrize("bad", [{"num_bins": 0}, {"min_score": 1.0}, {"min_score": -0.1}])
def test_settings_out_of_range_are_refused(bad):
    with pytest.raises(ValueError, match="got"):
        CalibrationSettings(**bad)


def test_what_is_left_out_is_counted(tmp_path):
    car = Line()
    found = replace(car, score=0.5)
    strange = replace(found, name="[/b]Bus").text()
    results, labels = write_frames(tmp_path, [(car.text(), found.text() + strange)])
    report = evaluate_calibration(ScoredFrames(results_dir=results, labels_dir=labels))
    (remark,) = report.remarks
    assert remark.startswith("1 of 2 results were left out: their classes are not scored ([/b]Bus")
    assert report.to_json()["notes"] == [remark]
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(report.table())
    assert remark[:60] in console.export_text()
    (results / "000000.txt").write_text(found.text())
    sound = evaluate_calibration(ScoredFrames(results_dir=results, labels_dir=labels))
    assert "notes" not in sound.to_json()
