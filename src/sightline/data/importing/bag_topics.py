"""Choice of a bag's topics of camera, LiDAR and the camera's calibration."""

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

from sightline.data.importing.bag import CAMERA_INFO, CLOUD, COMPRESSED_IMAGE, IMAGE, Bag, Topic
from sightline.files.plain_text import shortened

_DRIVERS_OWN: Final = {
    **dict.fromkeys(
        (
            *("CompressedPointCloud2", "CustomMsg", "LidarScan", "NebulaPackets", "PacketMsg"),
            *("PandarScan", "RslidarPacket", "RslidarScan", "UdpFrame", "VelodyneScan"),
        ),
        "PointCloud2",
    ),
    "Packet": "CompressedImage",  # theora_image_transport's
    "FFMPEGPacket": "CompressedImage",
    "H264Packet": "CompressedImage",
}
"""Messages of drivers in place of ROS's own."""
_COMPRESSED: Final = ("/compressed", "_compressed", "/jpeg", "/image_compressed")
_OTHER_TRANSPORTS: Final = ("compressedDepth", "ffmpeg", "theora", "zstd")
"""Last names of further copies of an image topic, by ROS's image_transport."""
_RECTIFIED: Final = {"rect", "rectified", "undistorted"}
"""Words in the folders of a topic's name that tell of rectified images; rectifier does not."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChosenTopics:
    """Topics to import."""

    camera: Topic
    lidar: Topic
    info: Topic | None
    """CameraInfo of the camera; None: the bag has none."""

    @property
    def is_rectified(self) -> bool:
        """True if the topic's name tells of rectified images: image_rect, rectified/image .."""
        words = _image_name(self.camera.name).split("_")
        is_named_so = any(word.startswith(("rect", "undistort")) for word in words)
        return is_named_so or self.is_in_rectified

    @property
    def is_in_rectified(self) -> bool:
        """True if a folder of the topic's name tells of rectified images: rectified/image."""
        folders = _raw_topic_name(self.camera.name).rpartition("/")[0]
        return not _RECTIFIED.isdisjoint(re.split("[/_]", folders))

    def rectified_note(self) -> tuple[str, ...]:
        """Note that images count as rectified by a folder of their topic's name; empty: not so."""
        if not self.is_in_rectified:
            return ()
        return (
            f"images of {shortened(self.camera.name)} count as rectified, by the topic's name: P "
            "of CameraInfo is their camera matrix, and its lens is left out",
        )


def choose_topics(
    bag: Bag, camera: str | None, lidar: str | None, info: str | None
) -> ChosenTopics:
    """Choose the named topics, or the only ones of their kind.

    A camera's compressed images are preferred to its raw ones, because their bytes stay unchanged,
    unless there are fewer than half as many.

    Raises:
        ValueError: A named topic is missing, or there are none or several of a kind; the error
            lists the topics and the remedy.
    """
    images = bag.topics_of_kind(IMAGE, COMPRESSED_IMAGE)
    chosen = _choose(bag, images, camera, "--camera-topic", "images (Image, CompressedImage)")
    return ChosenTopics(
        camera=chosen,
        lidar=_choose(
            bag, bag.topics_of_kind(CLOUD), lidar, "--lidar-topic", "clouds (PointCloud2)"
        ),
        info=_choose_info(bag, chosen, info),
    )


def _choose(
    bag: Bag, candidates: tuple[Topic, ...], name: str | None, option: str, content: str
) -> Topic:
    listed = ", ".join(map(str, candidates))
    if name is not None:
        plain = name.strip("/")
        named = next((topic for topic in candidates if topic.name.strip("/") == plain), None)
        if named is None:
            found = listed or f"none; its topics are {_topic_list(bag)}"
            raise ValueError(
                f"{bag.path} has no topic {shortened(name)} of {content}; it has {found}"
            )
        return named
    if not candidates:
        raise ValueError(
            f"{bag.path} has no topic of {content}; its topics are {_topic_list(bag)}; "
            f"{_absent_remedy(bag, content)}"
        )
    num_compressed = Counter[str]()
    for topic in candidates:
        if topic.kind == COMPRESSED_IMAGE:
            num_compressed[_raw_topic_name(topic.name)] += topic.count
    raw_names = {_raw_topic_name(topic.name) for topic in candidates}
    kept = [
        topic
        for topic in candidates
        if not _is_further_copy(topic.name, raw_names)
        and (topic.kind != IMAGE or topic.count > 2 * num_compressed[_raw_topic_name(topic.name)])
    ]
    if len(kept) > 1:
        listed = ", ".join(map(str, kept))
        raise ValueError(
            f"{bag.path} has {len(kept)} topics of {content}: {listed}; choose one by {option}"
        )
    return kept[0]


