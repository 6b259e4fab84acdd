"""Clock for pairing messages of two sensors: header stamps or times of receipt."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64, Int64

from sightline.files.plain_text import shortened

Clock = Literal["header", "received"]
"""Time for pairing messages: time of measurement, or of receipt by the bag."""

_DAY_NS: Final = 86_400 * 10**9
_UNITS_NS: Final = {"microseconds": 10**3, "milliseconds": 10**6}
"""Units that drivers write by mistake as nanoseconds."""
_MAX_DELAY_DIFFERENCE_NS: Final = 5 * 10**8
"""Largest difference of the sensors' delays that exposure, a turn and processing explain."""
_MIN_STEADY: Final = 8
"""Number of messages, at least, before and after a step of a clock: more than recorders queue."""
_MAX_FALL_NS: Final = 10**9
"""Largest decrease of stamps that is explained by reordered messages."""
_MIN_SET_BACK_NS: Final = 3 * 10**8
"""Smallest decrease of times in the order of the files that is told: of some messages."""
_MIN_DENSITY: Final = 1.3
"""Smallest number of messages, of that usual in their time, where two moments mix."""
_MAX_FALLS: Final = 0.25
"""Largest share of decreases: messages with more were written in any order."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MessageTimes:
    """Times of a topic's messages, in the order of receipt.

    After a recorder's clock was set back, times of receipt fall in this order.
    """

    topic: str
    header_ns: Int64[np.ndarray, " count"]
    received_ns: Int64[np.ndarray, " count"]

    @property
    def offsets_ns(self) -> Float64[np.ndarray, " count"]:
        """Time from the receipt of each message to its stamp [ns]."""
        offsets: Float64[np.ndarray, " count"] = np.subtract(
            self.header_ns, self.received_ns, dtype=np.int64
        ).astype(np.float64)
        return offsets


@dataclass(frozen=True, kw_only=True, slots=True)
class SetBack:
    """Stretch of times through which a clock ran twice."""

    start_ns: int
    end_ns: int
    fall_ns: int
    """Time by which a message is earlier than that before it."""


def find_set_back(times_ns: Int64[np.ndarray, " count"]) -> SetBack | None:
    """Find where a clock was set back, by messages that are then closer together than others.

    Messages of one clock that are written in another order, such as parts of a drive that were
    joined, are as far apart as everywhere. Equal times are those of one message.

    Args:
        times_ns: Times of a topic's messages, in the order of receipt.
    """
    steps = np.diff(times_ns)
    falls = np.flatnonzero(steps < -_MIN_SET_BACK_NS)
    if not 0 < len(falls) <= _MAX_FALLS * len(steps) or not (steps > 0).any():
        return None
    earliest_after = np.minimum.accumulate(times_ns[::-1])[::-1][falls + 1]
    latest_after = np.maximum.accumulate(times_ns[::-1])[::-1][falls + 1]
    starts = np.maximum(np.minimum.accumulate(times_ns)[falls], earliest_after)
    ends = np.minimum(np.maximum.accumulate(times_ns)[falls], latest_after)
    in_order = np.unique(times_ns)
    counts = np.searchsorted(in_order, ends, "right") - np.searchsorted(in_order, starts)
    usual = np.maximum(ends - starts, 0) / np.median(steps[steps > 0]) + 1
    excess = counts - _MIN_DENSITY * usual
    most = int(np.argmax(excess))
    if excess[most] < 1:
        return None
    return SetBack(
        start_ns=int(starts[most]), end_ns=int(ends[most]), fall_ns=-int(steps[falls[most]])
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ChosenClock:
    """Times for pairing."""

    clock: Clock
    times_ns: tuple[Int64[np.ndarray, " _count"], ...]
    """Times of each topic's messages."""
    notes: tuple[str, ...]


