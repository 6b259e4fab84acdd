"""The exported folder, and the script of docs/guides/export.md that reads it, against Sightline."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.export.kept_files import onnx_file_of
from sightline.inference.network import load_network
from sightline.joining.export import DETECTION_2D, DETECTION_3D, joined_content
from sightline.joining.join import join_detections
from sightline.joining.models import COLUMNS, read_models
from sightline.joining.predictor import JoinedPredictor
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.export.test_scripts import SCRIPTS, files_of
from tests.joining.scenes import select

SAMPLE = open_dataset(PACKAGED_FRAMES)[0]
STATES = ("sound", "no returns", "black")


@pytest.fixture(autouse=True)
def _scripts(monkeypatch):
    pytest.importorskip("onnxruntime", reason="the extra `export` is not installed")
    monkeypatch.syspath_prepend(str(SCRIPTS))


def in_state(state):
    """A frame as the script reads it and as Sightline does."""
    from kitti_frame import read_frame

    frame = read_frame(*files_of(PACKAGED_FRAMES, SAMPLE.sample_id))
    if state == "no returns":
        frame = frame._replace(points=frame.points[:0])
        return frame, dataclasses.replace(SAMPLE, points=SAMPLE.points[:0])
    if state == "black":
        frame = frame._replace(rgb=np.zeros_like(frame.rgb))
        return frame, dataclasses.replace(SAMPLE, image=torch.zeros_like(SAMPLE.image))
    return frame, SAMPLE


def listed(found):
    boxes = found.boxes.tensor.double().numpy()
    return list(zip(found.class_names, found.scores.tolist(), boxes, strict=True))


def check_objects(found, expected):
    """Assert the same objects in the same order."""
    assert [each.name for each in found] == list(expected.class_names)
    assert [each.origin for each in found] == list(expected.origins)
    for ours, true, tolerance in (
        ([each.score for each in found], expected.scores, 1e-3),
        ([each.score3d for each in found], expected.scores3d, 1e-3),
        ([each.box for each in found], expected.boxes2d.tensor, 0.05),
        ([each.box3d for each in found], expected.boxes3d.tensor, 0.02),
    ):
        np.testing.assert_allclose(np.array(ours), true.numpy(), rtol=0, atol=tolerance)


@pytest.fixture(scope="module")
def detectors():
    return (
        DetectionPredictor.load("detection2d-fast-cpu"),
        Detection3DPredictor.load("detection3d-fast-cpu"),
    )


@pytest.mark.parametrize("state", STATES)
def test_boxes_are_joined_by_the_script_as_by_sightline(detectors, state):
    from joined_objects import join

    frame, sample = in_state(state)
    found2d, found3d = detectors[0](sample).detections, detectors[1](sample)
    expected = join_detections(sample, found2d, found3d, read_models())
    found = join(frame, listed(found2d), listed(found3d), json.loads(json.dumps(joined_content())))
    check_objects(found, expected)
    assert {each.origin for each in found} >= (
        {"measured"} if state != "no returns" else {"lifted"}
    )


def test_without_any_box_there_is_no_object():
    from joined_objects import join

    assert join(in_state("sound")[0], [], [], joined_content()) == []


def test_objects_by_the_script_from_the_exported_folder_are_sightlines(tmp_path):
    from joined_objects import join
    from kitti_frame import open_graph
    from onnx_joined import detect
    from refine_lifted import SecondStage

    pytest.importorskip("onnxscript", reason="the extra `export` is not installed")
    weights = read_models().provenance["weights"]
    for task in (DETECTION_2D, DETECTION_3D):
        for graph in task.graphs(load_network(task, weights[task.name])):
            name = f"{task.name}-{graph.name}" if graph.name else task.name
            (tmp_path / f"{name}.onnx").write_bytes(onnx_file_of(graph))
    (tmp_path / "joined.json").write_text(json.dumps(joined_content()))
    frame, sample = in_state("sound")
    predictor = JoinedPredictor.load()
    check_objects(detect(str(tmp_path), frame), predictor(sample).objects)

    found2d, found3d = predictor.detector2d(sample).detections, predictor.detector3d(sample)
    lost = found3d.class_names.index("Car")  # its image box is proposed in its place
    others = select(found3d, [index for index in range(len(found3d.scores)) if index != lost])
    refine = predictor.detector3d.refine_boxes
    expected = join_detections(sample, found2d, others, predictor.models, refine=refine)
    assert "refined" in expected.origins
    second = open_graph(str(tmp_path / "detection3d-refinement.onnx"), "detection3d", "points")
    stage = SecondStage(frame, *second)
    found = join(frame, listed(found2d), listed(others), joined_content(), stage)
    check_objects(found, expected)

    content = joined_content()
    content["provenance"]["sha256"]["detection2d"] = "of others"
    (tmp_path / "joined.json").write_text(json.dumps(content))
    with pytest.raises(SystemExit, match=r"^[^\n]*detection2d\.onnx is not of the weights of joi"):
        detect(str(tmp_path), frame)


@pytest.mark.parametrize("content", [None, "{", "{}", "[]", '{"provenance": 1}'])
def test_a_folder_of_something_else_is_refused_by_the_script_in_one_line(tmp_path, content):
    from onnx_joined import detect

    if content is not None:
        (tmp_path / "joined.json").write_text(content)
    with pytest.raises(SystemExit, match=r"^[^\n]* is no folder of `sightline export FOLDER"):
        detect(str(tmp_path), in_state("sound")[0])


def test_the_command_writes_a_folder_of_all_files(tmp_path, monkeypatch, capsys):
    exported = []

    def export(graphs, out, _):
        exported.extend(out.with_stem(f"{out.stem}-{each.name}" if each.name else out.stem)
                        for each in graphs)  # fmt: skip
        return {}

    monkeypatch.setattr("sightline.joining.export.export_graphs", export)
    out = tmp_path / "joined"
    assert main(["export", str(out), "--weights", "joined"]) == 0
    assert [path.name for path in exported] == [
        "detection2d.onnx", "detection3d-proposals.onnx", "detection3d-refinement.onnx",
    ]  # fmt: skip
    assert {path.parent for path in exported} == {out}
    content = json.loads((out / "joined.json").read_text())
    assert {name: tuple(each) for name, each in content["columns"].items()} == dict(COLUMNS)
    assert content["settings"]["min_iou"] == 0.5
    assert capsys.readouterr().out.splitlines()[-1] == str(out / "joined.json")


def test_a_file_in_the_folders_place_is_refused(tmp_path, capsys):
    Path(tmp_path / "file").write_text("mine")
    assert main(["export", str(tmp_path / "file"), "--weights", "joined"]) == 2
    assert "is no folder" in capsys.readouterr().err
