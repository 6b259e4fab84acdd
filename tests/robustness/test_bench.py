"""Whole bench, on the packaged frames."""

import gc
import json
import os
import re
import shutil
import weakref
from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sightline.corruptions import suites
from sightline.corruptions.suites import find_suite
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.depth_completion.predictor import DepthCompleter
from sightline.depth_completion.registration import TASK as DEPTH
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import split_rings
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.files import shard_index
from sightline.files.problem import FileError
from sightline.robustness import bench
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.frames import digest_files, open_frames
from sightline.robustness.predictions import MethodRun, predict_in_cases
from sightline.robustness.record import read_record
from sightline.robustness.scoring import BenchFrame, Scoring
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import find_task, task_names
from tests.data.recordings import write_recording
from tests.robustness.runs import LEVELS
from tests.robustness.tasks import LABELS, SCORING, Oracle, OracleTask

ADAPTIVE = BenchSettings(suite="levels", seed=3, workers=1)


@pytest.fixture(autouse=True, scope="module")
def _with_levels():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(suites.SUITES, "levels", LEVELS)
        yield


def run(out, **settings):
    method = settings.pop("method", "adaptive")
    return run_bench(DEPTH, PACKAGED_FRAMES, out, replace(ADAPTIVE, **settings), method=method)


def detect(out, **settings):
    method = settings.pop("method", None)
    data = settings.pop("data", PACKAGED_FRAMES)
    return run_bench(OracleTask(), data, out, replace(ADAPTIVE, **settings), method=method)


