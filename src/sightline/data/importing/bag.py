"""Reader of ROS 2 bags (sqlite3 and MCAP) and ROS 1 bags: topics and messages, by `rosbags`."""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Int64

from sightline.data.importing.bag_files import (
    CONVERSION_REMEDY,
    METADATA_NAME,
    files_without_metadata,
    is_bag_file,
    one_line,
    open_files,
)
from sightline.data.importing.bag_limits import decompressed_zstd, scanned_messages
from sightline.data.importing.bag_order import times_in_file
from sightline.files.plain_text import shortened
from sightline.files.problem import install_command

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

    from sightline.data.importing.bag_files import Counts, Reader

IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE: Final = "sensor_msgs/msg/CompressedImage"
CLOUD: Final = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"

_KINDS: Final = {
    ("sensor_msgs", "image"): IMAGE,
    ("sensor_msgs", "compressedimage"): COMPRESSED_IMAGE,
    ("sensor_msgs", "pointcloud2"): CLOUD,
    ("sensor_msgs", "camerainfo"): CAMERA_INFO,
    ("tf2_msgs", "tfmessage"): TRANSFORMS,
    ("tf", "tfmessage"): TRANSFORMS,
}
"""Supported kinds of messages, by package and name in lower case."""
_MAX_NODES: Final = 5  # in a sentence
_TIME_LIMIT_NS: Final = 2**62
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"  # no message in CDR begins so
_CDR: Final = "cdr"
_NO_CDR: Final = f", expected {_CDR}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """Topic of a bag."""

    name: str
    kind: str
    """Type of the messages, e.g. sensor_msgs/msg/Image."""
    count: int
    """Number of messages."""

    def __str__(self) -> str:
        """Describe the topic in errors."""
        kind = self.kind.rpartition("/")[2] if self.kind in _KINDS.values() else self.kind
        return f"{shortened(self.name)} ({shortened(kind)}, {self.count})"


@dataclass(frozen=True, slots=True)
class Message:
    """Message of a bag."""

    topic: str
    number: int
    """Index among the messages of the topic, from 0."""
    received_ns: int
    content: Any
    """Content with the fields of its type."""

    @property
    def stamp_ns(self) -> int:
        """Time of the measurement by the header [ns]; 0: no clock was set."""
        stamp = self.content.header.stamp
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


@dataclass(slots=True)
class Bag:
    """Open bag."""

    path: Path
    _readers: "list[Reader]"
    _types: "Typestore"
    _is_ros1: bool
    _counts: "Counts"
    topics: tuple[Topic, ...] = field(init=False)
    num_read: dict[str, int] = field(default_factory=dict)
    """Numbers of messages, by topic, of the topics that were read to their end."""
    copies: dict[tuple[str, Path], int] = field(default_factory=dict)
    """Numbers of left-out messages, by topic and file, which another file holds as well."""
    undecodable: dict[tuple[str, int], str] = field(default_factory=dict)
    """Reasons why messages read so far cannot be decoded, by topic and number."""

    def __post_init__(self) -> None:
        """List the topics by name; if a name has several kinds, the supported one."""
        found: dict[str, Topic] = {}
        for connection in self._connections():
            kind, count = kind_of(connection.msgtype), _count(connection)
            known = found.get(connection.topic)
            if known is not None and known.kind == kind:
                count += known.count
            elif known is not None and known.kind in _KINDS.values():
                continue
            found[connection.topic] = Topic(name=connection.topic, kind=kind, count=count)
        self.topics = tuple(topic for _, topic in sorted(found.items()))

    def topics_of_kind(self, *kinds: str) -> tuple[Topic, ...]:
        """Topics with messages of these kinds, by name."""
        return tuple(topic for topic in self.topics if topic.kind in kinds and topic.count > 0)

    def messages(
        self, topics: Collection[str], *, selected: Collection[tuple[str, int]] | None = None
    ) -> Iterator[Message]:
        """Yield messages in the order of receipt.

        Messages that cannot be decoded are left out and noted in `undecodable`; those that another
        file holds as well, in `copies`.

        Args:
            topics: Names of the topics.
            selected: (topic, number) of the messages to decode; None: all.

        Raises:
            ValueError: The bag is damaged.
        """
        kinds = {topic.name: topic.kind for topic in self.topics if topic.name in topics}
        numbers = dict.fromkeys(kinds, 0)
        copies = Counter[tuple[str, Path]]()
        try:
            for connection, received_ns, raw in self._raw_messages(kinds, copies):
                name = connection.topic
                number = numbers[name]
                numbers[name] += 1
                if selected is not None and (name, number) not in selected:
                    continue
                if abs(received_ns) >= _TIME_LIMIT_NS:
                    reason = f"its time of receipt, {received_ns} ns, is implausible"
                    self.undecodable[name, number] = reason
                content = self._content(raw, connection, (name, number))
                if content is not None:
                    yield Message(name, number, received_ns, content)
            self.num_read |= numbers
            self.copies |= copies
        except Exception as error:
            raise ValueError(
                f"{self.path} is damaged after {sum(numbers.values())} messages "
                f"({one_line(error)}); repair it (`ros2 bag`, `mcap recover`) or import an "
                "intact copy"
            ) from error

    def times_in_files(self, topic: Topic) -> Int64[np.ndarray, " num_messages"] | None:
        """Read the times of receipt [ns] of a topic's messages in the order of the bag's files.

        Returns:
            Times; None: a file's index is damaged.
        """
        kinds = {topic.name: topic.kind}
        try:
            times = [
                received_ns
                for reader in self._readers
                for received_ns in times_in_file(reader, _of_kinds(reader, kinds))
            ]
            return np.array(times, np.int64)
        except Exception:  # noqa: BLE001 - arbitrary bytes may raise any error
            return None

    def undecodable_notes(self, topics: Collection[str]) -> tuple[str, ...]:
        """Return a line for each topic with undecodable messages, with their count."""
        notes = []
        for name in topics:
            reasons = [reason for (topic, _), reason in self.undecodable.items() if topic == name]
            if reasons:
                notes.append(
                    f"warning: dropped {len(reasons)} unreadable messages of {shortened(name)}: "
                    f"{reasons[0]}"
                )
        return tuple(notes)

    def copy_notes(self, topics: Collection[str]) -> tuple[str, ...]:
        """Return a warning for each topic whose messages several files of the folder hold."""
        return tuple(
            f"warning: {number} messages of {shortened(name)} in {shortened(file.name)} are in "
            "another file, too, with the same bytes and time of receipt, and are left out: if the "
            "folder holds a drive twice, move one copy away"
            for (name, file), number in self.copies.items()
            if name in topics
        )

    def publisher_notes(self, topics: Collection[str]) -> tuple[str, ...]:
        """Return a warning for each topic that several nodes publish, with their names."""
        notes = []
        kinds = {topic.name: topic.kind for topic in self.topics}
        for name in topics:
            for reader in self._readers:  # a drive's files may be of nodes started again
                nodes = {
                    _publisher(each)
                    for each in reader.connections
                    if each.topic == name and kind_of(each.msgtype) == kinds[name]
                }
                if len(nodes) > 1:
                    listed = ", ".join(map(shortened, sorted(nodes)[:_MAX_NODES]))
                    notes.append(
                        f"warning: topic {shortened(name)} is published by {len(nodes)} nodes "
                        f"({listed}): all their messages are taken for those of one sensor; filter "
                        "the bag by node if they are of several"
                    )
        return tuple(dict.fromkeys(notes))

    def kind_notes(self, topics: Collection[str]) -> tuple[str, ...]:
        """Return a warning for each topic with messages of further kinds, which are not read."""
        notes = []
        for topic in self.topics:
            others = Counter[str]()
            for each in self._connections():
                if each.topic == topic.name and (kind := kind_of(each.msgtype)) != topic.kind:
                    others[kind] += _count(each)
            left_out = [
                Topic(name=topic.name, kind=kind, count=n) for kind, n in others.items() if n
            ]
            if left_out and topic.name in topics:
                listed = ", ".join(map(str, left_out))
                notes.append(
                    f"warning: topic {topic} has messages of other kinds, which are left out: "
                    f"{listed}; give each kind a topic of its own"
                )
        return tuple(notes)

    def count_notes(self, topics: Collection[str]) -> tuple[str, ...]:
        """Return a warning for each topic with fewer messages than the bag itself counts.

        Topics that were not read to their end are left out.
        """
        notes = []
        for topic in self.topics:
            number = self.num_read.get(topic.name)
            if number is None or topic.name not in topics:
                continue
            listed = sum(
                count
                for (name, kind), count in self._counts.items()
                if (name, kind_of(kind)) == (topic.name, topic.kind)
            )
            number += sum(n for (name, _), n in self.copies.items() if name == topic.name)
            if number < topic.count:
                notes.append(
                    f"warning: only {number} of the {topic.count} messages of "
                    f"{shortened(topic.name)} that the bag's statistics count are in its index; "
                    "write the bag anew by `mcap recover`, and import that"
                )
            elif number < listed:
                notes.append(
                    f"warning: the bag holds {number} of the {listed} messages of "
                    f"{shortened(topic.name)} that {METADATA_NAME} counts: the others were lost "
                    "with a file or in recording; import an intact copy, or correct the counts by "
                    "`ros2 bag reindex`"
                )
        return tuple(notes)

    def unreadable_topic_error(self, topic: str) -> ValueError:
        """Return the error for a topic without a decodable message."""
        notes = self.undecodable_notes([topic])
        if not notes and (counts := self.count_notes([topic])):
            return ValueError(f"{self.path}: {counts[0].removeprefix('warning: ')}")
        reason = f": {notes[0].removeprefix('warning: ')}" if notes else ""
        is_in_cdr = not reason.endswith(_NO_CDR)
        remedy = "import an intact bag" if is_in_cdr else CONVERSION_REMEDY
        return ValueError(
            f"{self.path} has no readable message of {shortened(topic)}{reason}; {remedy}, or "
            "choose another topic"
        )

    def _raw_messages(
        self, kinds: dict[str, str], copies: Counter[tuple[str, Path]]
    ) -> "Iterator[tuple[Connection, int, bytes]]":
        """Yield connection, time [ns] and bytes of the messages of the given kinds, by time.

        Messages that another file holds as well are counted in `copies` instead.
        """
        from rosbags.rosbag2.storage_mcap import McapReader

        def from_reader(reader: "Reader") -> "Iterator[tuple[Connection, int, bytes, Path]]":
            chosen: list[Any] = _of_kinds(reader, kinds)
            if chosen:  # for an empty list ROS 1's reader yields all
                messages: Iterator[tuple[Connection, int, bytes]] = reader.messages(chosen)
                if isinstance(reader, McapReader) and not reader.chunks:
                    messages = scanned_messages(reader, chosen)
                for connection, received_ns, raw in messages:
                    yield connection, received_ns, bytes(raw), Path(str(reader.path))

        merged = heapq.merge(*map(from_reader, self._readers), key=lambda each: each[1])
        at_once: dict[str, tuple[int, dict[bytes, Path]]] = {}  # latest time and its messages
        for connection, received_ns, raw, file in merged:
            name = connection.topic
            if at_once.get(name, (None,))[0] != received_ns:
                at_once[name] = received_ns, {}
            if len(self._readers) > 1 and at_once[name][1].setdefault(raw, file) != file:
                copies[name, file] += 1
            else:
                yield connection, received_ns, raw

    def _content(self, raw: bytes, connection: "Connection", key: tuple[str, int]) -> Any:  # noqa: ANN401
        """Decode a message; None if it cannot be decoded."""
        if key in self.undecodable:
            return None
        kind = kind_of(connection.msgtype)
        try:
            if self._is_ros1:
                return self._types.deserialize_ros1(raw, kind)
            if raw.startswith(_ZSTD_MAGIC):
                raw = decompressed_zstd(raw)
            return self._types.deserialize_cdr(raw, kind)
        except Exception as error:  # noqa: BLE001 - arbitrary bytes may raise any error
            encoding = getattr(connection.ext, "serialization_format", "") or _CDR
            is_foreign = encoding != _CDR
            self.undecodable[key] = (
                f"they are encoded as {shortened(encoding, 20)}{_NO_CDR}"
                if is_foreign
                else one_line(error)
            )
            return None

    def _connections(self) -> "Iterator[Connection]":
        for reader in self._readers:
            yield from (each for each in reader.connections if isinstance(each.topic, str))


def _of_kinds(reader: "Reader", kinds: dict[str, str]) -> "list[Connection]":
    """List a file's connections of topics with their kinds."""
    return [each for each in reader.connections if kind_of(each.msgtype) == kinds.get(each.topic)]


