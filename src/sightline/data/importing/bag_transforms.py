"""Transforms between the coordinate frames of a bag, from its TF messages."""

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.data.importing.bag import TRANSFORMS, Bag, plain_frame
from sightline.data.importing.bag_topics import num_shared_names
from sightline.data.importing.frames import (
    Rigid,
    find_chain,
    find_transform,
    rigid_from_quaternion,
)
from sightline.files.plain_text import shortened
from sightline.geometry.mount import MAX_OFFSET_M

_TRANSLATION_TOLERANCE_M: Final = 1e-3
_ROTATION_TOLERANCE_DEG: Final = 0.05
_MAX_COMPARED_TRANSFORMS: Final = 20  # transforms left out one by one to compare other chains
_MAX_KEPT_VALUES: Final = 50  # different values of a transform; a moving frame has any number
_WORLDS: Final = {
    "earth",
    "enu",
    "global",
    "init",
    "map",
    "ned",
    "odom",
    "odometry",
    "utm",
    "world",
}
"""Words in the names of frames that stay while the vehicle moves (REP 105; LOAM's camera_init)."""
_MAX_WORLD_SHIFT_M: Final = 0.3  # of a vehicle at rest, by errors of its odometry


@dataclass(slots=True)
class _Values:
    """Values of the transform of one pair of frames, in the order of receipt."""

    is_static: bool
    """Whether the pair is in a static topic, whose value goes before those of other topics."""
    farthest: Rigid
    """Value whose translation differs most from the first one's."""
    kept: dict[bytes, Rigid] = field(default_factory=dict)
    """First different values, by their bytes."""
    counts: Counter[bytes] = field(default_factory=Counter)
    """Numbers of messages with the kept values, of static ones if the pair is static."""
    total: int = 0
    """Number of messages that are counted."""
    topics: dict[str, None] = field(default_factory=dict)
    """Topics of the values, the first first."""

    def add(self, rigid: Rigid, topic: str) -> None:
        """Add a message's value."""
        is_static = _is_static(topic)
        self.topics[topic] = None
        key = rigid.tobytes()
        first = next(iter(self.kept.values()), rigid)
        if _distance_m(first, rigid) > _distance_m(first, self.farthest):
            self.farthest = rigid
        if key in self.kept or len(self.kept) < _MAX_KEPT_VALUES:
            self.kept.setdefault(key, rigid)
        if is_static == self.is_static:
            self.total += 1
            if key in self.kept:
                self.counts[key] += 1

    @property
    def is_settled(self) -> bool:
        """True if more than half of a transform's messages give the same value."""
        return 2 * self.counts.most_common(1)[0][1] > self.total

    @property
    def usual(self) -> Rigid:
        """Value of most messages, or else of the first one."""
        key = self.counts.most_common(1)[0][0] if self.is_settled else next(iter(self.kept))
        return self.kept[key]

    @property
    def different(self) -> tuple[Rigid, ...]:
        """First different values, and the one farthest from the first."""
        return (*self.kept.values(), self.farthest)


@dataclass(frozen=True, slots=True)
class BagTransforms:
    """Transforms parent_from_child by (parent, child)."""

    usual: dict[tuple[str, str], Rigid]
    """Usable value of each pair that most messages have, or else the first; static ones first."""
    others: dict[tuple[str, str], tuple[Rigid, ...]]
    """First different usable values of each pair, and the one farthest from the first."""
    faults: tuple[str, ...]
    """Reasons why some transforms are invalid."""
    unsettled: frozenset[tuple[str, str]] = frozenset()
    """Pairs without a value that most messages have."""
    topics: dict[tuple[str, str], tuple[str, ...]] = field(default_factory=dict)
    """Topics of each pair's values."""
    dropped: dict[str, dict[tuple[str, str], tuple[Rigid, ...]]] = field(default_factory=dict)
    """Different values by topic and pair, for pairs that topics nearer to the sensors have, too."""
    enclosing: frozenset[str] = frozenset()
    """Topics in a namespace around a sensor's topic, as those of its own robot are."""

    def is_fixed(self, pair: tuple[str, str]) -> bool:
        """True if a pair's transform never changes."""
        return all(_difference(self.usual[pair], other) is None for other in self.others[pair])

    def between(self, target: str, source: str) -> dict[tuple[str, str], Rigid]:
        """Select the transforms that never change if they connect two frames, else all.

        Odometry of a sensor is a short chain to others, but its messages are of different times.
        """
        fixed = {pair: rigid for pair, rigid in self.usual.items() if self.is_fixed(pair)}
        return self.usual if find_chain(fixed, target, source) is None else fixed


