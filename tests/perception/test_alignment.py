"""Rotation of the LiDAR in its mount, undone by `perceive` in each frame of a recording."""

import dataclasses
import json
import os

import pytest
import torch

from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionResult
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.alignment_by_boxes import turn_by_boxes
from sightline.joining.models import read_models
from sightline.perception import frame_work
from sightline.perception import perceive as perceive_module
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.perception.results import open_results, read_perception
from sightline.perception.show import ResultSource, write_frames_picture
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from tests.inference.trees import contents_of
from tests.joining.scenes import detections2d, detections3d
from tests.perception.predictors import FunctionPredictor

CAR = ("Car", 0.9, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
SEEN = ("Car", 0.8, (550.0, 170.0, 640.0, 240.0))
ANGLES = {"yaw_deg": 1.0, "pitch_deg": 0.0, "roll_deg": 0.0}


@pytest.fixture(autouse=True)
def repeated_frames(monkeypatch):
    """Let frames that are repeated count as if each showed another scene."""
    monkeypatch.setattr("sightline.joining.recording.distinct_scenes", list)


class Recording:
    """Frames in memory, opened in the place of a data set."""

    def __init__(self, samples):
        self.samples = [
            dataclasses.replace(sample, sample_id=f"{number:06d}")
            for number, sample in enumerate(samples)
        ]
        self.sample_ids = [sample.sample_id for sample in self.samples]
        self.velodyne = "velodyne"

    def __len__(self):
        return len(self.samples)

    def __getitem__(self, index):
        return self.samples[index]


@pytest.fixture(scope="module")
def packaged():
    dataset = open_dataset(PACKAGED_FRAMES)
    return [dataset[index % 2] for index in range(6)]


@pytest.fixture
def opened(monkeypatch):
    """Let `perceive` open frames in memory."""

    def opened_as(samples):
        recording = Recording(samples)
        for name, given in (
            ("open_dataset", lambda *_, **__: recording),
            ("warn_of_missing_sensors", lambda *_, **__: None),
        ):
            monkeypatch.setattr(perceive_module, name, given)
        monkeypatch.setattr(frame_work, "has_file", lambda *_: True)
        return recording

    return opened_as


def perceiver(digests=None):
    """Two detectors that find the same car in every frame, with the models' weights."""
    digests = digests or list(read_models().provenance["sha256"].values())
    made_by = [{"weights_sha256": digest} for digest in digests]
    seen = DetectionResult(detections=detections2d(SEEN))
    return MultiTaskPredictor(
        {
            "detection2d": FunctionPredictor(
                lambda _: seen, "image", ("image", "points"), (), ("results",), made_by[0]
            ),
            "detection3d": FunctionPredictor(
                lambda _: detections3d(CAR), "sweep", ("points",), ("points",), ("results",),
                made_by[1],
            ),
        }
    )  # fmt: skip


def lines_of(out):
    return [json.loads(line) for line in (out / "perception.jsonl").read_text().splitlines()]


@pytest.mark.filterwarnings("error")
def test_a_sound_recording_gives_the_files_of_one_that_is_not_measured(packaged, opened, tmp_path):
    opened(packaged)
    perceive("data", tmp_path / "measured", perceiver=perceiver())
    perceive("data", tmp_path / "not", perceiver=perceiver(), align=False)
    folders = sorted(each.name for each in (tmp_path / "not").iterdir() if each.is_dir())
    assert folders == ["detection2d", "detection3d", "joined", "joined-3d", "lines", "timings"]
    for folder in folders[:-1]:
        measured, as_given = (contents_of(tmp_path / name / folder) for name in ("measured", "not"))
        assert measured == as_given
    assert "alignment" not in json.loads((tmp_path / "measured" / "sightline.json").read_text())


def test_a_turned_lidar_is_undone_in_all_files_and_told(packaged, opened, tmp_path):
    recording = opened([rotate_extrinsics(each, 1.0 - 0.13) for each in packaged])
    with pytest.warns(UserWarning, match=r"the LiDAR is turned .*\(yaw (0.9|1).* deg\): undone; "):
        perceive("data", tmp_path / "out", perceiver=perceiver())
    turns = [line["undone_turn"] for line in lines_of(tmp_path / "out")]
    assert turns == [turns[0]] * 6
    assert turns[0] == pytest.approx(ANGLES, abs=0.1)
    corrected = [undo_turn(each, LidarTurn(**turns[0])) for each in recording.samples]
    opened(corrected)
    perceive("data", tmp_path / "corrected", perceiver=perceiver(), align=False)
    for folder in ("detection3d", "joined", "joined-3d"):
        first = (tmp_path / "out" / folder / "000003.txt").read_bytes()
        assert first == (tmp_path / "corrected" / folder / "000003.txt").read_bytes()
    told = (
        r"out holds files made with alignment yaw_deg .* instead .*; or leave --align no out, or "
    )
    with pytest.raises(ValueError, match=f"{told}overwrite all"):
        perceive("data", tmp_path / "out", perceiver=perceiver(), align=False)


def test_frames_that_were_taken_as_they_are_before_name_the_ways_to_add_more(
    packaged, opened, tmp_path, monkeypatch
):
    monkeypatch.setattr(perceive_module, "warn_of_newer_frames", lambda *_, **__: None)
    turned = [rotate_extrinsics(each, 1.0) for each in packaged]
    opened(turned[:2])  # too few to measure
    perceive("data", tmp_path / "out", perceiver=perceiver())
    opened(turned)
    told = r"made with alignment none instead of .*; or add --align no \(align=False\) to take all"
    with (
        pytest.warns(UserWarning, match="undone"),
        pytest.raises(ValueError, match=f"{told} frames as they are, or overwrite all .*anew"),
    ):
        perceive("data", tmp_path / "out", perceiver=perceiver())
    other = perceiver()
    other.predictors["detection3d"].made_by["weights"] = "other"
    with (
        pytest.warns(UserWarning, match="undone"),
        pytest.raises(ValueError, match=r"sightline\.json too$"),  # the rotation is not all
    ):
        perceive("data", tmp_path / "out", perceiver=other)
    assert perceive("data", tmp_path / "out", perceiver=perceiver(), align=False).skipped == 2


def test_overwriting_measures_the_rotation_anew(packaged, opened, tmp_path):
    opened([rotate_extrinsics(each, 1.0) for each in packaged])
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "out", perceiver=perceiver())
    opened(packaged)  # the calibration was corrected
    kept = contents_of(tmp_path / "out" / "lines")
    told = "undone; .* measured when this output was begun: to measure it anew, overwrite all its"
    with pytest.warns(UserWarning, match=told):  # as of the frames that stay
        perceive("data", tmp_path / "out", perceiver=perceiver(), num_shards=2, overwrite=True)
    assert contents_of(tmp_path / "out" / "lines").keys() == kept.keys()
    assert all(line["undone_turn"] for line in lines_of(tmp_path / "out"))
    perceive("data", tmp_path / "out", perceiver=perceiver(), overwrite=True)
    perceive("data", tmp_path / "new", perceiver=perceiver())
    for folder in ("detection3d", "joined", "lines"):
        found, expected = (contents_of(tmp_path / each / folder) for each in ("out", "new"))
        assert found == expected
    for folder in ("", "detection3d"):  # as where a run was killed between claims
        manifest = tmp_path / "out" / folder / "sightline.json"
        held = json.loads(manifest.read_text()) | {"alignment": {"yaw_deg": 1.0}}
        manifest.write_text(json.dumps(held, indent=2) + "\n")
        perceive("data", tmp_path / "out", perceiver=perceiver(), overwrite=True)
        assert "alignment" not in json.loads(manifest.read_text())
    other = perceiver()
    other.predictors["detection3d"].made_by["weights"] = "other"
    with pytest.raises(ValueError, match="holds files made with"):
        perceive("data", tmp_path / "out", perceiver=other, overwrite=True)


