"""Result files read back, and drawn beside their frames."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.detection3d.files import write_results
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.perception.perceive import perceive
from sightline.perception.results import open_results, read_perception
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D, Perception
from tests.inference.trees import write_object_tree
from tests.perception.predictors import perceiver, sparse_depth


@pytest.fixture
def data(tmp_path):
    return write_object_tree(tmp_path / "data", 3)


@pytest.fixture
def results(data, tmp_path):
    perceive(data, tmp_path / "results", perceiver=perceiver(), all_outputs=True)
    return tmp_path / "results"


def test_results_that_are_there_twice_are_refused(data, results, tmp_path):
    perceive(data, tmp_path / "again", perceiver=perceiver())
    with pytest.raises(ValueError, match=r"results/\S+ and \S+again/\S+ both hold"):
        open_results([results, tmp_path / "again"])


def test_what_perceive_has_written_is_read_back(data, results):
    sample = open_dataset(data)[1]
    perception = read_perception(open_results([results]), sample)
    expected = sparse_depth(sample)
    assert perception.depth.depth_m.numpy() == pytest.approx(expected.depth_m.numpy(), abs=1 / 512)
    measured = expected.depth_m > 0
    error_m = perception.depth.uncertainty_m
    assert error_m[measured].numpy() == pytest.approx(
        expected.uncertainty_m[measured].numpy(), abs=1 / 512
    )
    assert error_m[~measured].isinf().all()
    assert torch.equal(perception.depth.valid, expected.valid)
    assert perception.detections2d.class_names == ("Car",)
    assert perception.detections2d.boxes.tensor.tolist() == [[1.0, 2.0, 4.0, 12.0]]
    assert perception.detections3d is None


def test_expected_errors_alone_are_refused(data, results):
    sample = open_dataset(data)[1]
    folder = results / "depth-completion-uncertainty"
    with pytest.raises(ValueError, match=r"000001\.png holds expected errors of a depth map"):
        read_perception(open_results([folder]), sample)
    both = open_results([folder, results / "depth-completion"])  # in any order
    assert read_perception(both, sample).depth.uncertainty_m is not None


def test_results_of_another_image_size_are_refused(results):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    with pytest.raises(ValueError, match=r"000000\.png is 24x32 .* expected 375x1242"):
        read_perception(open_results([results]), sample)


def test_files_of_others_are_recognised_by_their_suffix(tmp_path):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    boxes = Boxes3D(torch.tensor([[15.0, 1.0, -0.8, 4.0, 1.7, 1.5, 0.2]]))
    found = Detections3D(class_names=("Car",), boxes=boxes, scores=torch.tensor([0.75]))
    write_results(tmp_path / f"{sample.sample_id}.txt", sample, found)
    perception = read_perception(open_results([tmp_path]), sample)
    assert perception.detections3d.boxes.tensor.numpy() == pytest.approx(
        boxes.tensor.numpy(), abs=0.02
    )
    assert perception.detections3d.scores.tolist() == [0.75]
    assert len(perception.detections2d.boxes) == 1
    assert perception.depth is None


def test_results_in_the_folder_data_are_told(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "000000.txt").touch()
    with pytest.raises(ValueError, match=r"they are in .*/data, as KITTI's own program writes"):
        open_results([tmp_path])


@pytest.mark.parametrize("folder", ["nowhere", "empty"])
def test_folders_without_results_are_refused(tmp_path, folder):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"is no folder|holds no results that can be drawn"):
        open_results([tmp_path / folder])


def test_one_frame_is_a_page_and_several_are_one_sheet(data, results, tmp_path, capsys):
    one, several = tmp_path / "one.png", tmp_path / "several.png"
    drawn = ["--results", str(results)]
    assert main(["show", str(data), "000001", "--out", str(one), *drawn]) == 0
    assert main(["show", str(data), "000000", "000002", "--out", str(several), *drawn]) == 0
    assert capsys.readouterr().out.split() == [str(one), str(several)]
    assert read_rgb(one).shape[1] == 1900
    page = read_rgb(several)
    half = page.shape[0] // 2
    assert page.shape[1] > 1000
    assert not np.array_equal(page[:half], page[half:])


def test_true_depth_of_an_object_tree_is_drawn_as_the_errors_of_a_prediction(data, tmp_path):
    pages = []
    for name in ("without", "with"):
        assert main(["show", str(data), "000001", "--out", str(tmp_path / f"{name}.png")]) == 0
        pages.append(read_rgb(tmp_path / f"{name}.png"))
        folder = data / "training" / "depth"
        folder.mkdir(exist_ok=True)
        true_depth = sparse_depth(open_dataset(data)[1]).depth_m.numpy()
        write_depth_png(folder / "000001.png", true_depth)
    assert not np.array_equal(*pages)


def test_results_of_other_data_are_drawn_with_one_warning(data, results, tmp_path):
    moved = data.rename(tmp_path / "moved")
    words = ["show", str(moved), "000001", "--out", str(tmp_path / "one.png")]
    with pytest.warns(UserWarning, match="made from .*/data, not from .*/moved; check") as warned:
        assert main([*words, "--results", str(results)]) == 0
    assert len(warned) == 1


def test_unsure_detections_are_not_drawn(data, results, tmp_path):
    pages = []
    for score in ("0.7", "0.9"):  # the box has 0.8
        path = tmp_path / f"{score}.png"
        words = ["show", str(data), "000001", "--out", str(path), "--min-score", score]
        assert main([*words, "--results", str(results)]) == 0
        pages.append(read_rgb(path))
    assert not np.array_equal(*pages)


LABELS = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"


def as_results(change, scale=1.0):
    """Result lines of a packaged frame's labels, changed, each with a score of its own."""
    rows = [line.split() for line in LABELS.read_text().splitlines() if "DontCare" not in line]
    scored = [(change(row[:15]), scale * (0.9 - 0.01 * place)) for place, row in enumerate(rows)]
    return "".join(f"{' '.join(row)} {score:.4f}\n" for row, score in scored), len(rows)


