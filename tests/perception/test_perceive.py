"""All tasks over a data set: files, lines, resuming, absent sensors."""

import json
import os

import pytest
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.open import open_dataset
from sightline.inference.predict import predict
from sightline.perception import kept_lines
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import find_task
from tests.inference.trees import contents_of
from tests.perception.predictors import one_box, perceiver, sparse_depth

FOLDERS = ("depth-completion", "detection2d")


def lines_of(out):
    lines = (out / "perception.jsonl").read_text().splitlines()
    return {line["frame"]: line for line in map(json.loads, lines)}


def results_of(out):
    """Bytes of all result files by folder, and of the lines."""
    folders = {name: contents_of(out / name) for name in FOLDERS}
    return folders, (out / "perception.jsonl").read_bytes()


def test_its_files_are_those_that_predict_writes_manifest_and_all(data, out, tmp_path):
    done = perceive(data, out, perceiver=perceiver())
    assert (done.written, done.skipped) == (4, 0)
    assert done.predicted == {"depth-completion": 4, "detection2d": 4}
    for name, predictor in perceiver().predictors.items():
        predict(find_task(name), predictor, data, tmp_path / name, workers=1)
        assert contents_of(out / name) == contents_of(tmp_path / name)
        again = predict(find_task(name), predictor, data, out / name, workers=1)
        assert (again.written, again.skipped) == (0, 4)


def test_shipped_networks_give_the_files_that_predict_writes(tmp_path):
    weights = {"detection2d": "detection2d-fast-cpu", "depth-completion": "depth-fast-cpu"}
    loaded = MultiTaskPredictor.load(weights | {"detection3d": None}, threads=1)
    perceive(PACKAGED_FRAMES, tmp_path / "out", perceiver=loaded, sample_list=["000001"])
    for name, chosen in weights.items():
        task = find_task(name)
        predictor = task.predictor(weights=chosen, threads=1)
        predict(task, predictor, PACKAGED_FRAMES, tmp_path / name, sample_list=["000001"],
                workers=1)  # fmt: skip
        assert contents_of(tmp_path / "out" / name) == contents_of(tmp_path / name)
    (line,) = lines_of(tmp_path / "out").values()
    assert {each["class"] for each in line["detections2d"]} <= {"Car", "Pedestrian", "Cyclist"}
    assert max(each["score"] for each in line["detections2d"]) > 0.5
    assert 2 < line["depth"]["nearest_m"] < line["depth"]["median_m"] < line["depth"]["farthest_m"]


def test_earlier_names_of_predictions_still_work_with_a_warning(data, out):
    sample = open_dataset(data, parts=("image", "points"))[0]
    with pytest.warns(DeprecationWarning, match="answer is now predict_by_task"):
        predictions = perceiver().answer(sample)
    assert predictions.by_task.keys() == {"depth-completion", "detection2d"}
    done = perceive(data, out, perceiver=perceiver())
    with pytest.warns(DeprecationWarning, match="answered is now predicted"):
        assert done.answered == done.predicted


def test_a_frame_is_loaded_once_for_all_tasks(data, out, monkeypatch):
    loaded = []
    original = KittiObjectDataset.__getitem__

    def counting(self, index):
        loaded.append(index)
        return original(self, index)

    monkeypatch.setattr(KittiObjectDataset, "__getitem__", counting)
    perceive(data, out, perceiver=perceiver())
    assert loaded == [0, 1, 2, 3]


def test_a_line_holds_the_predictions(data, out):
    perceive(data, out, perceiver=perceiver())
    line = lines_of(out)["000002"]
    depth = line.pop("depth")
    timed = [json.loads(each) for each in (out / "timings.jsonl").read_text().splitlines()]
    assert [each["frame"] for each in timed] == ["000000", "000001", "000002", "000003"]
    assert timed[2]["milliseconds"].keys() == {"depth-completion", "detection2d"}
    assert all(time >= 0 for each in timed for time in each["milliseconds"].values())
    assert line == {
        "frame": "000002",
        "timestamp_s": None,
        "image_size_px": [24, 32],
        "sensors": {"camera": True, "lidar": True},
        "num_points": 200,
        "tasks": {"depth-completion": {"by": "sparse"}, "detection2d": {"by": "one-box"}},
        "objects": None,
        "detections2d": [{"class": "Car", "score": 0.8, "box_px": [1.0, 2.0, 5.0, 12.0]}],
        "detections3d": None,
    }
    assert depth["valid_share"] > 0.05
    assert 5 <= depth["nearest_m"] < depth["median_m"] < depth["farthest_m"] <= 45
    assert depth["median_expected_error_m"] == pytest.approx(0.1 * depth["median_m"], abs=1e-3)