def transforms_of_bag(bag: Bag, sensors: Collection[str] = ()) -> BagTransforms:
    """Read all TF messages.

    In a bag of several robots, whose frames may have the same names, a transform is taken from the
    topics that share most leading names with the sensors' topics.

    Args:
        bag: The bag.
        sensors: Topics of the sensors.
    """
    values: dict[tuple[str, str], _Values] = {}
    nearness: dict[tuple[str, str], int] = {}
    faults: list[str] = []
    dropped: dict[str, dict[tuple[str, str], _Values]] = {}
    names = [topic.name for topic in bag.topics_of_kind(TRANSFORMS)]
    shared = {name: sum(num_shared_names(name, each) for each in sensors) for name in names}
    for name in sorted(names, key=lambda name: (-shared[name], not _is_static(name))):
        for message in bag.messages([name]):
            for each in message.content.transforms:
                pair = (plain_frame(each.header.frame_id), plain_frame(each.child_frame_id))
                try:
                    rigid = _rigid(each.transform)
                except ValueError as error:
                    label = f"{shortened(pair[1])} in {shortened(pair[0])}"
                    faults.append(f"{name}: the transform of {label} {error}")
                    continue
                is_near = nearness.setdefault(min(pair, pair[::-1]), shared[name]) <= shared[name]
                reverse = values.get(pair[::-1])
                if reverse is not None and (
                    not is_near or (reverse.is_static and not _is_static(name))
                ):
                    pair, rigid = pair[::-1], np.linalg.inv(rigid)
                kept = values if is_near else dropped.setdefault(name, {})
                known = kept.setdefault(pair, _Values(is_static=_is_static(name), farthest=rigid))
                known.add(rigid, name)
    return BagTransforms(
        usual={pair: each.usual for pair, each in values.items()},
        others={pair: each.different for pair, each in values.items()},
        faults=tuple(faults),
        unsettled=frozenset(pair for pair, each in values.items() if not each.is_settled),
        topics={pair: (*each.topics,) for pair, each in values.items()},
        dropped={
            name: {pair: each.different for pair, each in pairs.items()}
            for name, pairs in dropped.items()
        },
        enclosing=frozenset(
            name
            for name in names
            if any(num_shared_names(name, each) == name.strip("/").count("/") for each in sensors)
        ),
    )


def _is_static(topic: str) -> bool:
    return "static" in topic


def _rigid(transform: Any) -> Rigid:  # noqa: ANN401 - a message
    rotation, translation = transform.rotation, transform.translation
    return rigid_from_quaternion(
        np.array((rotation.x, rotation.y, rotation.z, rotation.w), dtype=np.float64),
        np.array((translation.x, translation.y, translation.z), dtype=np.float64),
    )