def contents(folder):
    return {
        path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


@pytest.fixture(scope="module")
def depth_run(tmp_path_factory, _with_levels):
    out = tmp_path_factory.mktemp("runs") / "adaptive"
    return run(out, baseline="nearest"), out


@pytest.fixture(scope="module")
def oracle_run(tmp_path_factory, _with_levels):
    out = tmp_path_factory.mktemp("runs") / "oracle"
    return detect(out), out


def test_a_run_with_fewer_requested_cases_keeps_all(tmp_path):
    whole = detect(tmp_path / "run", cases=("camera_blank",))
    assert set(whole.record.scores) == {"clean", "camera_blank"}
    again = detect(tmp_path / "run", cases=("clean",))
    assert again.to_json() == whole.to_json()
    more = detect(tmp_path / "run", cases=("lidar_blank",))
    assert list(more.record.scores) == ["clean", "camera_blank", "lidar_blank"]


def test_depth_is_scored_on_rings_that_stay_while_what_is_given_gets_worse(depth_run):
    scores = depth_run[0].record.scores
    dataset = open_dataset(PACKAGED_FRAMES)
    samples = [dataset[index] for index in range(len(dataset))]
    completer = DepthCompleter("adaptive")

    def complete(case, given):
        return completer(case.corrupt(given, 3).sample)

    for case in LEVELS.select(["clean", "camera_dead_pixels-2"]):
        (expected,) = evaluate_held_out(samples, partial(complete, case), beams=[64]).scores
        assert scores[case.name]["rmse_mm"] == pytest.approx(expected.rmse_mm, rel=1e-12)
        assert scores[case.name]["median_mm"] == pytest.approx(expected.median_mm, rel=1e-12)
    truths = [split_rings(sample).truth_m.double().numpy() for sample in samples]
    blind = np.mean([np.sqrt(np.mean((1e3 * truth[truth > 0]) ** 2)) for truth in truths])
    assert scores["lidar_blank"]["rmse_mm"] == pytest.approx(blind, rel=1e-12)


def test_a_method_named_as_baseline_runs_as_it_would_alone(depth_run, tmp_path):
    report, _ = depth_run
    alone = run(tmp_path / "nearest", method="nearest")
    assert alone.record == report.baseline
    again = run(tmp_path / "adaptive", baseline=str(tmp_path / "nearest" / "robustness.json"))
    assert again.to_json() == report.to_json()
    folder = run(tmp_path / "adaptive", baseline=str(tmp_path / "nearest"))
    assert folder.to_json() == report.to_json()
    assert report.measured[0][1].mce < 1  # our completion against the plainest


def test_detections_are_scored_as_evaluate_objects_scores_them(oracle_run):
    report, out = oracle_run
    for case in LEVELS.cases:
        folder = out / "answers" / case.name
        scored = evaluate_objects(folder, LABELS, bootstrap=1)
        scores = report.record.scores[case.name]
        for entry in scored.entries:
            if (entry.class_name, entry.metric) == ("Car", "bbox"):
                assert scores[f"Car_bbox_0.7_{entry.difficulty}_R40"] == entry.ap_r40
                assert scores[f"Car_bbox_0.7_{entry.difficulty}_all_points"] == entry.all_points.ap
    assert scores["Car_bbox_0.5_hard_all_points"] == 100
    blank = report.record.scores["camera_blank"]["Car_bbox_0.7_hard_all_points"]
    assert 0 < blank < report.record.scores["clean"]["Car_bbox_0.7_hard_all_points"]


def test_what_is_not_found_scores_0_and_what_is_not_there_is_not_scored(tmp_path):
    dataset = open_dataset(PACKAGED_FRAMES)
    for name in dataset.sample_ids:
        (tmp_path / f"{name}.txt").write_text("")
    scores = SCORING.score(tmp_path, dataset)
    labels = [(LABELS / f"{name}.txt").read_text() for name in dataset.sample_ids]
    assert scores["Car_bbox_0.7_hard_R40"] == 0
    expected = 0 if any("Cyclist" in text for text in labels) else None
    assert scores["Cyclist_3d_0.5_hard_R40"] == expected
    assert list(scores) == [metric.name for metric in SCORING.metrics]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_run_that_was_killed_resumes_to_the_same_files(
    oracle_run, tmp_path, monkeypatch, workers
):
    _, whole = oracle_run
    out = tmp_path / "oracle"
    original = type(SCORING).store
    with monkeypatch.context() as patch:
        patch.setattr(type(SCORING), "store", _stops_after(4, original))
        with pytest.raises(KeyboardInterrupt):
            detect(out)
    assert 0 < len(list(out.glob("answers/*/*.txt"))) < 12
    assert not (out / "robustness.json").exists()
    detect(out, workers=workers)
    assert contents(out) == contents(whole)


def _stops_after(count, original):
    done = []

    def store(self, path, prediction):
        if len(done) == count:
            raise KeyboardInterrupt
        done.append(path)
        original(self, path, prediction)

    return store


def test_a_second_call_makes_nothing_anew_and_more_cases_extend_a_run(oracle_run, tmp_path):
    _, whole = oracle_run
    out = tmp_path / "oracle"
    detect(out, cases=("camera_dead_pixels-2", "camera_dead_pixels-3", "camera_blank"))
    few = read_record(out / "robustness.json")
    assert list(few.cases) == [
        "clean",
        "camera_dead_pixels-2",
        "camera_dead_pixels-3",
        "camera_blank",
    ]
    detect(out)
    assert contents(out) == contents(whole)


def test_kept_predictions_of_frames_that_were_changed_since_are_told(tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    detect(out, data=data, cases=("clean",))
    later_ns = (out / "robustness.json").stat().st_mtime_ns + 10**9
    os.utime(data / "training/velodyne/000001.bin", ns=(later_ns, later_ns))
    told = f"of 2 frames .* first is 000001: .* to make them anew, remove {out / 'answers'}"
    with pytest.warns(UserWarning, match=told):
        detect(out, data=data, cases=("clean",))


def _labels_without_cars(data):
    for path in (data / "training" / "label_2").iterdir():
        path.write_text(path.read_text().replace("Car ", "Van "))


def _exchange_by_an_older_folder(data):
    """Replace the labels by a folder whose files were not changed for years."""
    folder, corrected = data / "training" / "label_2", data.with_name("corrected")
    shutil.copytree(folder, corrected / "training" / "label_2")
    _labels_without_cars(corrected)
    for path in (corrected / "training" / "label_2").iterdir():
        os.utime(path, (0, 0))
    shutil.rmtree(folder)
    (corrected / "training" / "label_2").rename(folder)


@pytest.mark.parametrize("is_packed", [False, True])
@pytest.mark.parametrize("change", [_labels_without_cars, _exchange_by_an_older_folder])
def test_scores_of_labels_that_were_changed_since_are_repeated(change, is_packed, tmp_path):
    tree, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, tree)
    data = tmp_path / "shards" if is_packed else tree

    def scores(*cases):
        if is_packed:
            write_shards(tree, data, frames_per_shard=1)
            shard_index._kept_tree.cache_clear()  # as in a new process
        found = detect(out, data=data, cases=cases).record.scores
        return {case: found[case]["Car_bbox_0.5_hard_all_points"] for case in found}

    assert scores("camera_blank")["clean"] == 100
    before = {path: path.stat().st_mtime_ns for path in (out / "scores").iterdir()}
    scores("camera_blank")
    assert {path: path.stat().st_mtime_ns for path in before} == before
    change(tree)
    # an index of a shard does not tell which of its files have changed
    told = pytest.warns(UserWarning, match="changed, copied or packed since")
    with told if is_packed else nullcontext():
        found = scores("lidar_blank")
    assert found == {"clean": None, "camera_blank": None, "lidar_blank": None}


def test_kept_predictions_of_occlusions_at_labels_that_were_changed_since_are_told(tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    settings = {"data": data, "suite": "dgfn7", "cases": ("camera_blank", "lidar_occlusion")}
    detect(out, **settings)
    folder, labels = out / "answers" / "lidar_occlusion", data / "training" / "label_2"
    told = rf"^1 of 2 frames \(000001\) had other labels .* remove {folder}$"
    changed = (labels / "000001.txt").read_text().replace("Car ", "Van ")
    (labels / "000001.txt").write_text(changed)
    os.utime(labels / "000001.txt", ns=(0, 0))
    for _ in range(2):
        with pytest.warns(UserWarning, match=told):
            detect(out, **settings)
    shutil.rmtree(folder)
    detect(out, **settings)  # warnings are errors here
    labels.rename(data / "labels")
    labels.symlink_to(data / "labels")
    detect(out, **settings)  # of equal content
    shutil.copytree(PACKAGED_FRAMES / "training" / "label_2", tmp_path / "other")
    labels.unlink()
    labels.symlink_to(tmp_path / "other")
    with pytest.warns(UserWarning, match=told):
        detect(out, **settings)


def test_labels_that_are_hard_linked_are_not_taken_for_changed_ones(tmp_path):
    """As `corrupt_dataset` does, which changes their status."""
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    settings = {"data": data, "suite": "dgfn7", "cases": ("lidar_occlusion",)}
    detect(out, **settings)
    scores = out / "scores" / "clean.json"
    before = scores.stat().st_mtime_ns
    for path in (data / "training" / "label_2").iterdir():
        (tmp_path / path.name).hardlink_to(path)
    detect(out, **settings)  # warnings are errors here
    assert scores.stat().st_mtime_ns == before


def test_labels_of_predictions_by_an_older_version_are_not_known(tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    settings = {"data": data, "suite": "dgfn7", "cases": ("lidar_occlusion",)}
    detect(out, **settings)
    record = out / "answers" / "lidar_occlusion" / "labels.json"
    record.unlink()
    for path in (out / "scores").iterdir():
        content = json.loads(path.read_text())
        del content["labels"]
        path.write_text(json.dumps(content))
    _labels_without_cars(data)
    detect(out, **settings)  # warnings are errors here
    assert not record.exists()
    record.write_text("[")
    with pytest.warns(UserWarning, match=f"labels.json is damaged: .* remove {record.parent}$"):
        detect(out, **settings)


def test_labels_are_recorded_for_each_case(tmp_path):
    """Cases that are made after the labels were changed are placed by the new ones."""
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    labels = data / "training" / "label_2"
    old = (labels / "000001.txt").read_text()
    settings = {"data": data, "suite": "dgfn7"}
    first, second = (out / "answers" / f"{sensor}_occlusion" for sensor in ("camera", "lidar"))
    detect(out, cases=("camera_occlusion",), **settings)
    (labels / "000001.txt").write_text("\n".join(reversed(old.splitlines())) + "\n")
    with pytest.warns(UserWarning, match=f"remove {first}$"):
        detect(out, cases=("lidar_occlusion",), **settings)
    shutil.copytree(out, tmp_path / "mixed")
    shutil.rmtree(first)
    detect(out, cases=("camera_occlusion", "lidar_occlusion"), **settings)
    (out / "answers").rename(tmp_path / "sound")
    (tmp_path / "mixed" / "answers").rename(out / "answers")
    (labels / "000001.txt").write_text(old)
    with pytest.warns(UserWarning, match=f"remove {second}$"):
        detect(out, **settings)


def test_labels_that_some_frames_lack_are_read_for_the_others(tmp_path):
    """Occlusions hit labelled objects also where the task is scored without labels."""
    data = tmp_path / "data"
    shutil.copytree(PACKAGED_FRAMES, data)
    settings = {"sample_list": None, "velodyne": None}
    cases = [case for case in find_suite("dgfn7").cases if case.name == "lidar_occlusion"]
    labelled = open_frames(data, ("points",), cases, **settings)[0].objects
    (data / "training" / "label_2" / "000001.txt").unlink()
    (data / "training" / "image_2" / "000000.png").unlink()
    frames = open_frames(data, ("points",), cases, **settings)
    assert frames[0].objects.class_names == labelled.class_names
    assert (frames[0].image, frames[1].objects) == (None, None)
    label = data / "training" / "label_2" / "000000.txt"
    label.rename(label.with_suffix(".json"))
    with pytest.warns(UserWarning, match="labels are not read, so that occlusions are placed any"):
        unlabelled = open_frames(data, ("points",), cases, **settings)
    assert len(unlabelled) == 2
    label.symlink_to("nowhere")
    with pytest.raises(FileError, match=r"000000.txt: is a link to 'nowhere', which cannot be re"):
        digest_files(frames)


def test_frames_are_read_one_at_a_time_and_let_go(tmp_path):
    """Memory is constant: only the current sample is alive."""
    alive = weakref.WeakSet()
    counts = []

    class ResultWriter:
        suffix = ".txt"

        def prepare(self, sample):
            return BenchFrame(sample, None)

        def store(self, path, prediction):
            del prediction
            gc.collect()
            counts.append(len(alive))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text("")

        def finished(self, folder):
            del folder
            return frozenset()

    dataset = open_dataset(PACKAGED_FRAMES)
    frame = dataset[0]

    class Many:
        sample_ids = tuple(f"{number:06}" for number in range(60))

        def __len__(self):
            return len(self.sample_ids)

        def __getitem__(self, index):
            points = frame.points[:50].clone()
            alive.add(points)
            return replace(frame, sample_id=self.sample_ids[index], points=points)

    class Blind(Oracle):
        def __call__(self, sample):
            return sample.sample_id

    method_run = MethodRun(predictor=Blind(), cases=LEVELS.cases[:1], folder=tmp_path)
    gc.collect()
    gc.freeze()  # objects of before are not looked at again, frame by frame
    try:
        done = predict_in_cases(
            Many(), [method_run], ResultWriter(), seed=0, workers=1, description=""
        )
    finally:
        gc.unfreeze()
    assert (done.written, done.skipped) == (60, 0)
    assert max(counts) <= 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"suite": "dgfn8"}, "perhaps dgfn7"),
        ({"cases": ("camera_blan",)}, "perhaps camera_blank is meant"),
        ({"seed": -1}, "seed must not be negative"),
        ({"workers": 0}, "workers must be at least 1"),
        ({"picture_px": 20}, "picture_px must be between 100 and 4000, got 20"),
        ({"shown": "000009"}, "frame 000009 to draw is none of the run's: perhaps"),
        ({"sample_list": ("000007",)}, "has no frame 000007"),
        ({"baseline": "nothing.json"}, "nothing.json"),
    ],
)
def test_invalid_settings_are_refused_before_anything_is_done(tmp_path, settings, message):
    with pytest.raises((ValueError, OSError), match=re.escape(message)):
        detect(tmp_path / "out", **settings)
    assert not (tmp_path / "out").exists()