def show_lines(tmp_path, text, data=PACKAGED_FRAMES):
    folder = tmp_path / "found"
    folder.mkdir(exist_ok=True)
    (folder / "000000.txt").write_text(text)
    words = ["show", str(data), "000000", "--results", str(folder)]
    return main([*words, "--out", str(tmp_path / "picture.png")])


def test_objects_that_are_not_drawn_are_counted(tmp_path, capsys):
    text, count = as_results(list)
    assert show_lines(tmp_path, text) == 0
    assert "drawn" not in capsys.readouterr().err
    first = text.splitlines(keepends=True)[0]
    assert show_lines(tmp_path, text + f"{first.rsplit(' ', 1)[0]} 0.1\n") == 0
    told = (
        f"sightline: {count} of {count + 1} 3D boxes drawn, those with a score of 0.3 or more (--m"
    )
    assert told in capsys.readouterr().err
    assert show_lines(tmp_path, as_results(list, scale=0.2)[0]) == 0
    told = (
        f"sightline: 0 of {count} 2D boxes drawn: the highest score is 0.18, give --min-score below"
    )
    assert told in capsys.readouterr().err


def _with_sizes(row):
    x1, y1, x2, y2 = map(float, row[4:8])
    return [*row[:6], f"{x2 - x1:.2f}", f"{y2 - y1:.2f}", *row[8:]]


def _by_centres(row):
    return [*row[:12], f"{float(row[12]) - float(row[8]) / 2:.2f}", *row[13:]]


