"""ROS 2 bags (sqlite3 and MCAP), and those of ROS 1: topics and messages, read by `rosbags`."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE: Final = "sensor_msgs/msg/CompressedImage"
CLOUD: Final = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
SUFFIXES: Final = (".mcap", ".db3", ".bag")
"""File names of bags that are one file."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """A topic of a bag."""

    name: str
    kind: str
    """E.g. sensor_msgs/msg/Image."""
    count: int
    """Number of messages."""

    def __str__(self) -> str:
        """As errors list it."""
        return f"{self.name} ({self.kind.rpartition('/')[2]}, {self.count})"


@dataclass(frozen=True, slots=True)
class Message:
    """One message."""

    topic: str
    number: int
    """Of its topic, from 0."""
    received_ns: int
    content: Any
    """With the fields of its type."""

    @property
    def stamp_ns(self) -> int:
        """When its sensor took it, by its header; 0 where no clock was set."""
        stamp = self.content.header.stamp
        return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Bag:
    """A bag that is open."""

    def __init__(self, path: Path, reader: "AnyReader") -> None:
        self.path = path
        self._reader = reader
        self.topics = tuple(
            Topic(name=name, kind=info.msgtype or "", count=info.msgcount)
            for name, info in sorted(reader.topics.items())
        )

    def of_kind(self, *kinds: str) -> tuple[Topic, ...]:
        """The topics of some kinds, by name."""
        return tuple(topic for topic in self.topics if topic.kind in kinds and topic.count)

    def messages(
        self, topics: Collection[str], *, wanted: Collection[tuple[str, int]] | None = None
    ) -> Iterator[Message]:
        """Messages in the order in which they were received.

        Args:
            topics: Names of the topics.
            wanted: Only these numbers of these topics are decoded and given; None: all.

        Raises:
            ValueError: The bag is damaged.
        """
        connections = [each for each in self._reader.connections if each.topic in topics]
        numbers = dict.fromkeys(topics, 0)
        try:
            for connection, received_ns, raw in self._reader.messages(connections):
                number = numbers[connection.topic]
                numbers[connection.topic] += 1
                if wanted is None or (connection.topic, number) in wanted:
                    content = self._reader.deserialize(raw, connection.msgtype)
                    yield Message(connection.topic, number, received_ns, content)
        except (ValueError, OSError):
            raise
        except Exception as error:
            raise ValueError(
                f"{self.path} is damaged after {sum(numbers.values())} messages "
                f"({type(error).__name__}: {error}); repair it (`ros2 bag`, `mcap recover`) or "
                "import a copy that is whole"
            ) from error


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Opens a bag: a folder with metadata.yaml, one .mcap, .db3 or .bag file, or a folder of such.

    Raises:
        ValueError: `rosbags` is not installed, or the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ValueError(
            f'{path} is a ROS bag, and reading it needs rosbags: pip install "sightline[ros]"'
        ) from error
    try:
        # Bags of old versions hold no definitions; those of these types have not changed since.
        paths = _lone_files(path) or [path]
        reader = AnyReader(paths, default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.open()
    except Exception as error:
        raise ValueError(
            f"{path} cannot be read as a ROS bag: {error}; give a folder with metadata.yaml, or a "
            "whole .mcap, .db3 or .bag file"
        ) from error
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag."""
    if path.is_file():
        return path.suffix in SUFFIXES
    return (path / "metadata.yaml").is_file() or bool(_lone_files(path))


def _lone_files(folder: Path) -> list[Path]:
    """The files of a drive that was split, or of a bag whose metadata.yaml got lost."""
    if not folder.is_dir() or (folder / "metadata.yaml").is_file():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix in SUFFIXES)