@pytest.mark.filterwarnings("ignore:.*there are no .* of 4 frames")
def test_only_tasks_that_can_work_without_a_missing_sensor_predict(data, out):
    (data / "training" / "image_2" / "000001.png").unlink()
    (data / "training" / "velodyne" / "000002.bin").unlink()
    done = perceive(data, out, perceiver=perceiver())
    assert done.predicted == {"depth-completion": 3, "detection2d": 4}
    lines = lines_of(out)
    assert lines["000001"]["sensors"] == {"camera": False, "lidar": True}
    assert lines["000001"]["detections2d"][0]["score"] == 0.4
    assert lines["000002"]["sensors"] == {"camera": True, "lidar": False}
    assert lines["000002"]["tasks"]["depth-completion"] == {"by": "sparse", "lacks": ["points"]}
    assert (lines["000002"]["depth"], lines["000002"]["num_points"]) == (None, None)
    assert not (out / "depth-completion" / "000002.png").exists()
    assert (out / "detection2d" / "000002.txt").exists()
    again = perceive(data, out, perceiver=perceiver())
    assert (again.written, again.skipped) == (0, 4)


def test_a_job_that_is_stopped_goes_on_where_it_was(data, out, tmp_path):
    def stopping(sample):
        if sample.sample_id == "000002":
            raise KeyboardInterrupt
        return one_box(sample)

    with pytest.raises(KeyboardInterrupt):
        perceive(data, out, perceiver=perceiver(boxes=stopping))
    assert sorted(contents_of(out / "lines")) == ["000000.json", "000001.json"]
    assert not (out / "perception.jsonl").exists()
    done = perceive(data, out, perceiver=perceiver())
    assert (done.written, done.skipped) == (2, 2)
    perceive(data, tmp_path / "whole", perceiver=perceiver())
    assert results_of(out) == results_of(tmp_path / "whole")


def test_kept_results_of_frames_that_were_changed_since_are_told(data, out):
    perceive(data, out, perceiver=perceiver())
    later_ns = (out / "lines/000003.json").stat().st_mtime_ns + 10**9
    os.utime(data / "training/image_2/000001.png", ns=(later_ns, later_ns))
    told = "of 4 frames whose results are kept, 1 changed after .* the first is 000001: .*overwr"
    with pytest.warns(UserWarning, match=told):
        perceive(data, out, perceiver=perceiver())
    assert perceive(data, out, perceiver=perceiver(), overwrite=True).written == 4


