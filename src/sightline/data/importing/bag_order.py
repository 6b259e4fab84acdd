"""Order of a bag's messages in its files, in which the recorder wrote them.

Readers sort by the time of receipt: after a clock that was set back, by two moments at once.
"""

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader

    from sightline.data.importing.bag_files import Reader

_MESSAGE_INDEX: Final = b"\x07"
"""Opcode of the record of an MCAP file that lists a channel's messages in a chunk."""
_ENTRY: Final = np.dtype([("received_ns", "<u8"), ("offset", "<u8")])


def times_in_file(reader: "Reader", connections: "Collection[Connection]") -> Iterator[int]:
    """Yield the times of receipt [ns] of a file's messages in their order in the file.

    They are read from the file's index, if it has one.

    Raises:
        Exception: The index is damaged; any error of the library.
    """
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    ids = [each.id for each in connections]
    if isinstance(reader, Sqlite3Reader):
        assert reader.dbconn is not None, "the bag is open"
        places = ",".join("?" * len(ids))
        query = f"SELECT timestamp FROM messages WHERE topic_id IN ({places}) ORDER BY id"  # noqa: S608
        for (received_ns,) in reader.dbconn.execute(query, ids):
            yield int(str(received_ns))
    elif not isinstance(reader, McapReader):
        entries = [entry for each in ids for entry in reader.indexes[each]]
        entries.sort(key=lambda entry: (entry.chunk_pos, entry.offset))
        yield from (entry.time for entry in entries)
    elif reader.chunks:
        for chunk in sorted(reader.chunks, key=lambda chunk: chunk.chunk_start_offset):
            yield from _times_in_chunk(reader, chunk, ids)
    else:
        yield from (received_ns for _, received_ns, _ in reader.messages_scan(connections))


def _times_in_chunk(reader: "McapReader", chunk: "ChunkInfo", ids: Collection[int]) -> list[int]:
    """Read the times of receipt of a chunk's messages of some channels, in its order."""
    from rosbags.rosbag2 import storage_mcap

    assert reader.bio is not None, "the bag is open"
    entries = [np.empty(0, _ENTRY)]
    for each in chunk.message_index_offsets.keys() & set(ids):
        reader.bio.seek(chunk.message_index_offsets[each])
        if reader.bio.read(1) != _MESSAGE_INDEX:
            raise ValueError("an index of messages is not where the summary says")
        record = storage_mcap.read_sized(reader.bio)
        entries.append(np.frombuffer(record[6:], _ENTRY))  # after the channel and the length
    merged = np.concatenate(entries)
    times: list[int] = merged["received_ns"][np.argsort(merged["offset"])].tolist()
    return times
