"""Messages that a bag counts but are not read, and messages that are not in CDR."""

import re
import shutil
import struct

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import CAMERA_FROM_LIDAR, BagMaker, Ros1BagMaker, usual_topics

SCHEMA, CHANNEL, CHUNK_INDEX, STATISTICS = 3, 4, 8, 11


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Bag of three frames in an MCAP file of several chunks."""
    folder = tmp_path_factory.mktemp("bags") / "drive"
    with BagMaker(folder) as bag:
        usual_topics(bag, number=3)
    return folder


def mcap_of(drive):
    return next(drive.glob("*.mcap"))


def without_records(content, kind, numbers=range(100)):
    """MCAP file whose summary lacks the records of a kind with these numbers."""
    (at,) = struct.unpack_from("<Q", content, len(content) - 28)  # in the footer
    parts, number = [content[:at]], 0
    while at < len(content) - 8:
        end = at + 9 + struct.unpack_from("<Q", content, at + 1)[0]
        if content[at] != kind or number not in numbers:
            parts.append(content[at:end])
        number += content[at] == kind
        at = end
    return b"".join((*parts, content[at:]))


def test_messages_that_the_index_of_a_file_lacks_are_told(tmp_path, drive):
    path = tmp_path / "drive.mcap"
    path.write_bytes(without_records(mcap_of(drive).read_bytes(), CHUNK_INDEX, {1}))
    report = import_recording(path, tmp_path / "out")
    assert report.written == 1  # the chunk holds a cloud and the next image
    assert re.search(
        r"warning: only 2 of the 3 messages of /points that the bag.s stat", str(report)
    )
    assert "messages of /tf_static" not in str(report)
    path.write_bytes(without_records(mcap_of(drive).read_bytes(), CHUNK_INDEX, {1, 2, 3}))
    with pytest.raises(
        ValueError, match=r"only 0 of the 3 messages of /points .*; write the bag an"
    ):
        import_recording(path, tmp_path / "none")


@pytest.mark.parametrize(
    "left_out",
    [
        [(CHANNEL, range(100))],
        [(CHANNEL, {2})],
        [(SCHEMA, range(100))],
        [(SCHEMA, {1})],
        [(CHANNEL, {1}), (STATISTICS, {0})],
        [(SCHEMA, {2}), (STATISTICS, {0})],
    ],
)
def test_channels_and_schemas_that_a_summary_leaves_out_are_read_from_the_file(
    tmp_path, drive, left_out
):
    content = mcap_of(drive).read_bytes()
    shorter = content
    for kind, numbers in left_out:
        shorter = without_records(shorter, kind, numbers)
    assert len(shorter) < len(content)
    for name, each in (("whole", content), ("shorter", shorter)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "drive.mcap").write_bytes(each)
        report = import_recording(tmp_path / name / "drive.mcap", tmp_path / f"{name}-out")
        assert report.written == 3
    for path in sorted((tmp_path / "whole-out").glob("*/*")):
        again = tmp_path / "shorter-out" / path.relative_to(tmp_path / "whole-out")
        assert again.read_bytes() == path.read_bytes()


def test_messages_that_only_the_metadata_count_are_told(tmp_path, drive):
    shutil.copytree(drive, tmp_path / "drive")
    with BagMaker(tmp_path / "short") as bag:
        usual_topics(bag, number=2)
    shutil.copy(mcap_of(tmp_path / "short"), mcap_of(tmp_path / "drive"))
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert report.written == 2
    lines = [line for line in report.notes if "metadata.yaml counts" in line]
    topics = ("/front/camera_info", "/front/image_raw", "/points")
    for line, topic in zip(lines, topics, strict=True):
        assert line.startswith(f"warning: the bag holds 2 of the 3 messages of {topic} that meta")


@pytest.mark.parametrize("topics", [None, 7, [7, {"message_count": "many"}], []])
def test_metadata_without_counts_are_no_matter(tmp_path, drive, topics):
    shutil.copytree(drive, tmp_path / "drive")
    path = tmp_path / "drive" / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"]["topics_with_message_count"] = topics
    path.write_text(yaml.safe_dump(content))
    assert "warning" not in str(import_recording(tmp_path / "drive", tmp_path / "out"))


@pytest.mark.parametrize(
    "kind", ["ros1", "db3", "mcap", "split", "file", "message", "storage", "no_metadata"]
)
def test_sound_bags_of_all_kinds_hold_what_they_count(tmp_path, kind):
    path = tmp_path / ("drive.bag" if kind == "ros1" else "drive")
    storage = StoragePlugin.SQLITE3 if kind in ("db3", "message") else StoragePlugin.MCAP
    bag = Ros1BagMaker(path) if kind == "ros1" else BagMaker(path, storage=storage)
    if kind in ("file", "message", "storage"):
        bag._writer.set_compression(CompressionMode[kind.upper()], CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag, number=3)
    if kind == "no_metadata":
        (path / "metadata.yaml").unlink()
    if kind == "split":
        split(path)
    report = import_recording(path, tmp_path / "out")
    assert report.written == (6 if kind == "split" else 3)
    assert "warning" not in str(report)


def split(folder):
    """Add a second file to a bag, of three later frames."""
    with BagMaker(folder.parent / "later") as bag:
        for at in range(3, 6):
            bag.image("/front/image_raw", 2 * 10**9 + at * 10**8)
            bag.cloud("/points", 2 * 10**9 + at * 10**8)
    later = mcap_of(folder.parent / "later")
    shutil.copy(later, folder)
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    about = content["rosbag2_bagfile_information"]
    about["relative_file_paths"].append(later.name)
    for each in about["topics_with_message_count"]:
        if each["topic_metadata"]["name"] in ("/front/image_raw", "/points"):
            each["message_count"] += 3
    path.write_text(yaml.safe_dump(content))


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_compressed_messages_are_read_without_metadata(tmp_path, storage):
    bag = BagMaker(tmp_path / "drive", storage=storage)
    bag._writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag)
    (path,) = set((tmp_path / "drive").iterdir()) - {tmp_path / "drive" / "metadata.yaml"}
    assert import_recording(path, tmp_path / "out").written == 2


def test_messages_in_another_encoding_are_named_by_it(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        usual_topics(bag)
    path = mcap_of(tmp_path / "drive")
    content = path.read_bytes()
    in_json = content.replace(b"/points\x03\0\0\0cdr", b"/points\x03\0\0\0jsn")
    assert in_json != content
    path.write_bytes(in_json)  # the channel alone may say so: the messages are in CDR
    assert import_recording(path, tmp_path / "sound").written == 2
    start_of_cloud = rb"(?s)\0\x01\0\0.{8}(?=\x06\0\0\0lidar)"
    content, number = re.subn(start_of_cloud, b'{"header":{}', in_json)
    assert number == 2
    path.write_bytes(content)
    with pytest.raises(
        ValueError,
        match=r"of /points: they are encoded as jsn, expected cdr; convert it to a ROS 2",
    ):
        import_recording(path, tmp_path / "out")


@pytest.mark.parametrize("is_indexed", [True, False])
def test_chunks_of_another_compression_are_no_damage(tmp_path, is_indexed):
    bag = BagMaker(tmp_path / "drive")
    bag._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag, number=1)
    path = mcap_of(tmp_path / "drive")
    content = path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0none")
    if not is_indexed:  # no summary
        content = content[:-28] + bytes(20) + content[-8:]
    path.write_bytes(content)
    with pytest.raises(
        ValueError, match=r"compression 'none'; write it anew with chunks that are c"
    ):
        import_recording(path, tmp_path / "out")


@pytest.mark.parametrize("maker", [BagMaker, Ros1BagMaker])
def test_a_drive_that_a_folder_holds_twice_is_read_once(tmp_path, maker):
    """Images are received late, so pairs by the time of receipt would be wrong."""
    source = tmp_path / "source"
    with maker(source if maker is BagMaker else tmp_path / "source.bag") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(6):
            time_ns = 2 * 10**9 + at * 10**8
            bag.info("/front/camera_info", time_ns)
            bag.image("/front/image_raw", time_ns, shift_ns=9 * 10**7)
            bag.cloud("/points", time_ns)
    original = mcap_of(source) if maker is BagMaker else tmp_path / "source.bag"
    twice = tmp_path / "twice"
    twice.mkdir()
    for name in ("drive", "drive.orig"):
        shutil.copy(original, twice / f"{name}{original.suffix}")
    report = str(import_recording(twice, tmp_path / "out"))
    assert "paired 6 of 6 images and 6 sweeps by header time, 0.0 ms apart at most" in report
    assert "6 messages of /front/image_raw in drive.orig" in report
    assert "stand still" not in report
    assert "statistics count" not in report