@pytest.mark.parametrize(
    ("change", "scale", "with_labels", "told"),
    [
        (list, 100.0, False, "found: scores of results reach 90 and are probably percent"),
        (lambda row: [*row[:14], "45.0"], 1.0, False, "results have angles beyond two pi, probab"),
        (_with_sizes, 1.0, True, "2D boxes of results are probably x_min, y_min, width, height"),
        (_by_centres, 1.0, True, "their y is probably that of the centre"),
    ],
)
def test_result_files_of_another_convention_are_doubted(tmp_path, change, scale, with_labels, told):
    data = shutil.copytree(PACKAGED_FRAMES, tmp_path / "data")
    if not with_labels:
        shutil.rmtree(data / "training" / "label_2")
    with pytest.warns(UserWarning, match=told):
        assert show_lines(tmp_path, as_results(change, scale)[0], data) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["000001", "--results", "RESULTS", "--task", "detection2d"], "--results needs no task"),
        (["000001", "--results", "DATA"], "holds no results that can be drawn"),
        (["000009", "--results", "RESULTS"], "000009"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(data, results, capsys, words, message):
    given = {"RESULTS": str(results), "DATA": str(data)}
    assert main(["show", str(data), *(given.get(word, word) for word in words)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_a_folder_without_a_result_of_the_frame_is_told(data, results, tmp_path):
    (results / "detection2d" / "000001.txt").unlink()
    words = ["show", str(data), "000001", "--results", str(results), "--out"]
    with pytest.warns(UserWarning, match="detection2d has no result of frame 000001") as told:
        assert main([*words, str(tmp_path / "picture.png")]) == 0
    assert len(told) == 1


def test_a_frame_without_results_is_refused(data, results, capsys):
    (results / "detection2d" / "000001.txt").unlink()
    (results / "depth-completion" / "000001.png").unlink()
    (results / "depth-completion-uncertainty" / "000001.png").unlink()
    assert main(["show", str(data), "000001", "--results", str(results)]) == 2
    assert f"{results} has no result of frame 000001" in capsys.readouterr().err


def test_the_first_of_several_perceptions_wins():
    boxes = Boxes2D(torch.zeros(1, 4))
    first, second = (
        Perception(
            detections2d=Detections2D(
                class_names=(name,), boxes=boxes, scores=torch.tensor([score])
            )
        )
        for name, score in (("Car", 0.2), ("Van", 0.9))
    )
    depth_m = torch.ones(2, 3)
    third = Perception(depth=DepthMap(depth_m=depth_m, valid=depth_m > 0))
    joined = Perception.joined([first, second, third])
    assert joined.detections2d.class_names == ("Car",)
    assert joined.depth is third.depth
    assert joined.filter_by_score(0.2).detections2d.class_names == ("Car",)
    filtered = dataclasses.replace(joined, detections3d=None).filter_by_score(0.3)
    assert filtered.detections2d.class_names == ()


def test_joined_objects_are_drawn_as_results_of_both_detectors(data, results):
    (results / "joined").mkdir()
    line = "Car -1 -1 0 1 2 4 12 1.5 1.6 3.9 0 1.6 12 -1.5 0.9\n"
    (results / "joined" / "000001.txt").write_text(line)
    manifest = {"job": "perceive", "data": "a/data", "velodyne": "velodyne", "models": {}}
    (results / "joined" / "sightline.json").write_text(json.dumps(manifest))
    opened = open_results([results / "joined"])
    assert {each.data for each in opened} == {"a/data"}
    perception = read_perception(opened, open_dataset(data)[1])
    assert perception.detections2d.boxes.tensor.tolist() == [[1.0, 2.0, 4.0, 12.0]]
    assert perception.detections3d.class_names == ("Car",)


def test_packed_results_are_drawn_as_those_of_files(data, tmp_path):
    shards = tmp_path / "shards"
    write_shards(data, shards, frames_per_shard=2)
    other = ["--detection2d", "none", "--detection3d", "none", "--workers", "1"]
    perceive = ["perceive", str(shards), "--depth-completion", "nearest", *other]
    predict = ["predict", "depth-completion", str(shards), "--method", "nearest", "--workers", "1"]
    for name, command in (("a", perceive), ("b", predict)):
        assert main([*command, str(tmp_path / name)]) == 0
        assert main([*command, str(tmp_path / f"{name}-packed"), "--pack"]) == 0
    folders = ["a", "a-packed", "a-packed/depth-completion", "b", "b-packed", "b-packed/000000.tar"]
    pictures = set()
    for folder in folders:
        out = tmp_path / "out.png"
        arguments = ["show", str(shards), "000001", "--results", str(tmp_path / folder)]
        assert main([*arguments, "--out", str(out)]) == 0
        pictures.add(out.read_bytes())
    assert len(pictures) == 1


def test_packed_boxes_are_read_back(data, results, tmp_path):
    write_shards(results, tmp_path / "packed", frames_per_shard=2)
    sample = open_dataset(data)[1]
    perception = read_perception(open_results([tmp_path / "packed"]), sample)
    assert perception.detections2d.boxes.tensor.tolist() == [[1.0, 2.0, 4.0, 12.0]]