@pytest.mark.parametrize("number", [5, 4])
def test_where_frames_are_gone_the_rotation_is_held_and_told_as_such(
    packaged, opened, tmp_path, number
):
    opened([rotate_extrinsics(each, 1.0) for each in packaged])
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "out", perceiver=perceiver())
    opened(packaged[:number])  # their results may be another machine's
    told = "measured when this output was begun: .* overwrite all its frames in one run, or name an"
    with pytest.warns(UserWarning, match=told), pytest.warns(UserWarning, match="000005, are of"):
        perceive("data", tmp_path / "out", perceiver=perceiver(), overwrite=True)
    assert len(lines_of(tmp_path / "out")) == 6
    with pytest.raises(ValueError, match="once lines of frames that the data do not have are rem"):
        perceive("data", tmp_path / "out", perceiver=perceiver(), align=False, overwrite=True)
    for frame in range(number, 6):
        (tmp_path / "out" / "lines" / f"{frame:06d}.json").unlink()
    (tmp_path / "out" / "lines" / "._000000.json").write_text("of another system")
    perceive("data", tmp_path / "out", perceiver=perceiver(), align=False, overwrite=True)
    assert not any("undone_turn" in line for line in lines_of(tmp_path / "out"))


def test_workers_and_a_resumed_job_undo_the_same_rotation(packaged, opened, tmp_path, monkeypatch):
    turned = [rotate_extrinsics(each, 1.0) for each in packaged]
    opened(turned)
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "two", perceiver=perceiver(), workers=2)
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "parts", perceiver=perceiver(), num_shards=2)

    def measured_again(*_):
        raise AssertionError("the folder says it")

    monkeypatch.setattr(MultiTaskPredictor, "aligned", measured_again)
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "parts", perceiver=perceiver(), num_shards=2, shard_index=1)
    lines = [(tmp_path / name / "perception.jsonl").read_bytes() for name in ("two", "parts")]
    assert lines[0] == lines[1]


