"""Limits on what `rosbags` reads: sizes, claimed lengths, and parts of a file that may be wrong."""

import bz2
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from io import BufferedIOBase, BytesIO
from typing import TYPE_CHECKING, Any, Final, Protocol

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2.storage_mcap import McapReader

MAX_DECOMPRESSED_BYTES: Final = 2**29
"""Largest decompressed chunk or message: recorders write chunks of a few megabytes."""
STEP_BYTES: Final = 2**22
"""Number of bytes that are read or decompressed at once."""

_Read = Callable[[Any, int], bytes]


class _Decompressor(Protocol):
    """Incremental decompressor, as in `bz2`, `lz4` and `zstd`."""

    eof: bool
    needs_input: bool
    unused_data: bytes | None

    def decompress(self, data: bytes, max_length: int = -1, /) -> bytes: ...


def decompressed(new: Callable[[], Any], compressed: bytes, limit: int) -> bytes:
    """Decompress within a limit.

    Args:
        new: Creates a decompressor of one frame.
        compressed: One compressed frame or several.
        limit: Largest number of decompressed bytes.

    Raises:
        ValueError: The frames decompress to more, or are truncated.
    """
    parts: list[bytes] = []
    room = limit
    while compressed:
        decompressor: _Decompressor = new()
        parts.append(decompressor.decompress(compressed, min(room + 1, STEP_BYTES)))
        room -= len(parts[-1])
        while room >= 0 and not decompressor.eof:
            parts.append(decompressor.decompress(b"", min(room + 1, STEP_BYTES)))
            room -= len(parts[-1])
            if not parts[-1] and decompressor.needs_input:
                raise ValueError("compressed data are cut short")
        if room < 0:
            raise ValueError(f"compressed data decompress to more than {limit} bytes")
        compressed = decompressor.unused_data or b""
    return b"".join(parts)


def decompressed_zstd(compressed: bytes) -> bytes:
    """Decompress a message; errors as in `decompressed`."""
    return decompressed(zstd_module().ZstdDecompressor, compressed, MAX_DECOMPRESSED_BYTES)


@contextmanager
def bounded_library() -> Iterator[None]:
    """Make `rosbags` decompress chunks within limits, and ignore what is not needed of a bag.

    `rosbags` has no limit of its own: a chunk of 10 MB may decompress to any size, and a record may
    claim any length. Quality of service (YAML in each topic), definitions of messages and a missing
    profile of an MCAP file would make the bag unreadable by any fault, or by any other encoding. A
    summary of an MCAP file is taken for complete, although it may leave out channels and schemas.
    """
    from lz4.frame import LZ4FrameDecompressor
    from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import storage_mcap, storage_sqlite3

    undefined = MessageDefinition(MessageDefinitionFormat.NONE, "")
    zstd = zstd_module().ZstdDecompressor
    chunks = {
        "": lambda data, _: data,
        "lz4": lambda data, size: decompressed(
            LZ4FrameDecompressor, data, _checked_chunk_size(size)
        ),
        "zstd": lambda data, size: decompressed(zstd, data, _checked_chunk_size(size)),
    }
    old_chunks = {
        "none": lambda data: data,
        "bz2": lambda data: decompressed(bz2.BZ2Decompressor, data, MAX_DECOMPRESSED_BYTES),
        "lz4": lambda data: decompressed(LZ4FrameDecompressor, data, MAX_DECOMPRESSED_BYTES),
    }
    changes: list[tuple[Any, str, object]] = [
        (storage_mcap, "DECOMPRESSORS", chunks),
        (ros1, "decompressors", old_chunks),
        (storage_mcap, "read_exact", _bounded(storage_mcap.read_exact)),
        (ros1, "read_bytes", _bounded(ros1.read_bytes)),
        (storage_mcap, "read_string", _or_ros2(storage_mcap.read_string)),
        (storage_mcap, "get_msgdef", lambda _: undefined),
        (storage_mcap.McapReader, "read_index", _completed(storage_mcap.McapReader.read_index)),
        (storage_mcap, "parse_qos", lambda _: []),
        (storage_sqlite3, "parse_qos", lambda _: []),
    ]
    before = [(module, name, getattr(module, name)) for module, name, _ in changes]
    try:
        for module, name, value in changes:
            setattr(module, name, value)
        yield
    finally:
        for module, name, value in before:
            setattr(module, name, value)


