import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from importlib.metadata import version

import numpy as np
import pytest
import torch
from PIL import Image

from sightline.data.formats.kitti_files import read_points, write_points
from sightline.data.formats.map_png import read_depth_png
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.depth_completion.predictor import DepthCompleter
from sightline.depth_completion.registration import TASK
from sightline.inference.predict import predict
from sightline.jobs.run import JobResult
from sightline.structures.predictions import DepthMap
from tests.data.trees import write_drive
from tests.inference.function_predictor import FunctionPredictor, sparse, write
from tests.inference.trees import IMAGE_SIZE, contents_of, write_object_tree


def write_nearest(data, out, **job):
    return predict(TASK, DepthCompleter("nearest"), data, out, **job)


def test_each_sample_gets_a_depth_png_of_its_images_size(data, tmp_path):
    out = tmp_path / "deep" / "out"
    assert write_nearest(data, out) == JobResult(written=6, skipped=0)
    samples = open_dataset(data, parts={"points"})
    assert sorted(path.stem for path in out.glob("*.png")) == list(samples.sample_ids)
    for sample in (samples[index] for index in range(6)):
        depth_m = read_depth_png(out / f"{sample.sample_id}.png")
        assert depth_m.shape == IMAGE_SIZE
        expected = DepthCompleter("nearest")(sample).depth_m.numpy()
        assert np.abs(depth_m - expected).max() <= 0.5 / 256


