"""A layout that Sightline does not know: converted by the documents' script, or read by a class."""

import gzip
import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sightline.data import open as open_module
from sightline.data.check import check_tree
from sightline.data.checks.frame_checks import Findings, examine_image
from sightline.data.datasets.sample_dataset import NamedSubset
from sightline.data.datasets.sample_files import (
    has_file,
    label_file,
    list_sample_files,
    refuses_gaps,
)
from sightline.data.formats.image_file import read_rgb, write_rgb
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.data.open import open_dataset
from sightline.detection2d.registration import TASK as DETECTION_2D
from sightline.perception.perceive import perceive
from sightline.perception.results import open_results, read_perception
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample
from tests.perception.predictors import perceiver

PAGE = Path(__file__).parents[2] / "docs" / "recordings.md"
SCRIPT = re.findall(
    r"```python\n(.*?)```", PAGE.read_text().partition("\n## Another data set\n")[2], re.DOTALL
)[0]


def as_pose(matrix):
    turn = Rotation.from_matrix(matrix[:3, :3]).as_quat()
    place = dict(zip("xyz", matrix[:3, 3].tolist(), strict=True))
    return {"heading": dict(zip("xyzw", turn.tolist(), strict=True)), "position": place}


def write_other_layout(folder):
    """JPEG images, gzipped pickles of two LiDARs in the world's frame, poses in JSON."""
    camera, lidar = folder / "camera" / "front_camera", folder / "lidar"
    camera.mkdir(parents=True)
    lidar.mkdir()
    poses = {camera: [], lidar: []}
    for index, sample in enumerate(open_dataset(PACKAGED_FRAMES)):
        world_from_lidar = np.eye(4)
        world_from_lidar[:3, :3] = Rotation.from_euler("z", 0.3 + index).as_matrix()
        world_from_lidar[:3, 3] = 100 + index, -20, 3
        cloud = sample.points.double().numpy()
        cloud[:, :3] = cloud[:, :3] @ world_from_lidar[:3, :3].T + world_from_lidar[:3, 3]
        cloud[:, 3] *= 255
        rows = np.pad(np.repeat(cloud, 2, axis=0), ((0, 0), (0, 2)))  # a time, and the LiDAR
        rows[1::2, 5] = 1
        rows[1::2, :3] += 5
        (lidar / f"{index:02}.pkl.gz").write_bytes(gzip.compress(pickle.dumps(rows)))
        write_rgb(camera / f"{index:02}.jpg", sample.image.permute(1, 2, 0).numpy())
        camera_from_lidar = sample.calibration.camera_from_lidar.numpy()
        poses[lidar].append(as_pose(world_from_lidar))
        poses[camera].append(as_pose(world_from_lidar @ np.linalg.inv(camera_from_lidar)))
    for place, listed in poses.items():
        (place / "poses.json").write_text(json.dumps(listed))
    k = sample.calibration.image_from_camera
    pixels = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    text = json.dumps({name: float(value) for name, value in pixels.items()})
    (camera / "intrinsics.json").write_text(text)


def test_the_script_of_the_documents_writes_a_recording_of_the_same_frames(tmp_path, monkeypatch):
    write_other_layout(tmp_path / "001")
    monkeypatch.chdir(tmp_path)
    exec(SCRIPT, {})
    assert list(check_tree("drive")) == []
    written = open_dataset("drive")
    assert written.sample_ids == ("00", "01")
    for found, true in zip(written, open_dataset(PACKAGED_FRAMES), strict=True):
        torch.testing.assert_close(found.points, true.points, atol=1e-4, rtol=0)
        torch.testing.assert_close(
            found.calibration.camera_from_lidar, true.calibration.camera_from_lidar
        )
        assert found.image_size == true.image_size


def test_an_unknown_layout_names_the_way_to_convert_it(tmp_path):
    write_other_layout(tmp_path)
    with pytest.raises(ValueError, match=r"or make yours a recording \(docs/recordings.md\)"):
        open_dataset(tmp_path)


