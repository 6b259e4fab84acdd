import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.data.check import check_tree
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.map_png import read_depth_png, read_instance_png
from sightline.data.formats.rings import ring_numbers
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from sightline.geometry.projection import sparse_depth_map
from sightline.jobs.run import JobResult, shard
from sightline.simulation.dataset import sample_of
from sightline.simulation.generate import MANIFEST_NAME, SIMULATOR_REVISION, ObjectLayout
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from tests.data import recordings, trees
from tests.simulation.data_sets import DRIVES, TINY, content, make
from tests.simulation.small_streets import make_tiny_street


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("frames")
    assert make(out, 4, workers=1, validation_frames=1) == JobResult(written=4, skipped=0)
    return out


def test_an_object_tree_passes_the_check_and_opens(frames: Path):
    assert list(check_tree(frames, num_workers=1)) == []
    dataset = open_dataset(frames, sample_list="train")
    assert dataset.sample_ids == ("000001", "000002", "000003")
    assert open_dataset(frames, sample_list="val").sample_ids == ("000000",)
    sample = dataset[1]
    assert ring_numbers(sample.points.numpy()).max() == 63


def test_what_is_read_is_what_was_simulated(frames: Path):
    made = simulate_frame(TINY, 2, make_tiny_street)
    sample, folder = sample_of(made), frames / "training"
    read = open_dataset(frames)[2]
    assert torch.equal(read.image, sample.image)
    assert torch.equal(read.points, sample.points)
    assert read.objects.class_names == sample.objects.class_names
    assert torch.allclose(read.objects.boxes3d.tensor, sample.objects.boxes3d.tensor, atol=0.011)
    assert torch.equal(read.calibration.image_from_lidar, sample.calibration.image_from_lidar)
    assert np.array_equal(read_instance_png(folder / "instance/000002.png"), made.instances)
    depth = read_depth_png(folder / "depth/000002.png")
    assert np.abs(depth - sample.depth.numpy()).max() <= 1 / 512 + 1e-6
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size).numpy()
    read_sparse = read_depth_png(folder / "velodyne_raw/000002.png")
    assert np.abs(read_sparse - sparse).max() <= 1 / 512 + 1e-6


def test_instances_number_the_rows_of_the_label_file(frames: Path):
    for path in sorted((frames / "training/instance").glob("*.png")):
        instances = read_instance_png(path)
        objects = read_labels(frames / f"training/label_2/{path.stem}.txt")
        assert instances.max() <= len(objects.class_names)
        for row, box in enumerate(objects.boxes2d, start=1):
            y, x = np.nonzero(instances == row)
            if objects.class_names[row - 1] == "DontCare":
                assert len(x) == 0
                continue
            assert box[0] - 1 <= x.min() <= x.max() <= box[2] + 1
            assert box[1] - 1 <= y.min() <= y.max() <= box[3] + 1


def test_two_workers_write_the_same_bytes_as_one(frames: Path, tmp_path: Path):
    make(tmp_path, 4, workers=2, validation_frames=1)
    assert content(tmp_path) == content(frames)


def test_frames_that_are_there_are_kept_and_what_is_missing_is_made_alike(
    frames: Path, tmp_path: Path
):
    make(tmp_path, 4, workers=1, validation_frames=1)
    (tmp_path / "training/depth/000001.png").unlink()
    (tmp_path / "training/image_2/000003.png").unlink()
    kept = tmp_path / "training/image_2/000002.png"
    before = kept.stat().st_mtime_ns
    result = make(tmp_path, 4, workers=1, validation_frames=1)
    assert result == JobResult(written=2, skipped=2)
    assert kept.stat().st_mtime_ns == before
    assert content(tmp_path) == content(frames)


def test_a_run_with_more_frames_extends_and_one_with_fewer_changes_nothing(
    frames: Path, tmp_path: Path
):
    make(tmp_path, 2, workers=1, validation_frames=1)
    assert make(tmp_path, 4, workers=1, validation_frames=1).written == 2
    assert content(tmp_path) == content(frames)
    assert make(tmp_path, 1, workers=1, validation_frames=1) == JobResult(written=0, skipped=4)
    assert content(tmp_path) == content(frames)