def test_the_manifest_says_what_made_the_files(data, tmp_path):
    write_nearest(data, tmp_path, sample_list=["000001"])
    assert json.loads((tmp_path / "sightline.json").read_text()) == {
        "task": "depth-completion",
        "output": "depth",
        "method": "nearest",
        "data": f"{tmp_path.name}/data",
        "velodyne": "velodyne",
        "sightline": version("sightline"),
    }


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_the_number_of_workers_changes_nothing(data, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    write(data, one, workers=1)
    write(data, two, workers=2)
    assert contents_of(one) == contents_of(two)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_several_workers_take_the_work_off_this_process(data, out, tmp_path):
    started = tmp_path / "started"
    started.mkdir()

    def process_id(sample):
        (started / str(os.getpid())).touch()
        give_up = time.monotonic() + 30  # the first worker waits here until both have a frame
        while len(list(started.iterdir())) < 2 and time.monotonic() < give_up:
            time.sleep(0.01)
        depth_m = torch.full(sample.image_size, os.getpid() % 50_000 / 256)
        return DepthMap(depth_m=depth_m, valid=depth_m > 0)

    write(data, out, process_id, workers=2)
    ids = {round(read_depth_png(path)[0, 0] * 256) for path in out.glob("*.png")}
    assert len(ids) == 2
    assert os.getpid() % 50_000 not in ids


def test_shards_part_the_samples(data, tmp_path):
    results = [
        write_nearest(data, tmp_path / "out", workers=1, shard_index=i, num_shards=4)
        for i in range(4)
    ]
    assert [result.written for result in results] == [2, 2, 1, 1]
    write_nearest(data, tmp_path / "whole", workers=1)
    assert contents_of(tmp_path / "out") == contents_of(tmp_path / "whole")


@pytest.mark.parametrize(
    ("shard_index", "num_shards", "message"),
    [
        (-1, 2, "shard_index must be between 0 and num_shards - 1"),
        (2, 2, "shard_index must be between 0 and num_shards - 1"),
        (0, 0, "num_shards must be at least 1, got 0"),
    ],
)
def test_an_invalid_shard_is_refused(data, out, shard_index, num_shards, message):
    with pytest.raises(ValueError, match=message):
        write_nearest(data, out, shard_index=shard_index, num_shards=num_shards)


def test_files_that_are_there_are_skipped_and_missing_ones_are_made(data, out):
    write(data, out)
    before = contents_of(out)
    (out / "000003.png").unlink()
    (out / "000004.png").write_bytes(b"left as it is")
    done = []
    assert write(data, out, lambda s: (done.append(s.sample_id), sparse(s))[1]) == JobResult(
        written=1, skipped=5
    )
    assert done == ["000003"]
    assert contents_of(out) == before | {"000004.png": b"left as it is"}


def test_kept_results_of_frames_that_were_changed_since_are_told(data, out):
    write_shards(data, data.with_name("shards"), frames_per_shard=6)
    for _ in range(2):  # warnings are errors here
        write(data, out)
        write(data.with_name("shards"), out.with_name("of shards"))
    training, before = data / "training", contents_of(out)
    for number, file in enumerate(("velodyne/000002.bin", "calib/000004.txt"), start=1):
        later_ns = (out / "000005.png").stat().st_mtime_ns + 10**9
        os.utime(training / file, ns=(later_ns, later_ns))
        told = f"of 6 frames whose results are kept, {number} changed after .* first is 000002: "
        with pytest.warns(UserWarning, match=f"out: {told}.*add --overwrite"):
            write(data, out)
    assert contents_of(out) == before
    (out / "000002.png").unlink()
    (out / "000004.png").unlink()
    later_ns = (out / "000005.png").stat().st_mtime_ns - 10**9
    for path in training.glob("velodyne/*"):
        os.utime(path, ns=(later_ns, later_ns))
    for path in training.glob("image_2/*"):  # no part of the method's input
        os.utime(path, ns=(later_ns + 10**12, later_ns + 10**12))
    os.utime(training / "calib/000004.txt", ns=(later_ns, later_ns))
    assert write(data, out).written == 2


def test_folders_and_empty_files_in_the_place_of_results_are_not_taken_for_them(data, out):
    write(data, out)
    (out / "000001.png").write_bytes(b"")
    assert write(data, out).written == 1
    assert read_depth_png(out / "000001.png").any()
    (out / "000001.png").unlink()
    (out / "000001.png").mkdir()
    with pytest.raises(ValueError, match=r"000001\.png cannot be written: it is no regular file"):
        write(data, out)


def test_overwrite_makes_all_files_anew(data, out):
    write(data, out)
    before = contents_of(out)
    (out / "000004.png").write_bytes(b"damaged")
    assert write(data, out, overwrite=True) == JobResult(written=6, skipped=0)
    assert contents_of(out) == before


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"name": "other"}, "method sparse instead of other"),
        ({"made_by": {"version": "2"}}, "version 1 instead of 2"),
        ({"made_by": {"version": "1", "weights": "ab"}}, "weights none instead of ab"),
        ({"made_by": {"version": "1", "sightline": "9"}}, r"sightline [\w.]+ instead of 9"),
    ],
)
@pytest.mark.parametrize("overwrite", [False, True])
def test_results_of_different_methods_or_versions_do_not_mix(data, out, other, message, overwrite):
    write(data, out)
    before = contents_of(out)
    with pytest.raises(ValueError, match=f"out holds files made with {message}, .* mix") as raised:
        write(data, out, overwrite=overwrite, **other)
    assert "\n" not in str(raised.value)
    assert contents_of(out) == before


def test_predictions_for_two_data_sets_do_not_mix_though_frames_have_the_same_names(tmp_path, out):
    cases = [write_object_tree(tmp_path / suite / "camera_blank", 2) for suite in ("a", "b")]
    write(cases[0], out)
    with pytest.raises(ValueError, match="files made with data a/camera_blank instead of b/camera"):
        write(cases[1], out)
    assert write(cases[0] / "../camera_blank", out) == JobResult(written=0, skipped=2)


@pytest.mark.parametrize("place", [".", "training/depth", "testing/depth", "mine"])
def test_nothing_is_written_into_the_data_set(data, tmp_path, place):
    """A folder `training/depth` in it would later be read as true depth."""
    linked = tmp_path / "linked"
    linked.mkdir()
    (linked / "training").symlink_to(data / "training")
    before = sorted(data.rglob("*"))
    for path, out in (
        (data, data / place),
        (data / "training", data / place),
        (tmp_path / "linked" / ".." / "data", data / place),
        (linked, linked / place),
        (linked, data / "training" / "mine"),
    ):
        with pytest.raises(ValueError, match=r"would change the data set .*; name a place"):
            write(path, out)
    assert sorted(data.rglob("*")) == before


def test_pngs_of_unknown_origin_are_not_mixed_with(data, out):
    shutil.copytree(data / "training" / "image_2", out)
    with pytest.raises(ValueError, match=r"out holds data without a sightline\.json"):
        write(data, out)