@pytest.mark.parametrize(("workers", "is_own"), [(1, True), (2, False)])
def test_several_workers_are_forked_from_a_process_in_which_no_network_has_run(
    packaged, opened, tmp_path, monkeypatch, workers, is_own
):
    def measured(self, _):
        (tmp_path / "process").write_text(str(os.getpid()))
        return MultiTaskPredictor(self.predictors, Alignment(turn=LidarTurn(yaw_deg=0.5)))

    monkeypatch.setattr(MultiTaskPredictor, "aligned", measured)
    opened(packaged)
    with pytest.warns(UserWarning, match=r"yaw 0.5"):
        perceive("data", tmp_path / "out", perceiver=perceiver(), workers=workers)
    assert (int((tmp_path / "process").read_text()) == os.getpid()) == is_own
    assert lines_of(tmp_path / "out")[0]["undone_turn"]["yaw_deg"] == 0.5


def test_an_aligned_perceiver_is_not_measured_again(packaged, opened, tmp_path):
    opened(packaged)
    given = MultiTaskPredictor(perceiver().predictors, Alignment(turn=LidarTurn(**ANGLES)))
    with pytest.warns(UserWarning, match=r"yaw 1 deg\): undone"):
        perceive("data", tmp_path, perceiver=given)
    assert lines_of(tmp_path)[0]["undone_turn"] == ANGLES


def test_frames_that_disagree_are_aligned_one_by_one(packaged, opened, tmp_path):
    given = [rotate_extrinsics(packaged[0], yaw) for yaw in (-1.5, -1.0, 0.0, 1.0, 1.5)]
    opened(given)
    with pytest.warns(UserWarning, match="the frames disagree on the LiDAR's rotation"):
        perceive("data", tmp_path / "joined", perceiver=perceiver())
    expected = turn_by_boxes(given[0], detections2d(SEEN), detections3d(CAR)).to_json()
    assert expected["yaw_deg"] > 1
    for line in lines_of(tmp_path / "joined"):
        assert line["undone_turn"] == expected
        assert len(line["objects"]) == 1
    with pytest.warns(UserWarning, match="objects are not joined"):
        perceive("data", tmp_path / "alone", perceiver=perceiver(["a", "b"]))
    assert all("undone_turn" not in line for line in lines_of(tmp_path / "alone"))