def _bounded(read: _Read) -> _Read:
    """Make a function that reads bytes refuse more than are left, before it allocates them."""

    def read_bounded(file: BufferedIOBase, size: int) -> bytes:
        if size > STEP_BYTES:
            start = file.tell()
            num_left = file.seek(0, os.SEEK_END) - start
            file.seek(start)
            if size > num_left:
                raise ValueError(
                    f"a record at byte {start} claims {size} bytes, but {num_left} are left"
                )
        return read(file, size)

    return read_bounded


def _or_ros2(read: Callable[[BytesIO], str]) -> Callable[[BytesIO], str]:
    """Make a function that reads strings take an empty profile, the first of a record, as ROS 2."""
    return lambda record: read(record) or "ros2" if record.tell() == 0 else read(record)


def _completed(read_index: Callable[["McapReader"], None]) -> Callable[["McapReader"], None]:
    """Make a function that reads a file's summary scan the file for what the summary leaves out."""

    def read_completed(reader: "McapReader") -> None:
        read_index(reader)
        lacks_messages = not all(chunk.message_index_offsets for chunk in reader.chunks)
        if lacks_messages or _lacks_channels(reader) or _lacks_counts(reader):
            for each in (reader.schemas, reader.channels, reader.connections):
                each.clear()
            reader.meta_scan()
        if lacks_messages:  # they are found by reading the chunks
            reader.chunks.clear()

    return read_completed


def _lacks_channels(reader: "McapReader") -> bool:
    """Test whether a file's summary repeats fewer channels or schemas than the file holds."""
    counted = reader.statistics
    if counted is not None:
        return (
            len(reader.schemas) < counted.schema_count
            or len(reader.channels) < counted.channel_count
        )
    used = {channel for chunk in reader.chunks for channel in chunk.message_index_offsets}
    has_unknown = any(each.schema == "__schemaless__" for each in reader.channels.values())
    return has_unknown or not used <= reader.channels.keys()


def _lacks_counts(reader: "McapReader") -> bool:
    """Test whether a file's summary leaves out the numbers of messages of each channel."""
    counted = reader.statistics
    return counted is not None and (
        sum(counted.channel_message_counts.values()) != counted.message_count
    )


def _checked_chunk_size(size: int) -> int:
    if size > MAX_DECOMPRESSED_BYTES:
        raise ValueError(f"a chunk declares {size} bytes, expected up to {MAX_DECOMPRESSED_BYTES}")
    return size


def zstd_module() -> Any:  # noqa: ANN401 - a module
    """Module with which `rosbags` decompresses; from Python's library since 3.14."""
    from rosbags.rosbag2 import storage_mcap

    return vars(storage_mcap)["zstd"]


def scanned_messages(
    reader: "McapReader", connections: "Collection[Connection]"
) -> "Iterator[tuple[Connection, int, bytes]]":
    """Yield the messages of an MCAP file without an index in the order of receipt.

    `rosbags` refuses a file that holds them in another order. Here the file is read twice: for the
    order, then for the messages, which are held back until it is their turn.

    Raises:
        ValueError: Messages lie so far from their place that memory cannot hold those between.
    """
    times = [received_ns for _, received_ns, _ in reader.messages_scan(connections)]
    order = sorted(range(len(times)), key=times.__getitem__)
    turns = dict(zip(order, range(len(order)), strict=True))
    held: dict[int, tuple[Connection, int, bytes]] = {}
    num_bytes, turn = 0, 0
    for number, message in enumerate(reader.messages_scan(connections)):
        held[turns[number]] = message
        num_bytes += len(message[2])
        if num_bytes > MAX_DECOMPRESSED_BYTES:
            raise ValueError("messages without an index are far from their order: use `mcap sort`")
        while turn in held:
            num_bytes -= len(held[turn][2])
            yield held.pop(turn)
            turn += 1