@pytest.mark.parametrize("lost", ["lines/000001.json", "detection2d/000001.txt"])
def test_what_is_lost_or_damaged_is_made_anew(data, out, lost):
    perceive(data, out, perceiver=perceiver())
    before = results_of(out)
    if lost.endswith(".json"):
        whole = (out / lost).read_text()
        (out / lost).write_text(whole[: len(whole) // 2])
    else:
        (out / lost).unlink()
    done = perceive(data, out, perceiver=perceiver())
    assert (done.written, done.skipped) == (1, 3)
    assert results_of(out) == before
    assert perceive(data, out, perceiver=perceiver(), overwrite=True).written == 4


@pytest.mark.parametrize("forged", ["1", "[]", '{"tasks": 1}', '{"tasks": {"detection2d": 1}}'])
def test_a_line_of_other_content_is_made_anew(data, out, forged):
    perceive(data, out, perceiver=perceiver())
    before = results_of(out)
    (out / "lines" / "000001.json").write_text(forged)
    assert perceive(data, out, perceiver=perceiver()).written == 1
    assert results_of(out) == before


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_a_shard_that_ends_while_another_writes_keeps_its_lines(data, out, monkeypatch):
    write, text_of_shard = kept_lines.atomic_write_text, []

    def overtaken(path, text):  # the other shard runs between this one's reading and writing
        if path.name == "perception.jsonl" and not text_of_shard:
            text_of_shard.append(text)
            perceive(data, out, perceiver=perceiver(), shard_index=1, num_shards=2)
        write(path, text)

    monkeypatch.setattr(kept_lines, "atomic_write_text", overtaken)
    perceive(data, out, perceiver=perceiver(), shard_index=0, num_shards=2)
    assert len(text_of_shard[0].splitlines()) == 2
    assert len(lines_of(out)) == 4


@pytest.mark.filterwarnings("error")
def test_lines_that_another_shard_writes_after_the_reading_are_not_missed(data, out, monkeypatch):
    join = kept_lines._join_timings

    def overtaken(folder):  # the other shard writes its lines after these were joined
        monkeypatch.setattr(kept_lines, "_join_timings", join)
        perceive(data, out, perceiver=perceiver(), shard_index=1, num_shards=2)
        return join(folder)

    monkeypatch.setattr(kept_lines, "_join_timings", overtaken)
    perceive(data, out, perceiver=perceiver(), shard_index=0, num_shards=2)
    assert len(lines_of(out)) == 4


def test_lines_that_were_removed_meanwhile_are_told(data, out, monkeypatch):
    def joined(folder):
        (folder / "lines" / "000001.json").unlink()
        return kept_lines.join_lines(folder)

    monkeypatch.setattr("sightline.perception.perceive.join_lines", joined)
    with pytest.raises(
        ValueError, match=r"lacks the lines of 1 of 4 frames, 000001: .*run the same"
    ):
        perceive(data, out, perceiver=perceiver())
    monkeypatch.undo()
    assert perceive(data, out, perceiver=perceiver()).written == 1


def test_workers_and_shards_change_nothing(data, out, tmp_path):
    perceive(data, out, perceiver=perceiver(), workers=2)
    parts = [
        perceive(data, tmp_path / "parts", perceiver=perceiver(), shard_index=i, num_shards=3)
        for i in (0, 1, 2)
    ]
    assert [part.written for part in parts] == [2, 1, 1]
    assert results_of(out) == results_of(tmp_path / "parts")


def test_frames_of_an_earlier_list_stay_in_the_lines(data, out):
    perceive(data, out, perceiver=perceiver(), sample_list=["000003"])
    done = perceive(data, out, perceiver=perceiver(), sample_list=["000000"])
    assert done.predicted == {"depth-completion": 1, "detection2d": 1}
    assert list(lines_of(out)) == ["000000", "000003"]


def test_other_weights_or_other_tasks_do_not_mix(data, out):
    perceive(data, out, perceiver=perceiver())
    with pytest.raises(
        ValueError, match=r"out holds files made with .*sparse.* instead of .*other"
    ):
        perceive(data, out, perceiver=perceiver(depth_name="other"))
    alone = MultiTaskPredictor({"detection2d": perceiver().predictors["detection2d"]})
    with pytest.raises(ValueError, match=r"out holds files made with .*depth-completion"):
        perceive(data, out, perceiver=alone)


def test_further_outputs_are_written_if_requested(data, out):
    perceive(data, out, perceiver=perceiver(), all_outputs=True)
    assert "000003.png" in contents_of(out / "depth-completion-uncertainty")
    assert not (out / "detection2d-gates").exists()  # its predictor gives none


def test_a_predictor_that_changes_its_sample_changes_it_for_no_other(data):
    def in_place(sample):
        sample.points[:, 2] += 1.73
        sample.image[:] = 0
        return one_box(sample)

    sample = open_dataset(data)[0]
    tasks = perceiver(boxes=in_place).predictors
    turned = MultiTaskPredictor(dict(reversed(tasks.items())))
    expected = perceiver()(sample).depth
    assert torch.equal(turned(sample).depth.depth_m, expected.depth_m)
    assert sample == open_dataset(data)[0]


def test_a_bad_frame_is_named_in_one_line(data, out):
    (data / "training" / "velodyne" / "000001.bin").write_bytes(b"123")
    with pytest.raises(ValueError, match=r"^sample 000001: [^\n]*000001\.bin[^\n]*$"):
        perceive(data, out, perceiver=perceiver())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"video": "v.mp4", "num_shards": 2}, "a shard cannot make the whole video"),
        ({"video": "v.avi"}, r"expected a name that ends in \.mp4"),
        ({"video": "v.mp4", "fps": 0.0}, "a video of 0.0 frames per second"),
        ({"video": "v.mp4", "fps": 0.0001}, "a video of 0.0001 frames per second"),
        ({"video": "v.mp4", "min_score": 2.0}, "min_score must be between 0 and 1, .* got 2.0"),
        ({"video": f"{__file__}/v.mp4"}, r"v\.mp4 cannot be written: .*\.py is no folder"),
        ({"rerun": "r.mp4"}, r"expected a name that ends in \.rrd"),
        ({"workers": 0}, "workers must be at least 1"),
    ],
)
def test_invalid_settings_are_refused_before_any_work(data, out, settings, message):
    with pytest.raises(ValueError, match=message):
        perceive(data, out, perceiver=perceiver(), **settings)
    assert not out.exists()