def _is_further_copy(name: str, raw_names: Collection[str]) -> bool:
    raw, _, transport = name.rpartition("/")
    return transport in _OTHER_TRANSPORTS and raw in raw_names


def _absent_remedy(bag: Bag, content: str) -> str:
    """Remedy for a bag without a kind of content."""
    if any("foxglove" in topic.kind.lower() for topic in bag.topics):
        return (
            "Foxglove's own messages are not read: convert them to ROS's (Image, PointCloud2, "
            "CameraInfo, TFMessage)"
        )
    for topic in bag.topics:
        name = topic.kind.rpartition("/")[2]
        if name in content and not topic.count:
            return f"{topic} holds no message: look whether its sensor was on, and record again"
        if name in _DRIVERS_OWN and _DRIVERS_OWN[name] in content:
            return (
                f"messages of {shortened(topic.kind)} are not read: let the driver publish "
                f"{_DRIVERS_OWN[name]}, and record that"
            )
    return "import a bag with a camera and a LiDAR"


def _choose_info(bag: Bag, camera: Topic, name: str | None) -> Topic | None:
    candidates = bag.topics_of_kind(CAMERA_INFO)
    if name is not None:
        return _choose(bag, candidates, name, "--info-topic", "calibrations (CameraInfo)")
    # By ROS's convention it is beside the images: /front/image_raw, /front/camera_info.
    raw_name = _raw_topic_name(camera.name)
    beside = f"{raw_name.rpartition('/')[0]}/camera_info".strip("/")
    for topic in candidates:
        if topic.name.strip("/") == beside:
            return topic
    num_shared = {topic.name: num_shared_names(topic.name, raw_name) for topic in candidates}
    closest = [topic for topic in candidates if num_shared[topic.name] == max(num_shared.values())]
    usual = [topic for topic in closest if topic.name.rpartition("/")[2] == "camera_info"]
    for chosen in (closest, usual):
        if len(chosen) == 1 and (len(candidates) == 1 or num_shared[chosen[0].name]):
            return chosen[0]
    if candidates:
        listed = ", ".join(map(str, candidates))
        raise ValueError(
            f"{bag.path} has {len(candidates)} topics of CameraInfo, none of them beside "
            f"{shortened(camera.name)}: {listed}; choose one by --info-topic"
        )
    return None


def describe_info(topics: ChosenTopics) -> tuple[str, ...]:
    """Warn of a CameraInfo in a folder that is not the images', nor above or below it."""
    if topics.info is None:
        return ()
    names = topics.info.name, _raw_topic_name(topics.camera.name)
    num_shared = num_shared_names(*names)
    own, images = (name.strip("/").split("/")[num_shared:] for name in names)
    if min(len(own), len(images)) < 2 or own[-1] == images[-1]:
        return ()  # /front/camera_info or /camera_info/front beside /front/image or /image/front
    return (
        f"warning: {shortened(topics.info.name)} is not beside {shortened(topics.camera.name)}: it "
        "may belong to another camera; name it by --info-topic if it does not",
    )


def num_shared_names(first: str, second: str) -> int:
    """Number of common leading names of two topics' paths."""
    pairs = zip(first.strip("/").split("/"), second.strip("/").split("/"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _raw_topic_name(name: str) -> str:
    """Raw topic of a compressed topic."""
    return next((name.removesuffix(end) for end in _COMPRESSED if name.endswith(end)), name)


def _image_name(name: str) -> str:
    return _raw_topic_name(name).rpartition("/")[2]


def _topic_list(bag: Bag) -> str:
    return ", ".join(map(str, bag.topics)) or "none"