def test_of_two_jobs_at_one_time_that_differ_one_is_refused_before_it_writes(data, out):
    def begin_another(sample):
        with pytest.raises(ValueError, match="method first instead of second"):
            write(data, out, name="second")
        assert list(out.glob("*.png")) == []
        return sparse(sample)

    predict(TASK, FunctionPredictor(begin_another, name="first"), data, out, sample_list=["000000"],
            workers=1)  # fmt: skip
    assert sorted(path.name for path in out.iterdir()) == ["000000.png", "sightline.json"]


def test_two_jobs_at_one_time_that_are_the_same_share_the_folder(data, out):
    def do_all(sample):
        write(data, out)
        return sparse(sample)

    assert write(data, out, do_all).written == 6
    write(data, out.with_name("alone"))
    assert contents_of(out) == contents_of(out.with_name("alone"))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_bad_frame_stops_the_job_in_one_line_and_once_repaired_it_goes_on(
    data, tmp_path, workers
):
    sweep = data / "training" / "velodyne" / "000003.bin"
    whole = sweep.read_bytes()
    sweep.write_bytes(whole[:-3])
    out = tmp_path / "out"
    with pytest.raises(ValueError, match=r"^sample 000003: [^\n]*000003\.bin[^\n]*$"):
        write(data, out, workers=workers)
    assert {"000000.png", "000001.png", "000002.png"} <= set(contents_of(out))
    assert "000003.png" not in contents_of(out)
    sweep.write_bytes(whole)
    assert write(data, out).skipped >= 3
    assert len(list(out.glob("*.png"))) == 6