def test_nothing_is_written_into_the_data_set(data):
    with pytest.raises(ValueError, match="would change the data set"):
        perceive(data, data / "all", perceiver=perceiver())
    assert not (data / "all").exists()


@pytest.mark.parametrize("option", ["video", "rerun"])
def test_pictures_that_cannot_be_written_are_refused_before_any_work(data, out, tmp_path, option):
    if option == "rerun":
        pytest.importorskip("rerun")
    path = tmp_path / {"video": "v.mp4", "rerun": "r.rrd"}[option]
    path.mkdir()
    with pytest.raises(ValueError, match="cannot be written: it is no regular file"):
        perceive(data, out, perceiver=perceiver(), **{option: path})
    assert not out.exists()


def test_no_tasks_and_unknown_ones_are_refused():
    everything = dict.fromkeys(("detection2d", "detection3d", "depth-completion"), "none")
    with pytest.raises(ValueError, match="all tasks are left out; use at least one of"):
        MultiTaskPredictor.load(everything)
    with pytest.raises(ValueError, match="there is no task tarot"):
        MultiTaskPredictor.load({"tarot": "deck"})


def test_a_method_without_a_network_can_be_named():
    loaded = MultiTaskPredictor.load(
        {"depth-completion": "nearest", "detection2d": None, "detection3d": "none"}
    )
    assert {name: each.name for name, each in loaded.predictors.items()} == {
        "depth-completion": "nearest"
    }


@pytest.mark.filterwarnings("ignore:.*there are no .* of 4 frames")
def test_a_video_and_a_rerun_file_are_made_of_the_results(data, out, tmp_path):
    pytest.importorskip("rerun")
    (data / "training" / "image_2" / "000000.png").unlink()
    video, scene = tmp_path / "v.mp4", tmp_path / "r.rrd"
    perceive(data, out, perceiver=perceiver(), video=video, rerun=scene)
    import cv2
    from rerun.chunk import RrdReader

    reader = cv2.VideoCapture(str(video))
    frames = []
    while (read := reader.read())[0]:
        frames.append(read[1])
    assert len(frames) == 4
    assert (frames[0].astype(int) - frames[1]).std() > 1  # no camera, then one
    assert "/lidar/points" in {chunk.entity_path for chunk in RrdReader(scene).stream()}


def test_the_predictions_of_a_blank_frame_are_lines_without_depths(data, out):
    def nothing(sample):
        depth = sparse_depth(sample)
        return type(depth)(
            depth_m=torch.zeros_like(depth.depth_m), valid=torch.zeros_like(depth.valid)
        )

    perceive(data, out, perceiver=perceiver(nothing), sample_list=["000000"])
    assert lines_of(out)["000000"]["depth"] == {
        "valid_share": 0.0,
        "guessed_share": 0.0,
        "nearest_m": None,
        "median_m": None,
        "farthest_m": None,
        "median_expected_error_m": None,
    }
