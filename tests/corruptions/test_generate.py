import json
import multiprocessing
import os
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.corruptions.generate import corrupt_dataset, read_corrupted
from sightline.corruptions.suites import SUITES
from sightline.data.check import check_tree
from sightline.data.checks.lidar_mount import record_pose
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import read_mask_png
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.files.problem import FileError
from sightline.geometry.road_height import LidarPose
from sightline.geometry.tilt import Tilt
from sightline.jobs.run import JobResult
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.corruptions.samples import same
from tests.data.checks.test_lidar_mount import mounted_lower, write_frames
from tests.data.trees import picture, write_drive, write_object_frame, write_object_tree

FRAMES = ("000000", "000003", "000011", "000042")
DGFN7 = SUITES["dgfn7"]
_REPLACE = Path.replace

pytestmark = pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks


def make(data: Path, out: Path, **options: object) -> JobResult:
    return corrupt_dataset(data, out, **{"suite": "dgfn7", "seed": 3, "workers": 1, **options})


def content(folder: Path) -> dict[str, bytes]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write_object_tree(tmp_path_factory.mktemp("data") / "tiny", *FRAMES)
    (root / "ImageSets").mkdir()
    (root / "ImageSets/val.txt").write_text("000003\n000011\n")
    return root


@pytest.fixture(scope="module")
def cases(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "cases"
    assert make(data, out, masks=True) == JobResult(written=28, skipped=0)
    return out


def test_a_frame_reads_back_as_its_case_has_it_with_masks_where_they_were_written(data, cases):
    case = DGFN7.select(["camera_occlusion"])[0]
    expected = case.corrupt(open_dataset(data)[1], 3)
    back = read_corrupted(cases / case.name, "000003", case.corruption, "velodyne")
    assert back is not None
    assert torch.equal(back.sample.image, expected.sample.image)
    assert torch.equal(back.camera_mask, expected.camera_mask)
    assert not back.lidar_mask.any()
    assert read_corrupted(cases / case.name, "000007", case.corruption, "velodyne") is None


def test_each_case_is_an_object_tree_that_passes_the_check(cases: Path):
    folders = sorted(path.name for path in cases.iterdir() if path.is_dir())
    assert folders == sorted(DGFN7.case_names)
    for name in DGFN7.case_names:
        assert list(check_tree(cases / name, num_workers=1)) == []
        assert open_dataset(cases / name).sample_ids == FRAMES
        assert open_dataset(cases / name, sample_list="val").sample_ids == FRAMES[1:3]


def test_what_is_read_is_what_the_case_makes_of_the_sample(data: Path, cases: Path):
    for case in DGFN7.cases:
        for sound, read in zip(open_dataset(data), open_dataset(cases / case.name), strict=True):
            expected = case.corrupt(sound, seed=3)
            assert same(read, expected.sample)
            assert torch.equal(read.objects.boxes2d.tensor, sound.objects.boxes2d.tensor)
            folder, name = cases / case.name / "training", sound.sample_id
            record = json.loads((folder / f"corruption/{name}.json").read_text())
            assert record == json.loads(json.dumps(expected.record.to_json()))
            for part, mask in (("camera", expected.camera_mask), ("lidar", expected.lidar_mask)):
                found = read_mask_png(folder / f"{part}_mask/{name}.png")
                assert np.array_equal(found, mask.numpy())


def test_the_manifest_says_what_made_the_cases(cases: Path):
    manifest = json.loads((cases / "sightline.json").read_text())
    assert (manifest["suite"], manifest["seed"]) == ("dgfn7", 3)
    assert manifest["data"].endswith("/tiny")
    assert manifest["cases"]["camera_noise"]["sigma_levels"] == [20, 120]
    assert list(manifest["cases"]) == list(DGFN7.case_names)


def test_two_workers_shards_and_another_order_of_cases_write_the_same_bytes(
    data: Path, cases: Path, tmp_path: Path
):
    make(data, tmp_path / "a", masks=True, workers=2)
    for index in (2, 0, 1):
        make(data, tmp_path / "b", masks=True, shard_index=index, num_shards=3)
    for name in reversed(DGFN7.case_names):
        make(data, tmp_path / "c", masks=True, cases=[name])
    for other in "abc":
        assert content(tmp_path / other) == content(cases)


def test_what_is_there_is_kept_and_what_is_missing_is_made_alike(
    data: Path, cases: Path, tmp_path: Path
):
    out = tmp_path / "out"
    make(data, out)
    kept = out / "camera_noise/training/image_2/000003.png"
    before = kept.stat().st_mtime_ns
    assert make(data, out) == JobResult(written=0, skipped=28)
    for gone in ("camera_noise/training/image_2/000042.png", "clean/training/calib/000000.txt"):
        (out / gone).unlink()
    for gone in (out / "lidar_blank/training").glob("[!c]*/000011.*"):  # all but calib, corruption
        gone.unlink()
    (out / "lidar_blank/training/calib/000011.txt").unlink()
    assert make(data, out) == JobResult(written=3, skipped=25)
    assert kept.stat().st_mtime_ns == before
    without_masks = {k: v for k, v in content(cases).items() if "_mask/" not in k}
    assert content(out) == without_masks
    assert make(data, out, masks=True).written == 28  # masks were not requested before
    assert content(out) == content(cases)


def test_kept_frames_that_were_changed_since_are_told(data: Path, tmp_path: Path):
    source, out = tmp_path / "source", tmp_path / "out"
    shutil.copytree(data, source)
    make(source, out, cases=["camera_noise"])
    later_ns = time.time_ns() + 10**10
    os.utime(source / "training/label_2/000003.txt", ns=(later_ns, later_ns))
    with pytest.warns(UserWarning, match=f"first is 000003: .*; to make them anew, remove {out}"):
        make(source, out, cases=["camera_noise"])


def test_kept_frames_with_other_labels_of_old_times_are_told(data: Path, tmp_path: Path):
    source, out = tmp_path / "source", tmp_path / "out"
    shutil.copytree(data, source)
    make(source, out, cases=["clean", "camera_noise"])
    label = source / "training/label_2/000003.txt"
    lines, status = label.read_text().splitlines(), label.stat()
    label.unlink()
    label.write_text("\n".join(reversed(lines)) + "\n\n")
    os.utime(label, ns=(status.st_atime_ns, status.st_mtime_ns))
    told = rf"the labels of 1 kept frames \(000003\) are others in .*label_2 now; .* remove {out}"
    with pytest.warns(UserWarning, match=told):
        make(source, out)
    label.unlink()
    shutil.copy2(out / "clean/training/label_2/000003.txt", label)
    shutil.rmtree(out / "lidar_blank")
    with pytest.warns(UserWarning, match=told):  # of the cases that were made between
        make(source, out)


def killed_at(renames: int, data: Path, out: Path) -> None:
    """Run the job in a process that is killed just before rename number `renames`."""
    left = renames

    def rename(path: Path, target: Path) -> Path:
        nonlocal left
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        left -= 1
        return _REPLACE(path, target)

    Path.replace = rename
    make(data, out, masks=True)


@settings(max_examples=4)
@given(renames=st.integers(0, 200))
def test_a_job_that_is_killed_is_finished_to_the_same_bytes(
    data: Path, cases: Path, tmp_path_factory: pytest.TempPathFactory, renames: int
):
    out = tmp_path_factory.mktemp("killed") / "out"
    process = multiprocessing.get_context("fork").Process(
        target=killed_at, args=(renames, data, out)
    )
    process.start()
    process.join(60)
    assert process.exitcode == -signal.SIGKILL
    expected = content(cases)
    there = {name: text for name, text in content(out).items() if ".sightline-" not in name}
    assert len(there) < len(expected)
    assert there.items() <= expected.items()
    make(data, out, masks=True)
    assert content(out) == expected
    shutil.rmtree(out)


def test_the_input_stays_as_it_is(data: Path, tmp_path: Path):
    def state() -> dict[str, tuple[int, int, bytes]]:
        paths = sorted(data.rglob("*"))
        return {
            str(path): (
                path.stat().st_mtime_ns,
                path.stat().st_mode,
                path.read_bytes() if path.is_file() else b"",
            )
            for path in paths
        }

    before = state()
    make(data, tmp_path / "out", masks=True)
    assert state() == before  # links are no change of it
    linked = tmp_path / "out/lidar_blank/training/image_2/000000.png"
    write_rgb(linked, picture(9))
    assert not linked.samefile(data / "training/image_2/000000.png")
    assert state() == before


def test_what_a_case_leaves_alone_takes_no_room(data: Path, cases: Path):
    for case in DGFN7.cases:
        for sensor, part in (("camera", "image_2/000000.png"), ("lidar", "velodyne/000000.bin")):
            is_linked = (cases / case.name / "training" / part).samefile(data / "training" / part)
            assert is_linked == (sensor not in case.corruption.sensors)


def test_a_list_and_more_cases_extend_what_is_there(data: Path, cases: Path, tmp_path: Path):
    out = tmp_path / "out"
    blind = ["lidar_blank", "camera_blank"]
    assert make(data, out, cases=blind, sample_list="val", masks=True).written == 4
    assert open_dataset(out / "camera_blank").sample_ids == FRAMES[1:3]
    assert not (out / "clean").exists()
    assert make(data, out, masks=True) == JobResult(written=24, skipped=4)
    assert content(out) == content(cases)


def test_trees_with_depth_reduced_sweeps_jpegs_or_no_labels_are_taken_as_they_are(tmp_path: Path):
    data, out = tmp_path / "data", tmp_path / "out"
    write_object_frame(data, "7", split="testing")
    folder = data / "testing"
    (folder / "velodyne").rename(folder / "velodyne_reduced")
    (folder / "image_2/7.png").unlink()
    write_rgb(folder / "image_2/7.jpg", picture())
    make(data, out, velodyne="velodyne_reduced")
    names = {path.name: content(path) for path in out.iterdir() if path.is_dir()}
    assert "testing/image_2/7.jpg" in names["lidar_occlusion"]
    assert "testing/image_2/7.png" in names["camera_occlusion"]
    assert names["lidar_blank"]["testing/velodyne_reduced/7.bin"] == b""
    assert make(PACKAGED_FRAMES, tmp_path / "street", cases=["lidar_occlusion"]).written == 2
    street = open_dataset(tmp_path / "street/lidar_occlusion", parts=("image", "points", "depth"))
    assert street[1].depth is not None


def test_a_kind_of_core_is_written_at_all_severities(data: Path, tmp_path: Path):
    out = tmp_path / "out"
    assert make(data, out, suite="core", cases=["lidar_fog", "camera_rain-3"]).written == 24
    assert sorted(path.name for path in out.iterdir() if path.is_dir()) == [
        "camera_rain-3",
        *(f"lidar_fog-{severity}" for severity in range(1, 6)),
    ]
    record = json.loads((out / "lidar_fog-5/training/corruption/000000.json").read_text())
    assert record["parameters"]["attenuation_per_m"] == 0.06
    assert list(check_tree(out / "camera_rain-3", num_workers=1)) == []


def test_data_without_the_sensor_that_a_case_breaks_are_refused(tmp_path: Path):
    data = write_object_tree(tmp_path / "data", *FRAMES)
    (data / "training/velodyne/000011.bin").unlink()
    with pytest.raises(ValueError, match=r"lacks velodyne|no points of frame 000011"):
        make(data, tmp_path / "out", suite="core", cases=["lidar_fog-3"])
    assert not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore:.*no images. their size is guessed")
def test_a_lidar_without_a_camera_is_broken_alone(tmp_path: Path):
    data = write_object_tree(tmp_path / "data", *FRAMES)
    shutil.rmtree(data / "training/image_2")
    cases = ["clean", "lidar_fog-3"]
    found = make(data, tmp_path / "out", suite="core", cases=cases)
    assert found == JobResult(written=2 * len(FRAMES), skipped=0)
    assert make(data, tmp_path / "out", suite="core", cases=cases).written == 0
    with pytest.raises(ValueError, match="no image of frame 000000 for case camera_fog-1"):
        make(data, tmp_path / "other", suite="core", cases=["camera_fog"])


def test_a_real_frame_has_its_box_on_an_object(kitti_root: Path, tmp_path: Path):
    (name, *_) = open_dataset(kitti_root, sample_list="sample_val").sample_ids
    make(kitti_root, tmp_path, cases=["camera_occlusion", "lidar_occlusion"], sample_list=[name])
    sound = open_dataset(kitti_root, sample_list=[name])[0]
    for case in ("camera_occlusion", "lidar_occlusion"):
        record = json.loads((tmp_path / case / f"training/corruption/{name}.json").read_text())
        left, top, right, bottom = record["parameters"]["box_px"]
        centres = (sound.objects.boxes2d.tensor[:, :2] + sound.objects.boxes2d.tensor[:, 2:]) / 2
        x, y = centres.unbind(dim=-1)
        assert ((x > left - 1) & (x < right) & (y > top - 1) & (y < bottom)).any()
    read = open_dataset(tmp_path / "lidar_occlusion")[0]
    assert 0 < len(read.points) < len(sound.points)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"suite": "dgfn"}, "no suite 'dgfn'; perhaps dgfn7 is meant"),
        ({"cases": ["clean", "camera_blnk"]}, "no case 'camera_blnk'; perhaps camera_blank is"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"workers": 0}, "workers must be at least 1"),
        ({"shard_index": 2, "num_shards": 2}, "shard_index must be between"),
        ({"sample_list": ["000001"]}, "no frame 000001"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_written(
    data: Path, tmp_path: Path, options: dict, message: str
):
    with pytest.raises(ValueError, match=message):
        make(data, tmp_path / "out", **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("inside", [".", "training", "cases/deep", "training/../x"])
def test_an_output_folder_within_the_input_is_refused(data: Path, inside: str):
    before = content(data)
    for given_data in (data, data / "training"):
        with pytest.raises(ValueError, match="would change the data set"):
            make(given_data, data / inside)
    assert content(data) == before


def test_a_case_that_is_itself_the_input_is_not_overwritten(cases: Path, tmp_path: Path):
    link = tmp_path / "link"
    link.symlink_to(cases)
    for out in (cases, link):
        with pytest.raises(ValueError, match="would change the data set"):
            make(cases / "clean", out, seed=8)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"seed": 4}, "seed 3 instead of 4"), ({"suite": "dgfn7-figure"}, "suite dgfn7 instead of")],
)
def test_other_settings_never_mix_with_what_is_there(
    data: Path, cases: Path, options: dict, message: str
):
    before = content(cases)
    with pytest.raises(ValueError, match=message):
        make(data, cases, **options)
    assert content(cases) == before


