"""What a bag's folder holds beside the files that are read."""

import shutil

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import get_types_from_msg

from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import CAMERA_FROM_LIDAR, POINTS, BagMaker, Ros1BagMaker, usual_topics


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags") / "drive"
    with BagMaker(folder) as bag:
        usual_topics(bag)
    return folder


def mcap_of(drive):
    return next(drive.glob("*.mcap"))


def test_suffixes_may_be_in_capitals_and_hidden_files_do_no_harm(tmp_path, drive):
    (tmp_path / "in").mkdir()
    shutil.copy(mcap_of(drive), tmp_path / "in" / "DRIVE.MCAP")
    (tmp_path / "in" / "._DRIVE.mcap").write_bytes(b"\0\5\x16\7 of macOS")
    shutil.copytree(drive, tmp_path / "in" / "#recycle")  # of a network drive
    for out, source in (("a", "in"), ("b", "in/DRIVE.MCAP")):
        report = import_recording(tmp_path / source, tmp_path / out)
        assert report.written == 2
        assert "not read" not in str(report)


@pytest.mark.parametrize("name", ["other.mcap", "other.MCAP.zst", "other.bag.active"])
@pytest.mark.parametrize("has_metadata", [True, False])
def test_bag_files_that_are_not_read_are_told(tmp_path, drive, name, has_metadata):
    shutil.copytree(drive, tmp_path / "drive")
    if not has_metadata:
        (tmp_path / "drive" / "metadata.yaml").unlink()
    (tmp_path / "drive" / name).write_bytes(mcap_of(drive).read_bytes())
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    is_told = has_metadata or name != "other.mcap"
    assert (f"warning: 1 bag files in the folder are not read, e.g. {name}" in report) == is_told


def test_the_other_files_of_a_split_bag_are_told_where_one_is_given(tmp_path, drive):
    shutil.copytree(drive, tmp_path / "drive")
    first = mcap_of(tmp_path / "drive")
    import_recording(first, tmp_path / "alone")  # a warning would be an error
    shutil.copy(first, tmp_path / "drive" / "second.mcap")
    metadata = tmp_path / "drive" / "metadata.yaml"
    listed = f"  - {first.name}\n"
    assert listed in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(listed, f"{listed}  - second.mcap\n"))
    with pytest.warns(
        UserWarning, match=r"one of 2 files of a drive, .*; the others, e\.g\. second\.mcap, are"
    ):
        assert import_recording(first, tmp_path / "out").written == 2


def test_a_line_break_in_the_name_of_the_output_forges_no_line(tmp_path, drive):
    report = str(import_recording(drive, tmp_path / "out\nforged"))
    assert not any(line.startswith("forged") for line in report.split("\n"))


def test_bags_in_folders_below_one_are_told(tmp_path, drive):
    shutil.copytree(drive, tmp_path / "drive")
    assert "folders below" not in str(import_recording(tmp_path / "drive", tmp_path / "sound"))
    shutil.copytree(drive, tmp_path / "drive" / "more")
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "warning: 1 bags in folders below are not read, e.g. more: a drive's files" in report


def test_a_listed_file_beside_its_packed_copy_is_no_matter(tmp_path, drive):
    shutil.copytree(drive, tmp_path / "drive")
    (tmp_path / "drive" / f"{mcap_of(drive).name}.zstd").touch()
    assert "not read" not in str(import_recording(tmp_path / "drive", tmp_path / "out"))


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("a.db3.gz", "a.db3.gz: is a packed bag; unpack it"),
        ("a.mcap.ZSTD", "a.mcap.ZSTD: is a packed bag; unpack it"),
        ("a.bag.active", "a.bag.active: is a recording that was not closed; repair it by"),
    ],
)
@pytest.mark.parametrize("is_folder", [True, False])
def test_packed_and_open_bags_are_named_as_such(tmp_path, name, cause, is_folder):
    (tmp_path / name).touch()
    with pytest.raises(ValueError, match=cause):
        import_recording(tmp_path if is_folder else tmp_path / name, tmp_path.parent / "out")


def test_the_damaged_one_of_several_files_is_named(tmp_path, drive):
    shutil.copy(mcap_of(drive), tmp_path / "a.mcap")
    (tmp_path / "b.mcap").touch()
    with pytest.raises(ValueError, match=r"b\.mcap cannot be read .* empty; nothing was recorded"):
        import_recording(tmp_path, tmp_path.parent / "out")


@pytest.mark.parametrize(
    ("kind", "repair"), [("db3", "sqlite3 OLD.db3 .recover"), ("bag", "rosbag reindex")]
)
def test_a_bag_that_is_cut_short_is_named_with_its_repair(tmp_path, kind, repair):
    path = tmp_path / "drive.bag"
    if kind == "db3":
        with BagMaker(tmp_path / "drive", storage=StoragePlugin.SQLITE3) as bag:
            usual_topics(bag)
        path = tmp_path / "drive" / "drive.db3"
    else:
        with Ros1BagMaker(path) as bag:
            usual_topics(bag)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(ValueError, match=f"not closed or is cut short: .*{repair}"):
        import_recording(path, tmp_path / "out")


@pytest.mark.parametrize(
    "kind", ["livox_ros_driver2/msg/CustomMsg", "nebula_msgs/msg/NebulaPackets"]
)
def test_messages_of_a_driver_are_named_with_the_way_on(tmp_path, kind):
    with BagMaker(tmp_path / "bag") as bag:
        bag.types.register(get_types_from_msg("std_msgs/Header header", kind))
        bag.image("/image_raw", 10**9)
        bag.write("/livox", bag.new(kind, header=bag.header("lidar", 10**9)), 10**9)
    with pytest.raises(
        ValueError, match=f"{kind} are not read: let the driver publish PointCloud2"
    ):
        import_recording(tmp_path / "bag", tmp_path / "out")


def test_few_compressed_images_do_not_replace_many_raw_ones(tmp_path):
    with BagMaker(tmp_path / "bag") as bag:
        usual_topics(bag, number=3)
        bag.jpeg("/front/image_raw/compressed", 2 * 10**9, b"of a viewer that was open for long")
    with pytest.raises(ValueError, match=r"image_raw \(Image, 3\), .*choose one by --camera-topic"):
        import_recording(tmp_path / "bag", tmp_path / "out")


def test_messages_without_a_partner_are_a_warning_if_they_are_most(tmp_path):
    with BagMaker(tmp_path / "bag") as bag:
        usual_topics(bag, number=1)
        for at in range(2):
            bag.image("/front/image_raw", (20 + at) * 10**9)
            bag.cloud("/points", (40 + at) * 10**9)
    report = str(import_recording(tmp_path / "bag", tmp_path / "out"))
    assert "warning: only 1 of 3 images have a partner within 0.05 s by header time" in report


def test_intensities_of_which_none_is_finite_are_a_warning(tmp_path):
    points = POINTS.copy()
    points[:, 3] = np.nan
    with BagMaker(tmp_path / "bag") as bag:
        bag.transforms("/tf_static", 1, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9, points=points)
    report = str(import_recording(tmp_path / "bag", tmp_path / "out"))
    assert f"warning: all {len(points)} points have a non-finite intensity" in report


def test_a_folder_that_holds_the_bag_s_folder_names_it(tmp_path, drive):
    for name in ("first", "second"):
        shutil.copytree(drive, tmp_path / "in" / name)
    with pytest.raises(ValueError, match=r"no bag itself, but .*in/first in it is one, and 1 more"):
        import_recording(tmp_path / "in", tmp_path / "out")