def test_ctrl_c_leaves_whole_files_and_the_next_run_finishes_to_the_same_bytes(
    frames: Path, tmp_path: Path
):
    program = (
        "from pathlib import Path\n"
        "from tests.simulation.data_sets import make\n"
        f"make(Path({str(tmp_path)!r}), 400, workers=2, validation_frames=1)\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True) as process:
        images = tmp_path / "training/image_2"
        deadline = time.monotonic() + 120
        while len(list(images.glob("*.png"))) < 2 and time.monotonic() < deadline:
            assert process.poll() is None, process.stderr.read().decode()
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does
        assert b"KeyboardInterrupt" in process.communicate(timeout=60)[1]
    begun = max(int(path.stem) for path in images.glob("*.png")) + 1
    assert begun < 400
    assert not [path for path in tmp_path.rglob(".*") if path.is_file()]
    for number in range(begun, 4):  # whatever the speed, compare four frames
        assert not (images / f"{number:06d}.png").exists()
    make(tmp_path, 4, workers=1, validation_frames=1)
    whole, resumed = content(frames), content(tmp_path)
    for name, expected in whole.items():
        if not name.startswith("ImageSets"):
            assert resumed[name] == expected, name


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"config": SimulationConfig(seed=4, image_size=(94, 310), focal_px=180.0)}, "seed 3"),
        ({"validation_frames": 2}, "validation_frames 1 instead of 2"),
        ({"velodyne": "velodyne_reduced", "validation_frames": 1}, "velodyne velodyne instead"),
    ],
)
def test_other_settings_never_mix_with_what_is_there(frames: Path, options: dict, message: str):
    before = content(frames)
    with pytest.raises(ValueError, match=message):
        make(frames, 6, **{"workers": 1, "validation_frames": 1, **options})
    assert content(frames) == before


def test_frames_of_another_simulator_never_mix_with_what_is_there(frames: Path, monkeypatch):
    monkeypatch.setattr("sightline.simulation.generate.SIMULATOR_REVISION", 99)
    with pytest.raises(ValueError, match=f"revision {SIMULATOR_REVISION} instead of 99"):
        make(frames, 6, workers=1, validation_frames=1)


def test_data_of_unknown_origin_are_not_mixed_with(tmp_path: Path):
    (tmp_path / "training").mkdir()
    with pytest.raises(ValueError, match=f"data without a {MANIFEST_NAME}"):
        make(tmp_path, 1)


def write_lists(root: Path) -> None:
    (root / "ImageSets").mkdir(parents=True)
    (root / "ImageSets" / "train.txt").write_text("a\n")


@pytest.mark.parametrize(
    ("write", "place", "config"),
    [
        (write_lists, ".", TINY),
        (recordings.write_recording, ".", TINY),
        (trees.write_drive, ".", DRIVES),
        (lambda root: trees.write_object_tree(root, "000001"), "training", TINY),
        (lambda root: trees.write_object_frame(root, "000001", "testing"), ".", TINY),
        (lambda root: trees.write_depth_drive(root, root), "data_depth_velodyne", DRIVES),
    ],
)
def test_data_sets_and_lists_of_other_origin_are_no_outputs(
    tmp_path: Path, monkeypatch, write: Callable, place: str, config: SimulationConfig
):
    write(tmp_path / "own")
    before = content(tmp_path)
    monkeypatch.chdir(tmp_path / "own" / place)
    for out in (tmp_path / "own" / place, Path()):
        with pytest.raises(ValueError, match=r"would mix with .*; name another output folder"):
            make(out, 2, config)
    assert content(tmp_path) == before


def test_the_manifest_records_revision_seed_and_settings(frames: Path):
    manifest = json.loads((frames / MANIFEST_NAME).read_text())
    assert manifest["seed"] == 3
    assert manifest["image_size"] == [94, 310]
    assert manifest["revision"] == SIMULATOR_REVISION
    assert manifest["streets"] == "tests.simulation.small_streets.make_tiny_street"


def test_reduced_sweeps_hold_what_the_camera_sees(frames: Path, tmp_path: Path):
    make(tmp_path, 1, workers=1, velodyne="velodyne_reduced")
    assert list(check_tree(tmp_path, num_workers=1)) == []
    reduced = open_dataset(tmp_path, velodyne="velodyne_reduced")[0]
    whole = open_dataset(frames)[0]
    assert 0 < len(reduced.points) < len(whole.points) / 3
    assert (reduced.points[:, 0] > 0).all()


@pytest.mark.parametrize(
    ("num_frames", "options", "message"),
    [
        (0, {}, "frames must be at least 1"),
        (
            2,
            {"validation_frames": 3},
            "got 2, and validation_frames from 0 to as many, got 3; set both",
        ),
        (2, {"workers": 0}, "workers must be at least 1, got 0"),
        (10**6 + 1, {}, "at most 1000000 frames"),
        (3 * 10**4 + 1, {"config": DRIVES}, "at most 30000 frames"),
        (2, {"shard_index": 2, "num_shards": 2}, "shard_index must be between"),
    ],
)
def test_senseless_numbers_are_refused(
    tmp_path: Path, num_frames: int, options: dict, message: str
):
    with pytest.raises(ValueError, match=message):
        make(tmp_path, num_frames, **options)
    assert not any(tmp_path.iterdir())


def test_parts_of_a_set_make_it_together_in_any_order_and_skip_each_others_frames(
    frames: Path, tmp_path: Path
):
    options = {"workers": 1, "validation_frames": 1, "num_shards": 3}
    assert make(tmp_path, 4, shard_index=1, **options) == JobResult(written=1, skipped=0)
    assert [path.stem for path in (tmp_path / "training/label_2").iterdir()] == ["000001"]
    assert make(tmp_path, 4, shard_index=0, **options) == JobResult(written=2, skipped=0)
    assert make(tmp_path, 4, shard_index=1, **options) == JobResult(written=0, skipped=1)
    assert make(tmp_path, 4, shard_index=2, **options) == JobResult(written=1, skipped=0)
    assert content(tmp_path) == content(frames)