def test_other_data_never_mix_with_what_is_there(cases: Path, tmp_path: Path):
    write_object_tree(tmp_path / "other", "000000")
    with pytest.raises(ValueError, match=r"data \S+/tiny instead of \S+/other"):
        make(tmp_path / "other", cases)


def test_data_of_another_format_is_refused(tmp_path: Path):
    drive = write_drive(tmp_path / "drive", official=False)
    message = r"is not an object tree; give a folder .* \(sightline robustness takes recordin"
    with pytest.raises(ValueError, match=message):
        make(drive, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_names_the_frame_and_what_was_done_before_stays(tmp_path: Path, workers: int):
    data, out = write_object_tree(tmp_path / "data", "000000", "000001"), tmp_path / "out"
    (data / "training/velodyne/000001.bin").write_bytes(b"cut short")
    with pytest.raises(ValueError, match=r"^frame 000001: .*000001\.bin: holds 9 bytes"):
        make(data, out, workers=workers)
    assert (out / "lidar_blank/training/corruption/000000.json").exists()
    assert not list(out.rglob("000001.*"))


# By this seed, the road of the packaged frames seems 0.8 m higher.
BEAMS = {"suite": "lidar_beams", "cases": ["lidar_beams-5"], "seed": 0}
RECORD = "lidar_beams-5/training/lidar_mount.json"


def test_clouds_that_hardly_show_the_road_keep_the_mount_of_the_sound_ones(tmp_path: Path):
    make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS)
    tree = tmp_path / "out/lidar_beams-5"
    assert open_dataset(tree)[0].lidar_height_m is None
    assert list(check_tree(tree)) == []
    write_shards(tree, tmp_path / "shards", frames_per_shard=1)
    for shard in ("000000.tar", "000001.tar"):
        assert open_dataset(tmp_path / "shards" / shard)[0].lidar_height_m is None
    (tmp_path / "out" / RECORD).unlink()  # as in a tree of an earlier version
    with pytest.warns(UserWarning, match="m above it, not 1.73 m like KITTI's"):
        assert open_dataset(tree)[0].lidar_height_m == pytest.approx(0.95, abs=0.2)
    assert make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS) == JobResult(written=0, skipped=2)
    assert open_dataset(tree)[0].lidar_height_m is None


