"""The table and figures of the course on two-stage detection, by tiny networks and by results."""

import json
import os
import shutil
import time
from pathlib import Path

import pytest
import torch
from rich.console import Console

from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb
from sightline.data.open import open_dataset
from sightline.detection3d.detector import propose
from sightline.detection3d.files import read_detections
from sightline.detection3d.suppression import suppress_boxes
from sightline.detection3d.sweeps import network_sweep, to_kitti_frame
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import LOOSE
from sightline.papers import two_stage as module
from sightline.papers.two_stage import reproduce_two_stage
from sightline.papers.two_stage_figures import CURVES, FRAME, PROPOSALS, REGIONS, SCENES, TRAINING
from sightline.papers.two_stage_rows import IOUS, PUBLISHED
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection3d.frames import COMPACT, without_refinement, write_network

LABELS = PACKAGED_FRAMES / "training" / "label_2"


@pytest.fixture
def weights(tmp_path):
    write_network(tmp_path / "tiny.safetensors")
    return tmp_path / "tiny.safetensors"


@pytest.fixture
def results(tmp_path, monkeypatch):
    """Result files with every second labelled object; the path is short, so that tables hold it."""
    monkeypatch.chdir(tmp_path)
    folder = Path("results")
    folder.mkdir()
    for path in LABELS.iterdir():
        lines = [each for each in path.read_text().splitlines() if not each.startswith("DontCare")]
        (folder / path.name).write_text("".join(f"{line} 0.9\n" for line in lines[::2]))
    return folder


def text(report):
    console = Console(width=180)
    with console.capture() as captured:
        console.print(report.table())
    return captured.get()


def rows(report, start):
    return [line for line in text(report).splitlines() if line.strip().startswith(start)]


def levels(values):
    return " ".join(f"{value:6.2f}" for value in values)


def test_without_data_the_published_result_stands_alone():
    report = reproduce_two_stage()
    assert levels(PUBLISHED) in rows(report, "baseline (problem 1), published")[0]
    assert "needs --improved WEIGHTS" in rows(report, "improved (problem 2), ours")[0]
    assert "Not measured: ours, without --data KITTI and weights." in text(report)
    with pytest.raises(ValueError, match="name KITTI's object tree with --data"):
        reproduce_two_stage(None, {"first": "detection3d-best"})


def test_result_files_are_scored_at_both_overlaps_in_a_row_of_their_own(results):
    report = reproduce_two_stage(PACKAGED_FRAMES, {"improved": results})
    needed, own = rows(report, "improved (problem 2), ours")
    assert "needs --improved WEIGHTS" in needed
    assert "not the paper's: results" in own
    entries = report.rows["improved"].entries
    for iou, overlaps in ((0.5, {"overlaps": LOOSE}), (0.7, {})):
        scored = evaluate_objects(results, LABELS, **overlaps)
        expected = [e for e in scored.entries if (e.class_name, e.metric) == ("Car", "3d")]
        found = [entries[iou][e.difficulty].ap_r11 for e in expected]
        assert found == [e.ap_r11 for e in expected]
        assert levels(found) in text(report)
    assert max(entries[0.5]["hard"].max_recall, 0) > 0
    saved = json.loads(json.dumps(report.to_json()))
    assert saved["ours"]["baseline"] is None
    assert saved["ours"]["improved"]["is_papers"] is False
    assert saved["published"]["baseline"]["0.5"]["ap_r11"] == list(PUBLISHED)


def test_the_first_stage_alone_is_its_proposals_without_overlaps(weights, tmp_path):
    out = tmp_path / "out"
    report = reproduce_two_stage(PACKAGED_FRAMES, {"first": weights}, out, workers=1)
    sample = open_dataset(PACKAGED_FRAMES)[0]
    network = module._load("first", weights).network
    assert network.second is None
    boxes, classes, scores, _ = propose(
        network, network_sweep(to_kitti_frame(sample), network.config.input)
    )[0]
    kept = suppress_boxes(boxes, scores, network.config.suppression, labels=classes)
    found = read_detections(out / "first" / f"{sample.sample_id}.txt", sample)
    assert len(found.scores) == len(kept) > 0
    torch.testing.assert_close(found.scores.float(), scores[kept], atol=1e-3, rtol=0)
    assert "tiny, first stage alone: points, " in text(report).replace("\n", " ")


def test_a_damaged_file_of_its_own_is_to_be_removed_which_mends_the_run(weights, tmp_path):
    out = tmp_path / "out"

    def run(given):
        return reproduce_two_stage(PACKAGED_FRAMES, {"first": given}, out, workers=1)

    before = text(run(weights))
    path = out / "first" / "000001.txt"
    path.write_text(path.read_text()[:60])
    with pytest.raises(ValueError, match=r"line 1 has \d+ fields, .*; remove it and run the same"):
        run(weights)
    with pytest.raises(ValueError, match="; add "):  # results that the user made
        run(out / "first")
    path.unlink()
    assert text(run(weights)) == before


