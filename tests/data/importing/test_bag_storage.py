"""Bags as recorders store them: without an index, with a journal, packed and unpacked files."""

import shutil
import sqlite3
import struct

import pytest
import yaml
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from sightline.data.importing import bag_limits
from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import BagMaker, usual_topics

MAGIC, HEADER_BYTES = b"\x89MCAP0\r\n", 9
MESSAGE, CHUNK, CHUNK_INDEX, STATISTICS, DATA_END, UNKNOWN = 5, 6, 8, 11, 15, 200


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Bag of three frames in an MCAP file."""
    folder = tmp_path_factory.mktemp("bags") / "drive"
    with BagMaker(folder) as bag:
        usual_topics(bag, number=3)
    return folder


def frames_of(recording):
    """Bytes of the images and points of a recording, and its calibration."""
    return {
        path.relative_to(recording): path.read_bytes()
        for path in recording.rglob("*")
        if path.suffix in (".png", ".bin", ".jpg") or path.name == "calibration.yaml"
    }


def records(content, at=0):
    """Yield the kind and the bytes of each record, of those in chunks, too."""
    while at < len(content):
        kind, end = content[at], at + HEADER_BYTES + struct.unpack_from("<Q", content, at + 1)[0]
        if kind == DATA_END:
            return
        if kind == CHUNK:  # uncompressed: times, size and checksum, "", length
            yield from records(content[at + HEADER_BYTES + 28 + 4 + 8 : end])
        else:
            yield kind, content[at:end]
        at = end


def without_index(content, order):
    """Write an MCAP file without chunks and summary, with its messages in another order."""
    parts = [*records(content, len(MAGIC))]
    messages = [part for kind, part in parts if kind == MESSAGE]
    others = [part for kind, part in parts if kind != MESSAGE]
    end = bytes([DATA_END]) + struct.pack("<QI", 4, 0)
    footer = bytes([2]) + struct.pack("<QQQI", 20, 0, 0, 0)
    return b"".join((MAGIC, *others, *(messages[at] for at in order(messages)), end, footer, MAGIC))


@pytest.mark.parametrize("is_reversed", [False, True])
def test_messages_without_an_index_are_read_in_the_order_of_receipt(tmp_path, drive, is_reversed):
    path = next(drive.glob("*.mcap"))
    plain = tmp_path / path.name

    def order(messages):
        numbers = range(len(messages))
        return reversed(numbers) if is_reversed else [*numbers[3:5], *numbers[:3], *numbers[5:]]

    plain.write_bytes(without_index(path.read_bytes(), order))
    assert import_recording(plain, tmp_path / "out").written == 3
    import_recording(path, tmp_path / "expected")
    assert frames_of(tmp_path / "out") == frames_of(tmp_path / "expected")


def without_offsets(content, *, has_counts):
    """MCAP file whose index of chunks names no messages, perhaps with other statistics."""
    changed = bytearray(content)
    (at,) = struct.unpack_from("<Q", content, len(content) - 28)  # the summary, by the footer
    while at < len(content) - len(MAGIC):
        start, end = (
            at + HEADER_BYTES,
            at + HEADER_BYTES + struct.unpack_from("<Q", content, at + 1)[0],
        )
        if content[at] == CHUNK_INDEX:  # four numbers, offsets by channel, three fields and texts
            (num_bytes,) = struct.unpack_from("<I", content, start + 32)
            rest = content[start + 36 + num_bytes : end]
            changed[start + 32 : end] = bytes(4) + rest + bytes(num_bytes)
        elif content[at] == STATISTICS and not has_counts:
            changed[at] = UNKNOWN
        at = end
    return bytes(changed)


@pytest.mark.parametrize("has_counts", [True, False])
def test_chunks_whose_index_names_no_messages_are_read(tmp_path, drive, has_counts):
    path = next(drive.glob("*.mcap"))
    (tmp_path / path.name).write_bytes(without_offsets(path.read_bytes(), has_counts=has_counts))
    assert import_recording(tmp_path / path.name, tmp_path / "out").written == 3
    import_recording(path, tmp_path / "expected")
    assert frames_of(tmp_path / "out") == frames_of(tmp_path / "expected")


def test_a_file_whose_statistics_name_no_channels_is_read(tmp_path, drive):
    path = next(drive.glob("*.mcap"))
    changed = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<Q", changed, len(changed) - 28)
    while changed[at] != STATISTICS:
        at += HEADER_BYTES + struct.unpack_from("<Q", changed, at + 1)[0]
    counts = at + HEADER_BYTES + 42  # after seven numbers; its length, then channels and numbers
    assert struct.unpack_from("<I", changed, counts)[0] > 0
    changed[counts : counts + 4] = bytes(4)
    (tmp_path / path.name).write_bytes(changed)
    assert import_recording(tmp_path / path.name, tmp_path / "out").written == 3
    import_recording(path, tmp_path / "expected")
    assert frames_of(tmp_path / "out") == frames_of(tmp_path / "expected")


@pytest.mark.parametrize(("folder", "written"), [("images", 1), ("points", 0)])
def test_an_empty_image_is_written_again_and_an_empty_cloud_is_one_without_a_point(
    tmp_path, drive, folder, written
):
    import_recording(drive, tmp_path / "out")
    whole = frames_of(tmp_path / "out")
    next((tmp_path / "out" / folder).iterdir()).write_bytes(b"")
    assert import_recording(drive, tmp_path / "out").written == written
    assert (frames_of(tmp_path / "out") == whole) == bool(written)


def test_messages_without_an_index_that_are_far_from_their_order_do_not_fill_the_memory(
    tmp_path, monkeypatch, drive
):
    path = tmp_path / "drive.mcap"
    content = next(drive.glob("*.mcap")).read_bytes()
    path.write_bytes(without_index(content, lambda messages: reversed(range(len(messages)))))
    monkeypatch.setattr(bag_limits, "MAX_DECOMPRESSED_BYTES", 1000)
    with pytest.raises(ValueError, match="are far from their order: use `mcap sort`"):
        import_recording(path, tmp_path / "out")


@pytest.fixture
def database(tmp_path):
    """Bag of three frames in a sqlite3 file with characters that have meanings in a URL."""
    with BagMaker(tmp_path / "plain", storage=StoragePlugin.SQLITE3) as bag:
        usual_topics(bag, number=3)
    folder = (tmp_path / "plain").rename(tmp_path / "run#1?%41")
    return next(folder.glob("*.db3"))


def test_a_database_is_read_under_any_name(database, tmp_path):
    assert import_recording(database, tmp_path / "file").written == 3
    assert import_recording(database.parent, tmp_path / "folder").written == 3


@pytest.mark.parametrize("mode", ["WAL", "PERSIST"])
def test_messages_in_the_journal_of_a_recorder_that_did_not_end_are_told(database, tmp_path, mode):
    killed = tmp_path / "killed.db3"
    with sqlite3.connect(database, isolation_level=None) as writer:
        writer.execute(f"PRAGMA journal_mode={mode}")
        writer.execute("DELETE FROM messages WHERE id = (SELECT max(id) FROM messages)")
        for ending in ("", "-wal", "-journal"):
            if database.with_name(database.name + ending).is_file():
                shutil.copy(f"{database}{ending}", f"{killed}{ending}")
    writer.close()
    if mode == "PERSIST":  # its journal has a head of zeros: nothing is to be done
        assert import_recording(killed, tmp_path / "out").written > 0
        return
    with pytest.raises(ValueError, match=r"has a journal beside it, killed\.db3-wal: the recorder"):
        import_recording(killed, tmp_path / "out")


@pytest.mark.parametrize("listed", ["packed", "unpacked"])
def test_files_that_were_unpacked_by_hand_are_read(tmp_path, listed):
    bag = BagMaker(tmp_path / "drive")
    bag._writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with bag:
        usual_topics(bag, number=3)
    import_recording(tmp_path / "drive", tmp_path / "expected")
    packed = next((tmp_path / "drive").glob("*.zstd"))
    (tmp_path / "drive" / packed.stem).write_bytes(
        bag_limits.decompressed_zstd(packed.read_bytes())
    )
    packed.unlink()
    if listed == "unpacked":
        metadata = tmp_path / "drive" / "metadata.yaml"
        about = yaml.safe_load(metadata.read_text())
        about["rosbag2_bagfile_information"]["relative_file_paths"] = [packed.stem]
        metadata.write_text(yaml.safe_dump(about))
    assert import_recording(tmp_path / "drive", tmp_path / "out").written == 3
    assert frames_of(tmp_path / "out") == frames_of(tmp_path / "expected")