@pytest.mark.filterwarnings("ignore:.*shows that the LiDAR is 2.67 m above it")
def test_a_case_has_the_very_height_of_a_tree_of_another_lidar(tmp_path: Path):
    sound = write_frames(tmp_path / "sound", "tree", mounted_lower(-0.9))
    make(sound, tmp_path / "out", **BEAMS)
    again = tmp_path / "again"
    make(tmp_path / "out/lidar_beams-5", again, **BEAMS)  # broken twice
    height_m = open_dataset(sound)[0].lidar_height_m
    assert height_m == pytest.approx(2.67, abs=0.01)
    for root in (tmp_path / "out", again):
        assert open_dataset(root / "lidar_beams-5")[0].lidar_height_m == height_m


def test_broken_clouds_do_not_contradict_a_mount_in_calibration_files(tmp_path: Path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "sound")
    for path in (tmp_path / "sound/training/calib").iterdir():
        mount = "lidar_height_m: 1.73\nlidar_tilt_deg: 0 0\n"
        path.write_text(path.read_text().rstrip() + "\n" + mount)
    make(tmp_path / "sound", tmp_path / "out", **{**BEAMS, "seed": 1})
    tree = tmp_path / "out/lidar_beams-5"
    sample = open_dataset(tree)[0]
    assert sample.lidar_height_m == 1.73
    assert list(check_tree(tree)) == []
    (tmp_path / "out" / RECORD).unlink()
    with pytest.warns(UserWarning, match="lidar_height_m is 1.73, but the road in the sweeps"):
        open_dataset(tree)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "[" * 10**5,
        '{"lidar_height_m": "1.9", "lidar_tilt_deg": null}',
        '{"lidar_height_m": NaN, "lidar_tilt_deg": null}',
        '{"lidar_height_m": true, "lidar_tilt_deg": null}',
        f'{{"lidar_height_m": 1{"0" * 400}, "lidar_tilt_deg": null}}',
        '{"lidar_height_m": null, "lidar_tilt_deg": {"roll": 1.0}}',
        '{"lidar_height_m": null, "lidar_tilt_deg": {"roll": 1.0, "pitch": null}}',
    ],
)
def test_a_damaged_record_of_the_mount_is_refused_in_a_line(tmp_path: Path, text: str):
    make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS)
    tree = tmp_path / "out/lidar_beams-5"
    (tmp_path / "out" / RECORD).write_text(text)
    with pytest.raises(FileError, match=r"lidar_mount\.json: is damaged, .* corrupt again"):
        open_dataset(tree)
    (problem,) = check_tree(tree)
    assert "lidar_mount.json: is damaged" in str(problem)
    make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS)
    assert open_dataset(tree)[0].lidar_height_m is None