def test_a_method_of_another_sensor_is_not_taken_for_one_sensors(depth_run, tmp_path):
    lidar = depth_run[1] / "robustness.json"
    with pytest.raises(
        ValueError, match=r"in case lidar_\S+, which leaves the camera sound, so it"
    ):
        run(tmp_path / "out", healthy={"camera": lidar})
    assert not (tmp_path / "out").exists()
    report = run(tmp_path / "out", method="nearest", cases=("clean",), healthy={"lidar": lidar})
    assert list(report.healthy) == ["lidar"]


def test_records_that_do_not_compare_are_refused_before_anything_is_done(
    depth_run, oracle_run, tmp_path
):
    other = str(depth_run[1] / "robustness.json")
    record = oracle_run[1] / "robustness.json"
    with pytest.raises(ValueError, match="the baseline adaptive is of task depth-completion"):
        detect(tmp_path / "out", baseline=other)
    with pytest.raises(ValueError, match="the baseline oracle is of suite levels instead of dgfn7"):
        detect(tmp_path / "out", suite="dgfn7", baseline=str(record))
    with pytest.raises(ValueError, match="of seed 3 instead of 4"):
        detect(tmp_path / "out", seed=4, baseline=str(record))
    with pytest.raises(ValueError, match="of frames 2 instead of 1"):
        detect(tmp_path / "out", sample_list=("000001",), baseline=str(record))
    with pytest.raises(ValueError, match="the healthy camera's adaptive is of task depth"):
        detect(tmp_path / "out", healthy={"camera": depth_run[1] / "robustness.json"})
    few = json.loads(record.read_text())
    del few["cases"]["camera_blank"], few["scores"]["camera_blank"]
    (tmp_path / "few.json").write_text(json.dumps(few))
    with pytest.raises(ValueError, match="has no scores of case camera_blank"):
        detect(tmp_path / "out", baseline=str(tmp_path / "few.json"))
    few["scores"]["clean"] = {}
    (tmp_path / "few.json").write_text(json.dumps(few))
    with pytest.raises(ValueError, match=r"has no Car_bbox_0\.7_moderate_R40 of case clean"):
        detect(tmp_path / "out", baseline=str(tmp_path / "few.json"))
    (tmp_path / "few.json").write_text('{"task": 1}')
    with pytest.raises(ValueError, match="is no record of a robustness run"):
        detect(tmp_path / "out", baseline=str(tmp_path / "few.json"))
    assert not (tmp_path / "out").exists()