def test_a_pitch_by_edges_is_undone_only_if_both_detectors_boxes_overlap(packaged, monkeypatch):
    by_edges = LidarTurn(yaw_deg=0.3, pitch_deg=0.4)
    monkeypatch.setattr(
        "sightline.joining.recording.measure_alignment", lambda *_: Alignment(turn=by_edges)
    )
    both = perceiver(["a", "b"])  # weights that no models of joined scores know
    assert both.aligned(packaged).alignment.turn == by_edges
    for name, each in both.predictors.items():
        alone = MultiTaskPredictor({name: each})
        assert alone.aligned(packaged).alignment.turn == LidarTurn(yaw_deg=0.3)


def test_an_unreadable_frame_is_left_to_the_job(packaged):
    class Damaged(Recording):
        def __getitem__(self, index):
            if index == 2:
                raise ValueError("damaged")
            return super().__getitem__(index)

    turned = Damaged([rotate_extrinsics(each, 1.0) for each in packaged])
    found = perceiver().aligned(turned, AlignmentConfig(yaw_bias_deg=0.0))
    assert found.alignment.turn.yaw_deg == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("held", ['{"yaw_deg": "x"}', '{"other": 1}', "3", '{"yaw_deg": 1e999}'])
def test_an_edited_alignment_is_measured_anew_and_refused(packaged, opened, tmp_path, held):
    opened([rotate_extrinsics(each, 1.0) for each in packaged])
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path, perceiver=perceiver())
    manifest = tmp_path / "sightline.json"
    content = json.loads(manifest.read_text())
    manifest.write_text(json.dumps(content | {"alignment": json.loads(held)}, indent=2) + "\n")
    with (
        pytest.warns(UserWarning, match="undone"),
        pytest.raises(ValueError, match="holds files made with alignment"),
    ):
        perceive("data", tmp_path, perceiver=perceiver())


def test_pictures_and_reading_use_the_corrected_calibration(packaged, opened, tmp_path):
    frames = opened([rotate_extrinsics(each, 1.0) for each in packaged])
    with pytest.warns(UserWarning, match="undone"):
        perceive("data", tmp_path / "out", perceiver=perceiver(), video=tmp_path / "v.mp4")
    assert (tmp_path / "v.mp4").stat().st_size > 0
    found = read_perception(open_results([tmp_path / "out"]), frames[0])
    assert found.undone_turn.yaw_deg > 0.9
    car = torch.tensor(CAR[2:]).double()
    torch.testing.assert_close(found.detections3d.boxes.tensor[0], car, rtol=0, atol=0.02)


def test_show_draws_on_the_corrected_sample(tmp_path, monkeypatch):
    given = MultiTaskPredictor(perceiver().predictors, Alignment(turn=LidarTurn(**ANGLES)))
    with pytest.warns(UserWarning, match="undone"):
        perceive(PACKAGED_FRAMES, tmp_path / "out", perceiver=given)
    drawn = []

    def sheet(sample, *_, **__):
        drawn.append(sample)
        return torch.zeros(4, 4, 3, dtype=torch.uint8).numpy()

    monkeypatch.setattr("sightline.perception.show.frame_sheet", sheet)
    source = ResultSource([tmp_path / "out"])
    write_frames_picture(
        PACKAGED_FRAMES, ["000000"], tmp_path / "p.png", source=source, min_score=0.3
    )
    sound = open_dataset(PACKAGED_FRAMES)[0]
    expected = undo_turn(sound, LidarTurn(**ANGLES)).calibration.camera_from_lidar
    assert torch.equal(drawn[0].calibration.camera_from_lidar, expected)