def world_fault(transforms: BagTransforms, used: Rigid, lidar: str, camera: str) -> str | None:
    """Find clouds in a frame that stays in place while the camera moves.

    Its name says so, or it moves farther than any sensor does on a vehicle. Sensors on a gimbal or
    a trailer, and single wrong transforms, are no fault.

    Args:
        transforms: All transforms.
        used: camera_from_lidar.
        lidar: Frame of the clouds.
        camera: Frame of the camera.

    Returns:
        The rest of a sentence that begins with the clouds; None if there is no fault.
    """
    is_world = _is_world(lidar)
    steps = _steps(transforms.between(camera, lidar), lidar, camera)
    # other frames may have single wrong transforms
    moving = [step for step in steps if is_world or step in transforms.unsettled]
    moves = _largest_move(transforms, used, moving, lidar, camera)
    if moves is None or moves[0] <= (_MAX_WORLD_SHIFT_M if is_world else MAX_OFFSET_M):
        return None
    return (
        f"are in frame {shortened(lidar)}, which by TF moves by {moves[0]:.3g} m relative to "
        f"{shortened(camera)} in the drive, as a map's or odometry's frame does, so that they "
        "would be right in one image only; choose the topic in the LiDAR's own frame by "
        "--lidar-topic, or transform the clouds back by the poses"
    )


def _is_world(frame: str) -> bool:
    """Check if a frame's name is that of one that stays in place, as a map's."""
    return not _WORLDS.isdisjoint(re.split("[^a-z]+", frame.lower()))


def _steps(selected: Collection[tuple[str, str]], lidar: str, camera: str) -> list[tuple[str, str]]:
    """Pairs of frames on the chain from the LiDAR to the camera, each in both directions."""
    chain = find_chain(selected, camera, lidar) or []
    return [step for pair in pairwise(chain) for step in (pair, pair[::-1])]


def _largest_move(
    transforms: BagTransforms,
    used: Rigid,
    steps: Collection[tuple[str, str]],
    lidar: str,
    camera: str,
) -> tuple[float, float] | None:
    """Largest change of the used transform by some steps [m, degrees]; None: there is none."""
    selected = transforms.between(camera, lidar)
    differences = [
        _difference(used, find_transform(selected | {step: value}, camera, lidar))
        for step in steps
        for value in transforms.others.get(step, ())
    ]
    return max((each for each in differences if each is not None), default=None)


def describe_transforms(
    transforms: BagTransforms, used: Rigid, lidar: str, camera: str
) -> tuple[str, ...]:
    """Return notes on unusable transforms, moving sensors and contradicting chains.

    Args:
        transforms: All transforms.
        used: camera_from_lidar.
        lidar: Frame of the LiDAR.
        camera: Frame of the camera.
    """
    notes = []
    if transforms.faults:
        notes.append(
            f"left out {len(transforms.faults)} invalid transforms, the first: "
            f"{transforms.faults[0].removesuffix('; calibrate again')}"
        )
    selected = transforms.between(camera, lidar)
    chain = find_chain(selected, camera, lidar) or []
    steps = _steps(selected, lidar, camera)
    moves = _largest_move(transforms, used, steps, lidar, camera)
    if moves is not None:
        topics = dict.fromkeys(name for step in steps for name in transforms.topics.get(step, ()))
        several = f"; it is in topics {', '.join(map(shortened, topics))}" * (len(topics) > 1)
        notes.append(
            f"warning: by TF {shortened(lidar)} moves relative to {shortened(camera)} in the "
            f"drive, by {_text(moves)} at times: the pose of most messages is used, or else "
            f"the first{several}"
        )
    notes += _contradictions(transforms, used, lidar, camera)
    for step in steps[: 2 * _MAX_COMPARED_TRANSFORMS]:
        rest = {each: rigid for each, rigid in selected.items() if each != step}
        difference = _difference(used, find_transform(rest, camera, lidar))
        if difference is not None:
            through = step if step in list(pairwise(chain)) else step[::-1]
            notes.append(
                f"warning: TF has several chains from {shortened(lidar)} to "
                f"{shortened(camera)} that differ by {_text(difference)}: the shortest is used, "
                f"through {shortened(through[0])} and {shortened(through[1])}"
            )
            break
    return tuple(notes)