def test_a_folder_of_another_run_is_refused(oracle_run):
    _, out = oracle_run
    with pytest.raises(ValueError, match="made with method oracle instead of other"):
        detect(out, method="other")
    with pytest.raises(ValueError, match="made with seed 3 instead of 4"):
        detect(out, seed=4)


def test_a_folder_is_refused_in_words_where_files_or_the_list_of_frames_changed(tmp_path):
    data, out = tmp_path / "data", tmp_path / "out"
    shutil.copytree(PACKAGED_FRAMES, data)
    detect(out, data=data, cases=(), sample_list=["000000"])
    other = "with another list of frames, files of the data set that had other names or sizes "
    with pytest.raises(ValueError, match=other):
        detect(out, data=data, cases=(), sample_list=["000001"])
    label = data / "training/label_2/000000.txt"
    label.write_text(label.read_text().replace("Car ", "Truck "))
    with pytest.raises(ValueError, match=r"made with files of the data set .* labels, .*; name an"):
        detect(out, data=data, cases=(), sample_list=["000000"])
    shutil.rmtree(out)
    detect(out, data=data, cases=(), sample_list=["000000"])


def test_a_class_in_place_of_a_predictor_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(OracleTask, "predictor", lambda *_, **__: Oracle)
    with pytest.raises(ValueError, match="the predictor is the class Oracle, expected an object"):
        detect(tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore:.*no images. their size is guessed")
def test_data_without_the_part_that_a_case_breaks_are_refused_by_the_case(tmp_path):
    shutil.copytree(PACKAGED_FRAMES / "training", tmp_path / "data" / "training")
    shutil.rmtree(tmp_path / "data" / "training" / "image_2")
    with pytest.raises(ValueError, match=r"case camera_dead_pixels-1 needs images: .* image_2 "):
        run_bench(DEPTH, tmp_path / "data", tmp_path / "out", ADAPTIVE, method="adaptive")
    assert not (tmp_path / "out").exists()
    settings = replace(ADAPTIVE, cases=("lidar_blank",))
    report = run_bench(DEPTH, tmp_path / "data", tmp_path / "out", settings, method="adaptive")
    assert set(report.record.scores) == {"clean", "lidar_blank"}


@pytest.mark.filterwarnings("ignore:.*no images. their size is guessed")
def test_a_lidar_without_a_camera_can_be_put_to_faults_of_its_own(tmp_path):
    for part in ("velodyne", "calib"):
        shutil.copytree(PACKAGED_FRAMES / "training" / part, tmp_path / "data" / "training" / part)
    settings = replace(ADAPTIVE, cases=("lidar_blank",))
    report = run_bench(DEPTH, tmp_path / "data", tmp_path / "out", settings, method="nearest")
    assert report.record.scores["clean"]["rmse_mm"] > 0


def test_corruptions_of_a_frame_do_not_depend_on_the_parts_that_a_method_uses():
    """For example, fog in an image becomes denser with the depth from the sweep."""
    settings = {"sample_list": None, "velodyne": "velodyne"}
    for parts in ({"image"}, {"points"}):
        sample = open_frames(PACKAGED_FRAMES, parts, LEVELS.cases[:1], **settings)[0]
        assert None not in (sample.image, sample.points, sample.objects)
        assert sample.depth is None  # `sightline corrupt` does not look at it either


def test_data_without_labels_cannot_be_scored(tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    (data / "testing").symlink_to(PACKAGED_FRAMES / "training")
    with pytest.raises(ValueError, match="no labels to score detections against"):
        detect(tmp_path / "out", data=data)


def test_the_labels_of_a_recording_are_scored_against_like_those_of_a_tree(tmp_path):
    recording = write_recording(tmp_path / "recording", ("000000",))
    (recording / "labels").mkdir()
    shutil.copy(LABELS / "000000.txt", recording / "labels")
    cases, sample_list = ("camera_blank",), ("000000",)
    settings = {"suite": "dgfn7", "cases": cases, "sample_list": sample_list}
    own = detect(tmp_path / "own", data=recording, **settings).record.scores
    assert own == detect(tmp_path / "kitti", **settings).record.scores
    assert own["clean"]["Car_bbox_0.5_moderate_all_points"] == 100
    assert own["camera_blank"] != own["clean"]


@pytest.mark.parametrize("name", task_names())
def test_every_task_has_a_scoring(name):
    scoring = find_task(name).scoring()
    assert isinstance(scoring, Scoring)
    assert isinstance(find_task(name), bench.BenchTask)
    names = [metric.name for metric in scoring.metrics]
    assert len(set(names)) == len(names) > 0