def choose_clock(topics: Sequence[MessageTimes], clock: Clock) -> ChosenClock:
    """Choose the times of the requested clock; times of receipt if header stamps are unusable.

    Stamps of all sensors from one separate clock, such as a simulator's, are used at any distance
    to the time of receipt. A few missing (0) or implausible stamps, days from the others, are
    replaced by the time of receipt plus the others' median delay.

    Args:
        topics: Times of the sensors' topics; none is empty.
        clock: The requested clock.

    Raises:
        ValueError: Neither clock is usable.
    """
    if clock == "received":
        return _received(topics, "", "try --clock header")
    for times in topics:
        fault = _stamps_fault(times)
        if fault is not None:
            return _received(topics, fault, "import a bag whose clocks were set")
    delays = [float(np.median(times.offsets_ns[_is_set(times)])) for times in topics]
    if max(delays) - min(delays) > _DAY_NS:
        far = int(np.argmax(np.abs(delays)))
        fault = (
            f"{_stamps_label(topics[far])} are {_delay_text(delays[far])} receipt, others are not"
        )
        return _received(topics, fault, "import a bag whose clocks were set")
    notes = []
    if min(map(abs, delays)) > _DAY_NS:
        notes.append(
            f"header stamps of all sensors are {_delay_text(delays[0])} receipt: they are used as "
            "times of one clock"
        )
    elif max(delays) - min(delays) > _MAX_DELAY_DIFFERENCE_NS:
        early, late = topics[int(np.argmin(delays))], topics[int(np.argmax(delays))]
        notes.append(
            f"warning: {_stamps_label(late)} are {(max(delays) - min(delays)) / 1e9:.3g} s later "
            f"against their receipt than those of {shortened(early.topic)}: if the sensors have "
            "separate clocks, images are paired with sweeps of other moments; then take --clock "
            "received"
        )
    notes += (*_set_back_notes(topics, "header"), *_step_notes(topics))
    filled = []
    for times, delay in zip(topics, delays, strict=True):
        is_set = _is_set(times)
        filled.append(np.where(is_set, times.header_ns, times.received_ns + round(delay)))
        if not is_set.all():
            notes.append(
                f"warning: {np.count_nonzero(~is_set)} of {len(is_set)} {_stamps_label(times)} are "
                "not set, or days off the others: the time of receipt is used for them"
            )
    return ChosenClock(clock="header", times_ns=tuple(filled), notes=tuple(notes))


def _received(topics: Sequence[MessageTimes], fault: str, remedy: str) -> ChosenClock:
    """Choose the times of receipt, with a warning of the stamps' fault."""
    for times in topics:
        if len(times.received_ns) > 1 and len(np.unique(times.received_ns)) == 1:
            prefix = f"{fault}, and " if fault else ""
            raise ValueError(
                f"{prefix}all {len(times.received_ns)} messages of {shortened(times.topic)} have "
                f"the same time of receipt: images and sweeps cannot be paired; {remedy}"
            )
    notes = (f"warning: {fault}: messages are paired by the time of receipt",) if fault else ()
    return ChosenClock(
        clock="received",
        times_ns=tuple(times.received_ns for times in topics),
        notes=(*notes, *_set_back_notes(topics, "received")),
    )