def test_the_tilt_of_the_sound_tree_is_recorded_to_the_bit(tmp_path: Path):
    pose = LidarPose(height_m=1.9000000000000001, tilt=Tilt(roll_deg=-0.1, pitch_deg=5.3))
    make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS)
    tree = tmp_path / "out/lidar_beams-5"
    record_pose(tree / "training", pose)
    with pytest.warns(UserWarning, match="the LiDAR is tilted"):
        dataset = open_dataset(tree)
    assert dataset.pose == pose
    record = tmp_path / "out" / RECORD
    before = record.stat().st_ino, record.read_bytes()
    rounded = replace(pose, height_m=1.9 + 2e-14)
    record_pose(tree / "training", rounded)  # by another processor
    assert (record.stat().st_ino, record.read_bytes()) == before
    record_pose(tree / "training", replace(pose, tilt=None))
    assert '"lidar_tilt_deg": null' in record.read_text()


def test_a_record_written_by_hand_may_hold_whole_numbers(tmp_path: Path):
    make(PACKAGED_FRAMES, tmp_path / "out", **BEAMS)
    (tmp_path / "out" / RECORD).write_text(
        '{"lidar_height_m": 2, "lidar_tilt_deg": {"roll": 0, "pitch": -5}}'
    )
    with pytest.warns(UserWarning, match="the LiDAR is tilted"):
        pose = open_dataset(tmp_path / "out/lidar_beams-5").pose
    assert pose == LidarPose(height_m=2.0, tilt=Tilt(roll_deg=0.0, pitch_deg=-5.0))