def test_files_with_other_names_than_frames_have_are_no_frames_that_were_begun(
    frames: Path, tmp_path: Path
):
    shutil.copytree(frames, tmp_path, dirs_exist_ok=True)
    for name in ("99999999999999999999", "1000000", "mine", "-00001", "\u0661" * 6):
        (tmp_path / "training/velodyne" / f"{name}.bin").touch()
    result = make(tmp_path, 4, workers=1, validation_frames=1)
    assert result == JobResult(written=0, skipped=4)


def test_a_sweep_far_beyond_what_was_begun_is_refused_by_name_and_changes_nothing(
    frames: Path, tmp_path: Path
):
    shutil.copytree(frames, tmp_path, dirs_exist_ok=True)
    stray = tmp_path / "training/velodyne/999999.bin"
    stray.touch()
    before = content(tmp_path)
    message = r"999999\.bin: is the sweep of frame 999999, expected an index below 5000 .* 1000000"
    with pytest.raises(FileError, match=message):
        make(tmp_path, 1, workers=1, validation_frames=1)
    assert content(tmp_path) == before
    stray.unlink()
    assert make(tmp_path, 4, workers=1, validation_frames=1).skipped == 4


@given(
    frames=st.integers(1, 10**6),
    num_shards=st.integers(1, 1000),
    done=st.integers(1, 20),
    fewer=st.integers(1, 10**6),
    data=st.data(),
)
@settings(max_examples=30)
def test_the_last_frame_of_a_part_that_was_killed_is_in_the_plan_of_any_later_run(
    frames, num_shards, done, fewer, data
):
    own_frames = shard(range(frames), data.draw(st.integers(0, num_shards - 1)), num_shards)[:done]
    with TemporaryDirectory() as folder:
        layout = ObjectLayout(root=Path(folder), velodyne="velodyne")
        layout.frame(0).points.parent.mkdir(parents=True)
        for index in own_frames:
            layout.frame(index).points.touch()
        begun = 1 + own_frames[-1] if own_frames else 0
        assert layout.num_planned(frames) == frames
        assert layout.num_planned(min(fewer, frames)) == max(min(fewer, frames), begun)


def test_a_gap_as_wide_as_requested_is_filled(tmp_path: Path):
    layout = ObjectLayout(root=tmp_path, velodyne="velodyne")
    layout.frame(0).points.parent.mkdir(parents=True)
    layout.frame(999_999).points.touch()
    assert layout.num_planned(10**6) == 10**6
    with pytest.raises(FileError, match=r"frame 999999, expected an index below 999999"):
        layout.num_planned(999_999)


def test_without_the_camera_all_else_is_the_same(frames: Path, tmp_path: Path):
    blind = replace(TINY, camera=False)
    make(tmp_path, 4, blind, workers=1, validation_frames=1)
    with_images, without = content(frames), content(tmp_path)
    left_out = {name for name in with_images if name.startswith("training/image_2")}
    assert set(with_images) - set(without) == left_out
    assert len(left_out) == 4
    for name in set(without) - {MANIFEST_NAME}:
        assert without[name] == with_images[name], name
    (tmp_path / "training/label_2/000002.txt").unlink()
    result = make(tmp_path, 4, blind, workers=1, validation_frames=1)
    assert result == JobResult(written=1, skipped=3)
    assert content(tmp_path) == without


def test_a_tree_without_the_camera_passes_the_check_and_opens(tmp_path: Path):
    make(tmp_path, 2, replace(TINY, camera=False), workers=1)
    assert list(check_tree(tmp_path, num_workers=1)) == []
    sample = open_dataset(tmp_path, parts=("points", "objects"))[1]
    assert sample.image is None
    assert sample.depth is None
    assert sample.image_size == (94, 310)
    assert sample.points is not None
    with pytest.raises(ValueError, match="lacks image_2 of 2 of 2 frames"):
        open_dataset(tmp_path, parts=("image", "points"))
    (tmp_path / "training/depth/000001.png").unlink()
    assert [str(problem.path.name) for problem in check_tree(tmp_path)] == ["000001.png"]


def test_an_output_that_is_a_file_is_refused(tmp_path: Path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ValueError, match="is no folder"):
        make(tmp_path / "out", 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_the_frame(tmp_path: Path, workers: int):
    make(tmp_path, 1, workers=workers)
    shutil.rmtree(tmp_path / "training/depth")
    (tmp_path / "training/depth").write_text("in the way")
    with pytest.raises(ValueError, match=r"^frame 0: .*depth.* cannot be written"):
        make(tmp_path, 3, workers=workers)