def _set_back_notes(topics: Sequence[MessageTimes], clock: Clock) -> tuple[str, ...]:
    """Warn of the recorder's clock that was set back, if the chosen clock was too."""
    found = {times.topic: find_set_back(times.received_ns) for times in topics}
    known = {topic: each for topic, each in found.items() if each is not None}
    stamps_rise = all(find_set_back(times.header_ns[_is_set(times)]) is None for times in topics)
    if not known or (clock == "header" and stamps_rise):
        return ()
    topic, first = next(iter(known.items()))
    start_ms = min(each.start_ns for each in known.values()) // 10**6
    end_ms = -(-max(each.end_ns for each in known.values()) // 10**6)
    other = "; or take --clock header, which rises" if stamps_rise else ""
    return (
        f"warning: times of receipt of {shortened(topic)} go back by {first.fall_ns / 1e9:.3g} s "
        "within the bag, as where the recorder's clock is set: two moments have the times from "
        f"{start_ms / 1e3:.3f} to {end_ms / 1e3:.3f} s, where images are paired with sweeps of "
        "either and frames of both alternate; cut the bag there by time (`mcap filter`, `ros2 bag "
        f"convert`, `rosbag filter`), and import what is before and what is after it{other}",
    )


def _stamps_fault(times: MessageTimes) -> str | None:
    """Reason why a topic's stamps are unusable; None: usable."""
    stamps_label, is_set = _stamps_label(times), _is_set(times)
    if not (times.header_ns > 0).any():
        return (
            f"{stamps_label} are all 0"
            if not times.header_ns.any()
            else f"{stamps_label} are not above 0"
        )
    if np.count_nonzero(is_set) * 2 <= len(is_set):
        unset = np.count_nonzero(~is_set)
        return f"{unset} of {len(is_set)} {stamps_label} are not set, or days off the others"
    stamps = times.header_ns[is_set]
    for unit, unit_ns in _UNITS_NS.items():
        offset_ns = float(np.median(stamps)) * unit_ns - float(np.median(times.received_ns))
        if stamps.max() < times.received_ns.min() - _DAY_NS and abs(offset_ns) <= _DAY_NS:
            return f"{stamps_label} are in {unit} instead of nanoseconds"
    if len(stamps) > 1 and len(np.unique(stamps)) * 2 <= len(stamps):
        return (
            f"{stamps_label} stand still: {len(np.unique(stamps))} different ones of {len(stamps)}"
        )
    steps = np.diff(stamps)
    falls_ns = np.maximum.accumulate(stamps) - stamps
    if np.count_nonzero(steps < 0) * 2 > np.count_nonzero(steps):
        return f"{stamps_label} fall from message to message"
    if falls_ns.max() > _MAX_FALL_NS and find_set_back(times.received_ns) is None:
        return f"{stamps_label} go back by {falls_ns.max() / 1e9:.4g} s in between"
    return None


def _step_notes(topics: Sequence[MessageTimes]) -> tuple[str, ...]:
    """Warn of stamps that step against those of another topic within the drive.

    Not in bags whose times of receipt fall: steps are found by the messages received together.
    """
    if any((np.diff(times.received_ns) < 0).any() for times in topics):
        return ()
    for times, other in permutations(topics, 2):
        step_s = abs(_step_ns(times, other)) / 1e9
        if step_s:
            return (
                f"warning: {_stamps_label(times)} step by {step_s:.3g} s against those of "
                f"{shortened(other.topic)} within the drive, as where a clock is set: before or "
                "after that, images are paired with sweeps of other moments; then take --clock "
                "received",
            )
    return ()


def _step_ns(times: MessageTimes, other: MessageTimes) -> float:
    """Step of a topic's stamps against another's, which is steady before and after; else 0.

    Messages that are received late, by a busy recorder, or that are lost, are no step.
    """
    kept, others = _is_set(times), _is_set(other)
    stamps_ns, received_ns = times.header_ns[kept], times.received_ns[kept]
    other_stamps_ns, other_received_ns = other.header_ns[others], other.received_ns[others]
    nearest = np.searchsorted(other_received_ns, received_ns).clip(0, len(other_received_ns) - 1)
    # The other sensor may be off for a while.
    is_near = np.abs(other_received_ns[nearest] - received_ns) <= _MAX_DELAY_DIFFERENCE_NS
    numbers = np.flatnonzero(is_near)
    if len(numbers) < 2 * _MIN_STEADY:
        return 0.0
    ahead_ns = (stamps_ns - other_stamps_ns[nearest])[numbers].astype(np.float64)
    place = int(np.argmax(np.abs(np.diff(ahead_ns)))) + 1
    sides, at = (ahead_ns[:place], ahead_ns[place:]), int(numbers[place])
    step_ns = float(np.median(sides[1]) - np.median(sides[0]))
    is_steady = all(
        len(side) >= _MIN_STEADY and np.ptp(np.quantile(side, (0.1, 0.9))) < abs(step_ns) / 4
        for side in sides
    )
    if not is_steady or abs(step_ns) <= _MAX_DELAY_DIFFERENCE_NS:
        return 0.0
    stamps_jump, received_jump = _jump_ns(stamps_ns, at), _jump_ns(received_ns, at)
    is_own_clock = stamps_jump - received_jump > _MAX_DELAY_DIFFERENCE_NS
    between = slice(max(nearest[at - 1] - 1, 0), nearest[at] + 1)
    is_recorders_clock = (  # and that of this sensor: all are received later, the other is not late
        stamps_jump > _MAX_DELAY_DIFFERENCE_NS
        and _largest_gap_ns(other_received_ns[between]) - _largest_gap_ns(other_stamps_ns[between])
        > _MAX_DELAY_DIFFERENCE_NS
    )
    return step_ns if is_own_clock or is_recorders_clock else 0.0


def _jump_ns(times_ns: Int64[np.ndarray, " count"], at: int) -> float:
    """Deviation of the time before a message from the usual time between messages [ns]."""
    periods_ns = np.diff(times_ns)
    return float(abs(periods_ns[at - 1] - np.median(periods_ns)))


def _largest_gap_ns(times_ns: Int64[np.ndarray, " count"]) -> float:
    return float(np.diff(times_ns).max(initial=0))


def _is_set(times: MessageTimes) -> np.ndarray:
    """Mask of the stamps that are set and consistent with most others."""
    is_set = times.header_ns > 0
    if not is_set.any():
        return is_set
    offsets = times.offsets_ns
    is_kept: np.ndarray = is_set & (np.abs(offsets - np.median(offsets[is_set])) <= _DAY_NS)
    return is_kept


def _stamps_label(times: MessageTimes) -> str:
    return f"header stamps of {shortened(times.topic)}"


def _delay_text(delay_ns: float) -> str:
    days = abs(delay_ns) / _DAY_NS
    text = f"{days:.3g} days" if days < 730 else f"{days / 365.25:.3g} years"
    return f"{text} {'after' if delay_ns > 0 else 'before'}"