def _contradictions(transforms: BagTransforms, used: Rigid, lidar: str, camera: str) -> list[str]:
    """Notes on topics whose values differ from those of the topics beside the sensors.

    They are warnings if the calibration depends on the choice between topics of one robot, or if a
    part of the mount is in another robot's topics only.
    """
    notes = []
    selected = transforms.between(camera, lidar)
    steps = _steps(selected, lidar, camera)
    for topic in transforms.dropped:
        differences = _differences(transforms, topic, steps)
        on_chain = {pair: each for pair, each in differences.items() if pair in steps}
        alone = [step for step in steps if topic in transforms.topics.get(step, ())]
        is_own = topic in transforms.enclosing
        if on_chain and (is_own or not alone):
            other = selected | {pair: value for pair, (_, value) in on_chain.items()}
            effect = _difference(used, find_transform(other, camera, lidar))
            origin = "" if is_own else ", as another robot's does"
            notes.append(
                f"{'warning: ' * (is_own and effect is not None)}{shortened(topic)} differs from "
                f"{_differences_text(transforms, on_chain)}{origin}: the latter is taken, as it "
                "is beside the sensors; if it is wrong, give the LiDAR's mount by --calibration"
            )
        elif differences and alone:
            notes.append(
                f"{'warning: ' * (not is_own)}the transform of {_pair_text(alone[0])} is only in "
                f"{shortened(topic)}, which contradicts "
                f"{_differences_text(transforms, on_chain or differences)}, as another robot's "
                "does: the LiDAR's mount may be wrong; then give it by --calibration"
            )
    return notes


def _differences(
    transforms: BagTransforms, topic: str, steps: Collection[tuple[str, str]]
) -> dict[tuple[str, str], tuple[tuple[float, float], Rigid]]:
    """Largest difference [m, degrees] of each pair from nearer topics, and its value.

    Pairs that move in the nearer topics are left out, as values of other times differ. So are
    moving pairs and the vehicle's place in the world beside the chain of the sensors.
    """
    largest = {}
    for pair, values in transforms.dropped[topic].items():
        moves = any(_difference(values[0], value) is not None for value in values)
        if not transforms.is_fixed(pair) or (
            pair not in steps and (moves or any(map(_is_world, pair)))
        ):
            continue
        sizes = [(_difference(transforms.usual[pair], value), value) for value in values]
        found = [(size, value) for size, value in sizes if size is not None]
        if found:
            largest[pair] = max(found, key=lambda each: each[0])
    return largest


def _differences_text(
    transforms: BagTransforms,
    differences: Mapping[tuple[str, str], tuple[tuple[float, float], Rigid]],
) -> str:
    """Topics beside the sensors, and by how much another topic's transforms differ from theirs."""
    near = dict.fromkeys(name for pair in differences for name in transforms.topics[pair])
    sizes = [f"of {_pair_text(pair)} by {_text(each[0])}" for pair, each in differences.items()]
    return f"{', '.join(map(shortened, near))} in the transform {', '.join(sizes)}"


def _pair_text(pair: tuple[str, str]) -> str:
    return f"{shortened(pair[1])} in {shortened(pair[0])}"


def _distance_m(first: Rigid, other: Rigid) -> float:
    return float(np.linalg.norm(first[:3, 3] - other[:3, 3]))


def _difference(used: Rigid, other: Rigid | None) -> tuple[float, float] | None:
    """Difference of two transforms [m, degrees]; None: no difference, or no other transform."""
    difference = np.eye(4) if other is None else np.linalg.inv(used) @ other
    translation_m = float(np.linalg.norm(difference[:3, 3]))
    rotation_deg = float(np.degrees(Rotation.from_matrix(difference[:3, :3]).magnitude()))
    if translation_m <= _TRANSLATION_TOLERANCE_M and rotation_deg <= _ROTATION_TOLERANCE_DEG:
        return None
    return translation_m, rotation_deg


def _text(difference: tuple[float, float]) -> str:
    metres, degrees = (round(value, 6) for value in difference)  # without floats' rounding errors
    return f"{metres:.3g} m and {degrees:.3g} degrees"