class SmallestDataset:
    """All that `open_dataset` and the commands need of a data set."""

    def __init__(self, folder):
        images = sorted(folder.glob("*.png"))
        self.frames = tuple(
            ObjectFrame(sample_id=each.stem, image=each, objects=self.labels(each))
            for each in images
        )

    @staticmethod
    def labels(image: Path) -> Path | None:
        path = image.with_suffix(".txt")
        return path if path.exists() else None

    @property
    def sample_ids(self) -> tuple[str, ...]:
        return tuple(frame.sample_id for frame in self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> CameraLidarSample:
        frame = self.frames[index]
        return CameraLidarSample.from_arrays(
            open_dataset(PACKAGED_FRAMES)[0].calibration,
            image=read_rgb(frame.image),
            sample_id=frame.sample_id,
        )

    def examine(self, frame: ObjectFrame) -> Findings:
        found = Findings()
        examine_image(frame.image, found)
        return found


def test_a_class_of_the_protocol_is_opened_and_its_first_frames_are_checked(tmp_path, monkeypatch):
    for name in ("a", "b"):
        write_rgb(tmp_path / f"{name}.png", np.zeros((375, 1242, 3), np.uint8))
    monkeypatch.setattr(open_module, "_open_drive", lambda path, *_, **__: SmallestDataset(path))
    with pytest.warns(UserWarning, match="images have a single colour") as warned:
        dataset = open_dataset(tmp_path, sample_list=["b"])
    assert len(warned) == 1
    assert dataset[0].sample_id == "b"
    assert has_file(dataset, 0, "image")
    assert not has_file(dataset, 0, "points")
    assert not refuses_gaps(dataset)
    assert label_file(dataset, 0) is None
    assert list_sample_files(dataset) == [{"image": tmp_path / "b.png"}]


class NamelessDataset(SmallestDataset):
    """Samples without a name, or of one that differs from `sample_ids`."""

    def __init__(self, folder, **named):
        super().__init__(folder)
        self.named = named

    def __getitem__(self, index: int) -> CameraLidarSample:
        sample = super().__getitem__(index)
        return CameraLidarSample.from_arrays(sample.calibration, image=sample.image, **self.named)


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """Open frames 0 and 1 by the class."""
    for index in range(2):
        noise = np.random.default_rng(index).integers(0, 256, (375, 1242, 3), np.uint8)
        write_rgb(tmp_path / "data" / f"{index}.png", noise)
    monkeypatch.setattr(
        open_module, "_open_drive", lambda path, *_, **__: NamelessDataset(path, **named)
    )
    named = {}

    def open_named(sample_list=None, **given):
        named.update(given)
        return open_dataset(tmp_path / "data", sample_list=sample_list)

    return open_named


@pytest.mark.parametrize("sample_list", [None, ["1", "0"]])
def test_samples_of_such_a_class_have_the_names_of_the_data_set(opened, sample_list):
    dataset = opened(sample_list)
    assert [sample.sample_id for sample in map(dataset.__getitem__, range(2))] == [
        *dataset.sample_ids
    ]


@pytest.mark.parametrize("sample_list", [None, ["0"]])
def test_other_names_than_those_of_the_data_set_are_refused(opened, sample_list):
    dataset = opened(sample_list, sample_id="../escaped")
    message = r"NamelessDataset: sample 0 is named '\.\./escaped', expected '0' as in sample_ids"
    with pytest.raises(ValueError, match=message):
        dataset[0]


@pytest.mark.parametrize("sample_list", [None, ["a"]])
def test_names_of_such_a_class_that_occur_twice_are_refused(tmp_path, monkeypatch, sample_list):
    twice = type("Twice", (SmallestDataset,), {"sample_ids": ("a", "b", "a")})
    monkeypatch.setattr(open_module, "_open_drive", lambda path, *_, **__: twice(path))
    with pytest.raises(ValueError, match=r"Twice.sample_ids holds 'a' twice.*; rename one of them"):
        open_dataset(tmp_path, sample_list=sample_list)


def test_results_of_samples_without_a_name_are_one_file_for_each_frame(opened, tmp_path):
    opened()
    out = tmp_path / "out"
    with pytest.warns(UserWarning, match="there are no point clouds for 2 of 2 frames"):
        perceive(tmp_path / "data", out, perceiver=perceiver(), align=False)
    assert sorted(path.name for path in (out / "detection2d").glob("*.txt")) == ["0.txt", "1.txt"]
    lines = (out / "perception.jsonl").read_text().splitlines()
    assert [json.loads(line)["frame"] for line in lines] == ["0", "1"]
    assert read_perception(open_results([out]), open_dataset(tmp_path / "data")[1]).detections2d


def test_labels_of_such_a_class_are_found_in_a_subset(tmp_path):
    for name in ("a", "b"):
        write_rgb(tmp_path / f"{name}.png", np.zeros((4, 4, 3), np.uint8))
    labels = tmp_path / "b.txt"
    labels.touch()
    dataset = NamedSubset(SmallestDataset(tmp_path), ["b", "a"])
    assert (label_file(dataset, 0), label_file(dataset, 1)) == (labels, None)
    assert list_sample_files(dataset)[0] == {"image": tmp_path / "b.png", "objects": labels}
    DETECTION_2D.scoring().check(dataset)
    with pytest.raises(ValueError, match="no labels to score"):
        DETECTION_2D.scoring().check(NamedSubset(dataset, ["a"]))
