"""Pairing of a bag's images and sweeps by time, in one pass over their messages."""

from collections import Counter
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np
from jaxtyping import Int64

from sightline.data.importing.bag import Bag, Message, Topic, plain_frame
from sightline.data.importing.bag_clocks import Clock, MessageTimes, choose_clock, find_set_back
from sightline.data.importing.bag_topics import ChosenTopics
from sightline.data.importing.pairing import pair_nearest
from sightline.files.plain_text import shortened


@dataclass(frozen=True, kw_only=True, slots=True)
class Pairs:
    """Frames of a drive."""

    positions: Int64[np.ndarray, "num_pairs 2"]
    """Indices of image and sweep among the messages of their topics."""
    times_s: tuple[Decimal, ...]
    """Exact times of the sweeps."""
    notes: tuple[str, ...]


def pair_messages(
    bag: Bag, topics: ChosenTopics, max_gap_s: float, clock: Clock, *, keep_other_frames: bool
) -> Pairs:
    """Pair the images and sweeps that are nearest to each other in time.

    Args:
        bag: The bag.
        topics: Topics of its camera and LiDAR.
        max_gap_s: Largest time difference of a pair.
        clock: Clock for pairing; see `choose_clock`.
        keep_other_frames: Whether to use messages in another coordinate frame than the first of
            their topic, to which the calibration applies; otherwise they are left out.

    Raises:
        ValueError: No message can be decoded, or there are no pairs.
    """
    names = (topics.camera.name, topics.lidar.name)
    by_topic = {name: _TopicMessages() for name in names}
    for message in bag.messages(set(names)):
        by_topic[message.topic].add(message, keep_other_frames=keep_other_frames)
    for name in names:
        if not by_topic[name].numbers:
            raise bag.unreadable_topic_error(name)
    for topic in (topics.camera, topics.lidar):
        by_topic[topic.name].undo_set_back(bag, topic)
    try:
        chosen = choose_clock([by_topic[name].times(name) for name in names], clock)
    except ValueError as error:
        raise ValueError(f"{bag.path}: {error}") from error
    camera, lidar = chosen.times_ns
    by_time = np.argsort(camera, kind="stable"), np.argsort(lidar, kind="stable")
    pairs = pair_nearest(camera[by_time[0]], lidar[by_time[1]], round(max_gap_s * 1e9))
    positions = np.stack([order[pairs[:, axis]] for axis, order in enumerate(by_time)], axis=1)
    if not len(positions):
        fault = _no_pairs_reason(topics, (camera, lidar), max_gap_s, chosen.clock, clock)
        raise ValueError(f"{bag.path}: {fault}")
    gaps_ms = np.abs(camera[positions[:, 0]] - lidar[positions[:, 1]]) / 1e6
    notes = (
        f"paired {len(positions)} of {len(camera)} images and {len(lidar)} sweeps by "
        f"{chosen.clock} time, {gaps_ms.max():.1f} ms apart at most; dropped "
        f"{len(camera) - len(positions)} images and {len(lidar) - len(positions)} sweeps",
        *_few_pairs_notes(
            len(positions), (len(camera), len(lidar)), max_gap_s, chosen.clock, clock
        ),
        *chosen.notes,
        *bag.undecodable_notes(names),
        *(note for name in names for note in by_topic[name].frame_notes(name)),
    )
    repeated = [len(each) - len(np.unique(each)) for each in (camera, lidar)]
    if any(repeated):
        notes += (
            f"warning: {repeated[0]} images and {repeated[1]} sweeps repeat the {chosen.clock} "
            "time of an earlier one and are not used",
        )
    columns = [
        np.array(by_topic[name].numbers)[positions[:, axis]] for axis, name in enumerate(names)
    ]
    return Pairs(
        positions=np.stack(columns, axis=1),
        times_s=tuple(Decimal(int(time_ns)) / 10**9 for time_ns in lidar[positions[:, 1]]),
        notes=notes,
    )


