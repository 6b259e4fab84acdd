"""Result files of other detectors for the cases from `sightline corrupt`."""

import json
import math
import os
import re
import shutil
import time
from dataclasses import replace

import pytest

from sightline.corruptions import suites
from sightline.corruptions.generate import corrupt_dataset
from sightline.data.formats.image_header import read_image_size
from sightline.data.open import open_dataset
from sightline.depth_completion.registration import TASK as DEPTH
from sightline.detection2d.registration import TASK as DETECTION2D
from sightline.detection3d.registration import TASK as DETECTION3D
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.compare import Comparison
from sightline.robustness.frames import digest_files
from sightline.robustness.record import read_record
from sightline.robustness.results import score_results
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.robustness.runs import LEVELS
from tests.robustness.tasks import Oracle, OracleTask

SETTINGS = BenchSettings(workers=1)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Cases from `corrupt`, result files of a method, and its report from the bench."""
    folder = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(suites.SUITES, "levels", LEVELS)
        cases = folder / "cases"
        corrupt_dataset(PACKAGED_FRAMES, cases, suite="levels", seed=3, workers=1)
        out = folder / "run"
        settings = replace(SETTINGS, suite="levels", seed=3)
        report = run_bench(OracleTask(), PACKAGED_FRAMES, out, settings, method="oracle")
        yield cases, out / "answers", report


def test_the_same_files_have_the_same_scores_wherever_they_come_from(written, tmp_path):
    cases, found, report = written
    settings = replace(SETTINGS, baseline=str(found.parent / "robustness.json"))
    theirs = score_results(OracleTask(), cases, found, tmp_path / "out", settings)
    assert theirs.record.scores == report.record.scores
    assert theirs.record.setting == report.record.setting
    assert theirs.record.method == "answers"
    errors = [each.ce for _, measures in theirs.measured if measures
              for each in measures.kinds.values()]  # fmt: skip
    assert {round(error, 9) for error in errors if error is not None} == {1.0}


def test_one_frame_is_drawn_as_each_case_has_it_with_what_was_found(written, tmp_path):
    cases, found, _ = written
    few = tmp_path / "few"
    shutil.copytree(cases, few)
    shutil.rmtree(few / "lidar_blank" / "training" / "image_2")
    shutil.rmtree(few / "lidar_blank" / "training" / "velodyne")
    settings = replace(SETTINGS, shown="000001", picture_px=300)
    out = tmp_path / "out"
    score_results(OracleTask(), few, found, out, settings)
    drawn = {path.parent.name: path for path in (out / "pictures").glob("*/*.jpg")}
    assert set(drawn) == {each.name for each in LEVELS.cases} - {"lidar_blank"}
    assert read_image_size(drawn["camera_blank"])[1] == 300
    page = (out / "report.html").read_text()
    assert page.count("data:image/jpeg") == 3  # sound, dead pixels, blank
    with pytest.raises(ValueError, match="picture_px 300 instead of 400"):
        score_results(OracleTask(), few, found, out, replace(settings, picture_px=400))
    with pytest.raises(ValueError, match="frame 7 to draw is none of the run's"):
        score_results(OracleTask(), few, found, out, replace(settings, shown="7"))


def test_result_files_of_both_detectors_read_back_for_pictures(tmp_path):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    path = tmp_path / "000000.txt"
    path.write_text(Oracle()(replace(sample, objects=None)))
    count = len(path.read_text().splitlines())
    assert len(DETECTION2D.scoring().read(path, sample).detections.scores) == count
    assert len(DETECTION3D.scoring().read(path, sample).scores) == count
    path.write_text("")
    assert len(DETECTION3D.scoring().read(path, sample).scores) == 0


def test_the_files_of_the_frames_are_known_where_the_clean_case_has_them(written, tmp_path):
    cases, found, report = written
    digest = report.record.setting.files_digest
    assert digest == digest_files(open_dataset(cases / "clean"))
    other = tmp_path / "other"
    shutil.copytree(cases / "clean", other)
    with (other / "training" / "velodyne" / "000001.bin").open("ab") as file:
        file.write(bytes(16))
    assert digest_files(open_dataset(other)) != digest
    shutil.copytree(cases, tmp_path / "few", ignore=shutil.ignore_patterns("clean"))
    theirs = score_results(OracleTask(), tmp_path / "few", found, tmp_path / "out", SETTINGS)
    assert theirs.record.setting.files_digest is None


def test_results_that_changed_are_scored_again(written, tmp_path):
    cases, found, _ = written
    mine = tmp_path / "mine"
    shutil.copytree(found, mine)
    before = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    (mine / "camera_blank" / "000001.txt").write_text("")
    after = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    name = "Car_bbox_0.7_hard_all_points"
    assert after.record.scores["camera_blank"][name] < before.record.scores["camera_blank"][name]
    assert after.record.scores["clean"] == before.record.scores["clean"]


def test_scores_of_answers_that_were_changed_later_are_repeated(written, tmp_path):
    _, _, before = written
    folder = tmp_path / "run"
    shutil.copytree(written[1].parent, folder)
    answer = folder / "answers" / "camera_blank" / "000001.txt"
    answer.write_text("")
    later = time.time() + 10
    os.utime(answer, (later, later))
    settings = replace(SETTINGS, suite="levels", seed=3)
    after = run_bench(OracleTask(), PACKAGED_FRAMES, folder, settings, method="oracle")
    name = "Car_bbox_0.7_hard_all_points"
    assert after.record.scores["camera_blank"][name] < before.record.scores["camera_blank"][name]
    assert after.record.scores["clean"] == before.record.scores["clean"]


def test_a_damaged_answer_of_the_run_is_to_be_removed_and_given_results_mended(written, tmp_path):
    cases, found, _ = written
    folder = shutil.copytree(found.parent, tmp_path / "run")
    answer = folder / "answers" / "camera_blank" / "000001.txt"
    answer.write_text("Car 0 0")
    later = time.time() + 10
    os.utime(answer, (later, later))
    settings = replace(SETTINGS, suite="levels", seed=3)
    with pytest.raises(ValueError, match=r"line 1 has 3 fields, .*; remove it and run the same"):
        run_bench(OracleTask(), PACKAGED_FRAMES, folder, settings, method="oracle")
    with pytest.raises(ValueError, match=r"line 1 has 3 fields, .*; add "):
        score_results(OracleTask(), cases, answer.parents[1], tmp_path / "out", SETTINGS)


def test_what_cannot_be_scored_is_refused_before_anything_is_done(written, tmp_path):
    cases, found, _ = written
    out, mine, other = (tmp_path / name for name in ("out", "mine", "other"))
    shutil.copytree(found, mine)
    (mine / "camera_blank" / "000001.txt").unlink()
    shutil.copytree(cases, other)
    manifest = json.loads((cases / "sightline.json").read_text())
    manifest["cases"]["camera_dead_pixels-1"]["share"] = [0.2, 0.2]
    (other / "sightline.json").write_text(json.dumps(manifest))
    task = OracleTask()
    for given, message in (
        ((task, cases, mine, SETTINGS), "no result file for 1 of 2 frames, the first is 000001"),
        ((task, PACKAGED_FRAMES, found, SETTINGS), "is no output of `sightline corrupt`"),
        ((task, other, found, SETTINGS), "written with another case camera_dead_pixels-1"),
        ((task, cases, cases, SETTINGS), "has no result file for 2 of 2 frames"),
        ((task, cases, found, replace(SETTINGS, suite="dgfn7")), "with suite levels, not dgfn7"),
        ((task, cases, found, replace(SETTINGS, seed=4)), "with seed 3, not 4"),
        (
            (task, cases, found, replace(SETTINGS, velodyne="velodyne_reduced")),
            "with velodyne velodyne, not velodyne_reduced; leave --velodyne out",
        ),
        ((task, cases, found, replace(SETTINGS, cases=("fog",))), "suite levels has no case 'fog'"),
        (
            (task, cases, found, replace(SETTINGS, baseline="weights")),
            "must be a run's folder or its robustness.json",
        ),
        ((DEPTH, cases, found, SETTINGS), "results of other methods cannot be scored"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            score_results(given[0], given[1], given[2], out, given[3])
    (mine / "lidar_blank").rename(mine / "data")
    (mine / "lidar_blank").mkdir()
    (mine / "data").rename(mine / "lidar_blank" / "data")
    with pytest.raises(ValueError, match=r"they are in .*/lidar_blank/data, as KITTI's own prog"):
        score_results(task, cases, mine, out, replace(SETTINGS, cases=("lidar_blank",)))
    shutil.rmtree(mine / "lidar_blank")
    with pytest.raises(ValueError, match="has no folder lidar_blank"):
        score_results(task, cases, mine, out, replace(SETTINGS, cases=("lidar_blank",)))
    assert not out.exists()


def test_labels_that_differ_between_cases_are_told(written, tmp_path):
    cases, found, _ = written
    mixed = tmp_path / "cases"
    shutil.copytree(cases, mixed)
    label = mixed / "camera_blank" / "training" / "label_2" / "000001.txt"
    label.write_text(label.read_text().replace("Car ", "Van "))
    (mixed / "lidar_blank" / "training" / "label_2" / "000001.txt").unlink()  # no other one
    told = "scores of all cases are by these labels, but those of camera_blank differ in 1 frames"
    with pytest.warns(UserWarning, match=told):
        score_results(OracleTask(), mixed, found, tmp_path / "out", SETTINGS)


def test_an_output_folder_among_the_results_is_refused(written, tmp_path):
    cases, found, _ = written
    shutil.copytree(found, tmp_path / "found")
    with pytest.raises(ValueError, match=r"run is inside the results, .*name an output folder els"):
        score_results(OracleTask(), cases, tmp_path / "found", tmp_path / "found/run", SETTINGS)


def test_cases_without_results_are_left_out_with_a_note(written, tmp_path):
    cases, found, report = written
    mine = tmp_path / "mine"
    shutil.copytree(found, mine)
    shutil.rmtree(mine / "camera_blank")
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    assert theirs.absent_cases == ("camera_blank",)
    expected = {name: s for name, s in report.record.scores.items() if name != "camera_blank"}
    assert theirs.record.scores == expected
    written_json = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert written_json["absent_cases"] == ["camera_blank"]
    some = tmp_path / "some"
    shutil.copytree(cases, some)
    for path in some.glob("camera_dead_pixels-[12]"):
        shutil.rmtree(path)
        shutil.rmtree(mine / path.name)
    few = score_results(OracleTask(), some, mine, tmp_path / "few", SETTINGS)
    assert set(few.absent_cases) == {"camera_blank", "camera_dead_pixels-1", "camera_dead_pixels-2"}
    assert few.notes()[0].endswith(": camera_blank, and 2 that are not in the folder of cases.")
    for path in mine.iterdir():
        if path.name != "clean":
            shutil.rmtree(path)
    with pytest.raises(ValueError, match="has a folder clean and none of a broken case"):
        score_results(OracleTask(), cases, mine, tmp_path / "none", SETTINGS)
    shutil.rmtree(mine / "clean")
    with pytest.raises(ValueError, match="no folder clean for the results of sound sensors"):
        score_results(OracleTask(), cases, mine, tmp_path / "none", SETTINGS)
    assert not (tmp_path / "none").exists()


def test_few_objects_are_noted_beside_the_scores(written):
    _, _, report = written
    assert any("use that one" in note for note in report.notes())
    assert report.absent_cases == ()


def test_labels_without_an_object_are_told_beside_the_scores(tmp_path):
    tree = shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    for path in (tree / "training" / "label_2").iterdir():
        path.write_text("")
    (note,) = DETECTION2D.scoring().notes(open_dataset(tree))
    assert note.startswith("WARNING: no label is of a scored class (Car, Pedestrian, Cyclist)")


def _rewrite(folder, change, cases=None):
    """Change every line of the result files, in all cases or some."""
    for path in folder.glob("*/*.txt"):
        if cases is None or path.parent.name in cases:
            lines = (change(line.split()) for line in path.read_text().splitlines())
            path.write_text("".join(f"{' '.join(line)}\n" for line in lines))


def _as_vehicles(fields):
    return ["Vehicle", *fields[1:]]


def _flat(fields):
    return [*fields[:8], *("-1",) * 3, *("-1000",) * 3, "-10", fields[15]]


@pytest.mark.parametrize(
    ("change", "cases", "said"),
    [
        (
            _as_vehicles,
            None,
            r"WARNING: nothing can be found in all 6 cases, as clean: (\d+) of \1 results "
            r"were left out: their classes are not scored \(Vehicle \1; Car, .* are\)\.",
        ),
        (
            _as_vehicles,
            ("camera_blank",),
            r"WARNING: nothing can be found in case camera_blank: (\d+) of \1 results were left",
        ),
        (
            _flat,
            ("camera_blank", "lidar_blank"),
            r"nothing can be found in cases camera_blank, lidar_blank, with the numbers of the "
            r"first: (\d+) of \1 results of scored classes have no 3D part: .*\. Such scores say",
        ),
    ],
)
def test_results_that_cannot_match_are_told_with_their_cases(
    written, tmp_path, change, cases, said
):
    corrupted, found, report = written
    mine = shutil.copytree(found, tmp_path / "mine")
    _rewrite(mine, change, cases)
    theirs = score_results(OracleTask(), corrupted, mine, tmp_path / "out", SETTINGS)
    (note,) = set(theirs.record.notes) - set(report.record.notes)
    assert re.search(said, note)
    assert note in read_record(tmp_path / "out").notes
    assert "nothing can be found" in (tmp_path / "out" / "report.html").read_text()
    compared = Comparison(records=(read_record(tmp_path / "out"), report.record))
    assert any(line.endswith(f": {note}") for line in compared.notes())


def _ranked(fields):
    """A score of its own for each result."""
    return [*fields[:15], f"0.{round(float(fields[4]) * 100):06d}"]


def _by_centres(fields):
    y = float(fields[12]) - float(fields[8]) / 2
    return [*_ranked(fields)[:12], f"{y:.2f}", *_ranked(fields)[13:]]


def _with_sizes(fields):
    x1, y1, x2, y2 = map(float, fields[4:8])
    return [*_ranked(fields)[:6], f"{x2 - x1:.2f}", f"{y2 - y1:.2f}", *_ranked(fields)[8:]]


def _in_degrees(fields):
    return [
        *_ranked(fields)[:14],
        f"{math.degrees(float(fields[14]) + 9):.1f}",
        *_ranked(fields)[15:],
    ]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda fields: [*fields[:15], "1.0"], r"all \d+ scores of results are 1: nothing ranks"),
        (
            lambda fields: [*fields[:15], f"9{_ranked(fields)[15][2:5]}e-2"],
            "probably percent: KITTI",
        ),
        (
            _by_centres,
            "lie 0.50 of their height above those of labels: their y is probably that of",
        ),
        (_with_sizes, "2D boxes of results are probably x_min, y_min, width, height: read so"),
        (_in_degrees, "angles beyond two pi, probably degrees: they were taken for radians"),
    ],
)
def test_files_of_broken_sensors_that_no_sensor_can_make_are_told_with_their_case(
    written, tmp_path, change, said
):
    cases, found, _ = written
    mine = shutil.copytree(found, tmp_path / "mine")
    _rewrite(mine, _ranked)
    sound = score_results(OracleTask(), cases, mine, tmp_path / "sound", SETTINGS)
    assert not any("WARNING" in note for note in sound.record.notes)
    _rewrite(mine, change, ("lidar_blank",))
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    (note,) = set(theirs.record.notes) - set(sound.record.notes)
    assert re.match(rf"WARNING: in case lidar_blank, and not in case clean: .*{said}", note)
    assert note.endswith("No faulty sensor causes this: correct the files, and run this again.")
    _rewrite(mine, change)
    everywhere = score_results(OracleTask(), cases, mine, tmp_path / "all", SETTINGS)
    assert not any("not in case clean" in note for note in everywhere.record.notes)
    assert any(re.search(said, note) for note in everywhere.record.notes)


def test_a_blank_camera_that_gives_each_frame_the_same_box_is_no_fault_of_the_files(
    written, tmp_path
):
    cases, found, _ = written
    mine = shutil.copytree(found, tmp_path / "mine")
    _rewrite(mine, _ranked)
    line = (mine / "clean" / "000000.txt").read_text().splitlines()[0]
    for path in (mine / "camera_blank").iterdir():
        path.write_text("".join(f"{line} \n" for _ in range(4)))
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    assert not any("not in case clean" in note for note in theirs.record.notes)


def test_some_results_that_are_left_out_and_files_of_no_frame_are_told(written, tmp_path):
    cases, found, report = written
    mine = shutil.copytree(found, tmp_path / "mine")
    (mine / "lidar_blank" / "000009.txt").write_text("")
    lines = (mine / "clean" / "000000.txt").read_text().splitlines(keepends=True)
    with (mine / "clean" / "000000.txt").open("a") as file:
        file.write(lines[0].replace(lines[0].split()[0], "Bus"))
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    classes, files = theirs.record.notes[:2]
    assert re.fullmatch(r"In case clean: 3 of \d+ results were left out: .*Bus 1, .*", classes)
    assert files == (
        "In case lidar_blank: 1 result files were left out: no frame has their name (the first is "
        "000009.txt)."
    )
    assert theirs.record.notes[2:] == report.record.notes


def test_sound_results_and_a_case_without_any_raise_no_doubt(written, tmp_path):
    cases, found, report = written
    assert not any("nothing can" in note or "left out" in note for note in report.record.notes)
    mine = shutil.copytree(found, tmp_path / "mine")
    for path in (mine / "camera_blank").iterdir():
        path.write_text("")
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    assert theirs.record.notes == report.record.notes
    for path in (mine / "clean").iterdir():
        path.write_text("")
    theirs = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    assert any("of sound sensors hold no object at all" in note for note in theirs.record.notes)