def test_results_of_its_own_that_are_older_than_their_frames_are_to_be_removed(weights, tmp_path):
    data, out = shutil.copytree(PACKAGED_FRAMES, tmp_path / "data"), tmp_path / "out"
    reproduce_two_stage(data, {"first": weights}, out, workers=1)
    later_ns = time.time_ns() + 10**10
    os.utime(data / "training" / "velodyne" / "000001.bin", ns=(later_ns, later_ns))
    told = f"1 changed after the result, .*; to make them anew, remove {out / 'first'}$"
    with pytest.warns(UserWarning, match=told):
        reproduce_two_stage(data, {"first": weights}, out, workers=1)


def test_rows_of_the_course_are_filled_by_its_own_networks_alone(weights, tmp_path, monkeypatch):
    given = {"first": weights, "baseline": weights}

    def described(paper):
        monkeypatch.setattr(module, "COURSE", paper)
        return {row: module._describe(row, module._load(row, weights)) for row in module.NAMES}

    assert not any(each.is_papers for each in described(module.COURSE).values())
    config = module._load("baseline", weights).network.config
    as_course = described(config)
    assert as_course["first"].is_papers
    assert as_course["baseline"].is_papers
    assert as_course["improved"].departures == ("the baseline's second stage",)
    report = reproduce_two_stage(PACKAGED_FRAMES, given, tmp_path / "out", workers=1)
    assert "needs --baseline" not in text(report)
    assert "tiny: points and refinement" in rows(report, "baseline (problem 1), ours")[0]
    compact = tmp_path / "compact.safetensors"
    write_network(compact, COMPACT)
    assert (
        "with pillars" in module._describe("improved", module._load("improved", compact)).departures
    )


def test_weights_without_a_second_stage_are_no_second_stage(tmp_path):
    path = tmp_path / "alone.safetensors"
    write_network(path, without_refinement())
    for row in ("baseline", "improved"):
        with pytest.raises(ValueError, match=f"alone has no second stage, as --{row} needs"):
            reproduce_two_stage(PACKAGED_FRAMES, {row: path}, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_draws_curves_and_a_frame(results, tmp_path, capsys):
    figures, report = tmp_path / "figures", tmp_path / "report.json"
    command = ["reproduce", "two-stage", "--data", str(PACKAGED_FRAMES), "--json", str(report)]
    command += ["--improved", str(results), "--figures", str(figures)]
    assert main([*command, "--figure-frame", "000001"]) == 0
    names = (*(CURVES.format(iou=iou) for iou in IOUS), FRAME)
    printed = capsys.readouterr()
    assert printed.err == ""
    assert printed.out.splitlines()[-3:] == [str(figures / name) for name in names]
    for name in names:
        assert read_rgb(figures / name).std() > 10
    saved = json.loads(report.read_text())
    assert saved["frames"] == 2
    assert saved["not_drawn"] == [
        "curves and scenes of the training, without --run",
        "regions and proposals, without weights",
    ]
    assert {path.name for path in figures.iterdir()} == set(names)


def test_the_command_draws_the_report_on_problem_1_from_weights_and_a_run(
    weights, tmp_path, capsys
):
    figures, report, run = tmp_path / "figures", tmp_path / "report.json", tmp_path / "run"
    run.mkdir()
    (run / "metrics.csv").write_text("step,training/total\n1,2.5\n2,1.5\n")
    command = ["reproduce", "two-stage", "--data", str(PACKAGED_FRAMES), "--json", str(report)]
    command += ["--first", str(weights), "--figures", str(figures), "--run", str(run)]
    command += ["--out", str(tmp_path / "out"), "--engine", "torch", "--workers", "1"]
    assert main([*command, "--training-frame", "000001"]) == 0
    printed = capsys.readouterr().out.splitlines()
    names = (TRAINING, REGIONS, PROPOSALS, *(CURVES.format(iou=iou) for iou in IOUS), FRAME)
    assert printed[-len(names) :] == [str(figures / name) for name in names]
    saved = json.loads(report.read_text())
    assert [each["sample_id"] for each in saved["regions"]] == ["000000", "000001"]
    assert all(len(each["box"]) == 7 and each["num_inside"] > 0 for each in saved["regions"])
    assert saved["not_drawn"] == [
        f"precision curves: {run} has logged no validation",
        f"scenes of the training: {run} has logged no pictures of a validation",
    ]
    assert not (figures / SCENES.format(number=0)).exists()


def test_a_run_without_figures_is_refused(results, tmp_path):
    with pytest.raises(ValueError, match="name a folder with --figures"):
        reproduce_two_stage(PACKAGED_FRAMES, {"improved": results}, run=tmp_path)