def test_a_stop_in_the_middle_leaves_whole_files_only_and_the_rest_is_done_later(
    data, tmp_path, monkeypatch
):
    from sightline.data.formats import map_png

    def stop_while_writing(path, content):
        with original(path) as temporary:
            temporary.write_bytes(content[: len(content) // 2])
            raise KeyboardInterrupt

    write(data, tmp_path / "expected")
    out = tmp_path / "out"
    write(data, out)
    (out / "000001.png").unlink()
    (out / "000004.png").unlink()
    from sightline.files.atomic import atomic_path as original

    with monkeypatch.context() as patched:
        patched.setattr(map_png, "atomic_write_bytes", stop_while_writing)
        with pytest.raises(KeyboardInterrupt):
            write(data, out)
    left = contents_of(out)
    assert sorted(left) == sorted(
        set(contents_of(tmp_path / "expected")) - {"000001.png", "000004.png"}
    )
    assert write(data, out) == JobResult(written=2, skipped=4)
    assert contents_of(out) == contents_of(tmp_path / "expected")


SLOW_JOB = """
    import sys, time
    from pathlib import Path
    from tests.inference.function_predictor import sparse, write

    def slow(sample):
        time.sleep(0.2)
        return sparse(sample)

    if __name__ == "__main__":
        try:
            write(Path(sys.argv[1]), Path(sys.argv[2]), slow, workers=2)
        except KeyboardInterrupt:
            sys.exit("interrupted")
"""


def wait_for_files(job, out, number):
    limit = time.monotonic() + 120
    while len(list(out.glob("*.png"))) < number:
        assert job.poll() is None, job.communicate()
        assert time.monotonic() < limit, "the job wrote nothing"
        time.sleep(0.02)


@pytest.mark.parametrize("to_all", [True, False], ids=["as a terminal does", "to the parent only"])
def test_ctrl_c_ends_a_parallel_job_in_one_line_without_half_written_files(tmp_path, to_all):
    data, out = write_object_tree(tmp_path / "data", 24), tmp_path / "out"
    job = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(SLOW_JOB), data, out],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for_files(job, out, 3)
    (os.killpg if to_all else os.kill)(job.pid, signal.SIGINT)
    _, errors = job.communicate(timeout=60)
    assert errors == "interrupted\n"
    left = [path.name for path in out.iterdir() if path.suffix != ".png"]
    assert left == ["sightline.json"]
    written = sorted(out.glob("*.png"))
    assert 3 <= len(written) < 24
    assert all(read_depth_png(path).shape == IMAGE_SIZE for path in written)
    assert write(data, out) == JobResult(written=24 - len(written), skipped=len(written))


@pytest.mark.filterwarnings("ignore:.*in the checked frames")
def test_a_sweep_without_points_gives_a_map_without_depths(data, tmp_path):
    write_points(data / "training" / "velodyne" / "000000.bin", torch.zeros(0, 4))
    for method in ("nearest", "linear", "classical", "adaptive"):
        out = tmp_path / method
        with pytest.warns(UserWarning, match="clouds of 1 of 1 frames hold no point"):
            predict(TASK, DepthCompleter(method), data, out, sample_list=["000000"])
        assert not read_depth_png(out / "000000.png").any()


@pytest.mark.parametrize("method", ["nearest", "linear", "classical", "adaptive"])
def test_a_return_beyond_the_formats_reach_does_not_end_the_job(data, tmp_path, method):
    path = data / "training" / "velodyne" / "000000.bin"
    stray = torch.tensor([[300.0, 0.0, 0.0, 0.5]])
    write_points(path, torch.cat((read_points(path), stray)))
    out = tmp_path / method
    predict(TASK, DepthCompleter(method), data, out, sample_list=["000000"])
    depth_m = read_depth_png(out / "000000.png")
    assert depth_m.any()
    assert depth_m.max() < 200


def test_a_job_without_anything_to_do_is_done(data, out):
    write(data, out)
    assert write(data, out, workers=2) == JobResult(written=0, skipped=6)


def test_an_output_that_is_no_folder_is_refused(data, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file is no folder; name another output folder"):
        write(data, tmp_path / "file")
    with pytest.raises(ValueError, match="cannot be written"):
        write(data, tmp_path / "file" / "below")
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        write(data, tmp_path / "out", workers=0)


def test_a_sample_without_a_sweep_says_so(data):
    sample = open_dataset(data, parts=())[0]
    with pytest.raises(ValueError, match="sample 000000 has no sweep"):
        DepthCompleter("nearest")(sample)


def test_real_frames_and_a_real_drive_are_completed_at_full_size(kitti_root, tmp_path):
    drive = kitti_root / "raw" / "2011_09_26_drive_0052_sync"
    for data, name in ((kitti_root, "000002"), (drive, "0000000007")):
        out = tmp_path / name
        write_nearest(data, out, sample_list=[name], workers=1)
        sample = open_dataset(data, sample_list=[name], parts={"points"})[0]
        depth_m = read_depth_png(out / f"{name}.png")
        assert depth_m.shape == sample.image_size
        sparse_m = sparse(sample).depth_m.numpy()
        assert np.abs(depth_m - sparse_m)[sparse_m > 0].max() <= 0.5 / 256


def test_a_switch_changes_what_is_written_and_stands_in_the_manifest(data, tmp_path):
    def half_valid(sample):
        depth_m = torch.full(sample.image_size, 5.0)
        is_even = (torch.arange(sample.image_size[1]) % 2 == 0).expand(sample.image_size)
        return DepthMap(depth_m=depth_m, valid=is_even.clone())

    out = tmp_path / "out"
    predict(TASK, FunctionPredictor(half_valid), data, out, switches=["valid_only"], workers=1)
    written = read_depth_png(out / "000000.png")
    assert (written[:, ::2] == 5).all()
    assert (written[:, 1::2] == 0).all()
    assert json.loads((out / "sightline.json").read_text())["valid_only"] is True
    with pytest.raises(ValueError, match="valid_only True instead of none"):
        write(data, out, half_valid)
    with pytest.raises(ValueError, match="depth-completion has no switch fast; it has valid_only"):
        predict(TASK, FunctionPredictor(half_valid), data, out, switches=["fast"])


def test_kept_results_of_shards_that_were_packed_anew_are_told(data, out):
    def pack():
        write_shards(data, data.with_name("shards"), frames_per_shard=2)
        return data.with_name("shards")

    write(pack(), out)
    write(pack(), out)  # nothing was packed anew; warnings are errors here
    cloud = data / "training" / "velodyne" / "000002.bin"
    cloud.write_bytes(cloud.read_bytes()[:-16])
    told = "of 6 frames whose results are kept, 2 changed after .* first is 000002: .*packed since"
    with pytest.warns(UserWarning, match=f"{told}; .*--overwrite"):
        write(pack(), out)
    (data / "ImageSets").mkdir()
    (data / "ImageSets" / "list.txt").write_text("000001\n")
    assert write(pack(), out, overwrite=True).written == 6
    (data / "ImageSets" / "list.txt").write_text("000001\n000002\n")
    write(pack(), out)  # a list belongs to no frame


def test_a_newer_calibration_of_a_drive_is_newer_than_all_its_results(tmp_path, out):
    drive = write_drive(tmp_path / "day" / "drive")
    write(drive, out)
    later_ns = time.time_ns() + 10**10
    os.utime(tmp_path / "day" / "calib_velo_to_cam.txt", ns=(later_ns, later_ns))
    with pytest.warns(UserWarning, match="of 3 frames .* 3 changed after the result"):
        write(drive, out)


def by_both(sample):
    """Predict nothing, from either sensor."""
    empty = torch.zeros(sample.image_size)
    return DepthMap(depth_m=empty, valid=empty > 0)


BOTH = FunctionPredictor(by_both, parts=("image", "points"))


@pytest.mark.filterwarnings("ignore:.*no images. their size is guessed")
@pytest.mark.parametrize(("folder", "noun"), [("velodyne", "point clouds"), ("image_2", "images")])
def test_a_sensor_that_no_frame_has_is_told(data, out, folder, noun):
    shutil.rmtree(data / "training" / folder)
    with pytest.warns(UserWarning, match=f"no {noun} for 6 of 6 frames, the first is 000000"):
        predict(TASK, BOTH, data, out, workers=1)


def test_frames_without_a_sensor_among_others_are_counted(data, out):
    for name in ("000002", "000004"):
        (data / "training" / "velodyne" / f"{name}.bin").unlink()
    with pytest.warns(UserWarning, match="no point clouds for 2 of 6 frames, the first is 000002"):
        predict(TASK, BOTH, data, out, workers=1)


def test_frames_whose_point_clouds_hold_no_point_are_counted(data, out):
    for name in ("000003", "000005"):
        (data / "training" / "velodyne" / f"{name}.bin").write_bytes(b"")
    match = "clouds of 2 of 6 frames hold no point, the first is 000003; .* the LiDAR delivered"
    with pytest.warns(UserWarning, match=match):
        predict(TASK, BOTH, data, out, workers=1)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_frames_whose_images_have_a_single_colour_are_counted(data, out, suffix):
    images = data / "training" / "image_2"
    for name in ("000001", "000003"):
        (images / f"{name}.png").unlink()
        black = np.zeros((*IMAGE_SIZE, 3), np.uint8)
        Image.fromarray(black).save(images / f"{name}{suffix}")
    match = "images of 2 of 6 frames have a single colour, the first is 000001; .* the camera"
    with pytest.warns(UserWarning, match=match) as warned:
        predict(TASK, BOTH, data, out, workers=1)
    assert len(warned) == 1


def test_frames_whose_point_clouds_are_flat_or_nearly_empty_are_counted(data, out):
    path = data / "training" / "velodyne" / "000001.bin"
    points = read_points(path)
    points[:, 2] = 0
    write_points(path, points)
    other = path.with_name("000004.bin")
    write_points(other, read_points(other)[:5])
    match = "clouds of 2 of 6 frames are doubtful, the first is 000001, which .* the cloud is flat;"
    with pytest.warns(UserWarning, match=match) as warned:
        predict(TASK, BOTH, data, out, workers=1)
    assert len(warned) == 1


def test_a_frame_whose_points_miss_the_image_is_told_wherever_it_is(data, out):
    path = data / "training" / "velodyne" / "000001.bin"
    points = read_points(path)
    points[:, 0] *= -1
    write_points(path, points)
    match = r"sample 000001: none of its \d+ points falls into the image; check its calibration"
    with pytest.warns(UserWarning, match=match):
        predict(TASK, BOTH, data, out, workers=1)


def test_frames_with_both_sensors_give_no_warning(data, out):
    predict(TASK, BOTH, data, out, workers=1)  # warnings are errors here