@dataclass(slots=True)
class _TopicMessages:
    """Used messages of a topic, and messages in another coordinate frame."""

    numbers: list[int] = field(default_factory=list)
    header_ns: list[int] = field(default_factory=list)
    received_ns: list[int] = field(default_factory=list)
    frame: str = ""
    """Frame of the first message that names one."""
    other_frames: Counter[str] = field(default_factory=Counter)
    """Numbers of messages in each other frame."""
    are_other_frames_kept: bool = False

    def add(self, message: Message, *, keep_other_frames: bool) -> None:
        """Count a message."""
        frame = plain_frame(message.content.header.frame_id)
        self.frame = self.frame or frame
        self.are_other_frames_kept = keep_other_frames
        if frame not in ("", self.frame):
            self.other_frames[frame] += 1
            if not keep_other_frames:
                return
        self.numbers.append(message.number)
        self.header_ns.append(message.stamp_ns)
        self.received_ns.append(message.received_ns)

    def undo_set_back(self, bag: Bag, topic: Topic) -> None:
        """Sort into the order of the bag's files if the recorder's clock was set back."""
        times_ns = bag.times_in_files(topic)
        if times_ns is None or find_set_back(times_ns) is None:
            return
        places = np.argsort(times_ns, kind="stable")  # by the messages' numbers
        if len(places) != bag.num_read[topic.name]:  # of a damaged index
            return
        order = np.argsort(places[self.numbers])
        self.numbers, self.header_ns, self.received_ns = (
            [values[each] for each in order]
            for values in (self.numbers, self.header_ns, self.received_ns)
        )

    def times(self, topic: str) -> MessageTimes:
        """Return the times of measurement and receipt."""
        return MessageTimes(
            topic=topic,
            header_ns=np.array(self.header_ns, np.int64),
            received_ns=np.array(self.received_ns, np.int64),
        )

    def frame_notes(self, topic: str) -> tuple[str, ...]:
        """Return a line on messages in another frame than the first; empty: there are none."""
        if not self.other_frames:
            return ()
        other, _ = self.other_frames.most_common(1)[0]
        count = self.other_frames.total()
        total = len(self.numbers) + (0 if self.are_other_frames_kept else count)
        description = (
            f"{count} of {total} messages of {shortened(topic)} that are in frame "
            f"{shortened(other)}, not {shortened(self.frame)} as the first"
        )
        if self.are_other_frames_kept:
            return (
                f"warning: kept {description}: the calibration file is valid for only one frame",
            )
        return (f"warning: dropped {description}, whose calibration is used",)


def _few_pairs_notes(
    num_pairs: int, counts: tuple[int, int], max_gap_s: float, clock: Clock, requested: Clock
) -> tuple[str, ...]:
    """Warn if most messages of the rarer sensor have no partner; empty: they have."""
    rarer = min(counts)
    if num_pairs * 2 >= rarer:
        return ()
    sensor = "images" if rarer == counts[0] else "sweeps"
    return (
        f"warning: only {num_pairs} of {rarer} {sensor} have a partner within {max_gap_s:g} s by "
        f"{clock} time: try {_other_clock(clock, requested)}a larger --max-gap-s, or look whether "
        "both sensors were recorded all the time",
    )


def _no_pairs_reason(
    topics: ChosenTopics,
    times_ns: tuple[Int64[np.ndarray, " num_images"], Int64[np.ndarray, " num_sweeps"]],
    max_gap_s: float,
    clock: Clock,
    requested: Clock,
) -> str:
    """Return the reason why there are no pairs, with a remedy."""
    camera, lidar = (np.sort(each) for each in times_ns)
    image, sweep = pair_nearest(camera, lidar, np.iinfo(np.int64).max)[0]
    gap_s = abs(int(camera[image]) - int(lidar[sweep])) / 1e9
    return (
        f"no image of {shortened(topics.camera.name)} and sweep of {shortened(topics.lidar.name)} "
        f"lie within {max_gap_s:g} s; the first are {gap_s:.3g} s apart by their {clock} time; try "
        f"{_other_clock(clock, requested)}a larger --max-gap-s"
    )


def _other_clock(clock: Clock, requested: Clock) -> str:
    """Begin of a remedy by the other clock; empty: it was requested, but is unusable."""
    other = "received" if clock == "header" else "header"
    return f"--clock {other} or " if clock == requested else ""