def kind_of(msgtype: object) -> str:
    """Normalise the spelling of a message type.

    ROS 1 writes sensor_msgs/Image, ROS 2 sensor_msgs/msg/Image, DDS sensor_msgs::msg::dds_::Image_,
    and old packages tf/tfMessage. Any other type is returned as it is.
    """
    if not isinstance(msgtype, str):
        return ""
    words = [word.strip("_ ") for word in msgtype.replace("::", "/").split("/") if word]
    return _KINDS.get((words[0].lower(), words[-1].lower()), msgtype) if words else ""


def plain_frame(name: object) -> str:
    """Name of a coordinate frame without ROS 1's leading slash."""
    return str(name).strip().lstrip("/")


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag: a folder with metadata.yaml, a .mcap, .db3 or .bag file, or a folder of them.

    Messages are decoded by ROS's definitions of their types; definitions in the bag are ignored as
    untrusted.

    Raises:
        ValueError: `rosbags` is not installed, or the bag cannot be read.
    """
    try:
        from rosbags.rosbag1 import Reader as Ros1Reader
    except ImportError as error:
        raise ValueError(
            f"{path} is a ROS bag, and reading it needs rosbags: {install_command('ros')}"
        ) from error
    with ExitStack() as stack:
        try:
            readers, counts = stack.enter_context(open_files(path))
        except ValueError:
            raise
        except Exception as error:
            raise ValueError(
                f"{path} cannot be read as a ROS bag: {one_line(error).rstrip('.')}; import an "
                "intact copy"
            ) from error
        is_ros1 = any(isinstance(reader, Ros1Reader) for reader in readers)
        if is_ros1 and not all(isinstance(reader, Ros1Reader) for reader in readers):
            raise ValueError(f"{path} holds bags of ROS 1 and of ROS 2; import one of them")
        yield Bag(path, readers, _types(is_ros1=is_ros1), is_ros1, counts)


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag."""
    if path.is_file():
        return is_bag_file(path)
    return (path / METADATA_NAME).is_file() or bool(files_without_metadata(path))


def _types(*, is_ros1: bool) -> "Typestore":
    """Message types as ROS defines them; the supported ones have not changed between versions."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not is_ros1:
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    if TRANSFORMS not in types.fielddefs:
        types.register(
            get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS)
        )
    return types


def _publisher(connection: "Connection") -> str:
    """Name of the node that published on a connection; in ROS 2, which has none, its number."""
    return str(getattr(connection.ext, "callerid", None) or f"connection {connection.id}")


def _count(connection: "Connection") -> int:
    return connection.msgcount if isinstance(connection.msgcount, int) else 0
