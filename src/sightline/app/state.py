"""State of the page: a frame, the faults of its sensors, and the weights, as a link's query."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple
from urllib.parse import parse_qsl, urlencode

from sightline.corruptions.kinds import find_kind, plain_severity
from sightline.files.plain_text import shortened
from sightline.perception.perceiver import LEFT_OUT
from sightline.tasks import find_task, task_names, weights_of

MAX_QUERY: Final = 4000
"""Longest query [characters]."""
MAX_FAULTS: Final = 6
"""Most faults at once."""
MAX_SEED: Final = 9999
MAX_YAW_DEG: Final = 30.0

FAST: Final[Mapping[str, str]] = {
    "depth-completion": "depth-fast-cpu",
    "detection2d": "detection2d-fast-cpu",
    "detection3d": "detection3d-fast-cpu",
}
"""Weights of each task at first."""

_MAX_NAME: Final = 300
_DIGITS: Final = re.compile(r"[0-9]{1,9}")


class FaultChoice(NamedTuple):
    """Chosen fault of the library."""

    kind: str
    severity: int
    seed: int

    def __str__(self) -> str:
        """Format as in a query."""
        return f"{self.kind}.{self.severity}.{self.seed}"


class Breakage(NamedTuple):
    """Frame and the faults of its sensors: determines the sample."""

    frame: str
    faults: tuple[FaultChoice, ...] = ()
    yaw_deg: float = 0.0
    """Rotation of the LiDAR about z, counter-clockwise from above, unknown to the calibration."""


PRESETS: Final[Mapping[str, Breakage]] = {
    "Sound sensors": Breakage(""),
    "Camera blank": Breakage("", (FaultChoice("camera_blank", 5, 0),)),
    "LiDAR blank": Breakage("", (FaultChoice("lidar_blank", 5, 0),)),
    "8 beams": Breakage("", (FaultChoice("lidar_beams", 4, 0),)),
    "Fog": Breakage("", (FaultChoice("camera_fog", 4, 0), FaultChoice("lidar_fog", 4, 0))),
    "Turned 2 degrees": Breakage("", (), 2.0),
}
"""Faults of any frame that have a button of their own."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PageState:
    """Everything that predictions depend on.

    Raises:
        ValueError: A number is out of range, or there is no such kind of fault or weights.
    """

    broken: Breakage
    weights: tuple[tuple[str, str], ...] = tuple(FAST.items())
    """Weights or method of each task, by task name."""

    def __post_init__(self) -> None:
        """Check the ranges and names."""
        frame, faults, yaw_deg = self.broken
        if not frame or len(frame) > _MAX_NAME:
            raise ValueError("no frame is named; choose one of the list")
        if len(faults) > MAX_FAULTS:
            raise ValueError(f"{len(faults)} faults at once, at most {MAX_FAULTS}; leave some out")
        for fault in faults:
            plain_severity(find_kind(fault.kind).name, fault.severity)
            if not 0 <= fault.seed <= MAX_SEED:
                raise ValueError(
                    f"seed must be from 0 to {MAX_SEED}, got {fault.seed}; give another"
                )
        if len({fault.kind for fault in faults}) < len(faults):
            raise ValueError("a kind of fault is chosen twice; choose each once")
        if not abs(yaw_deg) <= MAX_YAW_DEG:
            raise ValueError(
                f"yaw must be from -{MAX_YAW_DEG:g} to {MAX_YAW_DEG:g} degrees, got {yaw_deg:g}"
            )
        for task, chosen in self.weights:
            if chosen not in choices_of(task):
                raise ValueError(
                    f"{task} has no weights '{shortened(chosen)}'; choose one of "
                    f"{', '.join(choices_of(task))}"
                )

    def weights_for(self, task: str) -> str:
        """Weights or method of a task."""
        return dict(self.weights).get(task, LEFT_OUT)

    def to_pairs(self) -> list[tuple[str, str]]:
        """List the keys and values of a link's query."""
        frame, faults, yaw_deg = self.broken
        pairs = [("frame", frame), *(("fault", str(fault)) for fault in faults)]
        if yaw_deg:
            pairs.append(("yaw", f"{yaw_deg:g}"))
        return [*pairs, *(each for each in self.weights if FAST.get(each[0]) != each[1])]

    def to_query(self) -> str:
        """Format as the query of a link."""
        return urlencode(self.to_pairs())


def choices_of(task: str) -> tuple[str, ...]:
    """Weights and methods that the page offers for a task; the last one leaves it out."""
    found = find_task(task)
    return (*weights_of(found), *found.methods, LEFT_OUT)


def parse_state(query: str, frames: Sequence[str]) -> PageState:
    """Read a state from the query of a link; other keys are ignored.

    Args:
        query: The query.
        frames: Names of the frames; the first one is the default.

    Raises:
        ValueError: The query is too long, a value is invalid, or the data has no such frame.
    """
    if len(query) > MAX_QUERY:
        raise ValueError(f"the link has {len(query)} characters, at most {MAX_QUERY}; shorten it")
    pairs = parse_qsl(query, max_num_fields=100, errors="replace")
    given = dict(pairs)
    frame = given.get("frame", frames[0])
    if frame not in frames:
        raise ValueError(f"the data has no frame '{shortened(frame)}'; choose one of the list")
    faults = tuple(_fault(value) for key, value in pairs if key == "fault")
    weights = {task: given.get(task, FAST.get(task, LEFT_OUT)) for task in task_names()}
    return PageState(
        broken=Breakage(frame=frame, faults=faults, yaw_deg=_yaw(given.get("yaw", "0"))),
        weights=tuple(weights.items()),
    )


def _fault(text: str) -> FaultChoice:
    kind, *numbers = text.split(".")
    if len(numbers) != 2 or not all(map(_DIGITS.fullmatch, numbers)):
        raise ValueError(
            f"fault '{shortened(text)}' is not understood, expected KIND.SEVERITY.SEED, such as "
            "lidar_fog.3.0"
        )
    return FaultChoice(kind, int(numbers[0]), int(numbers[1]))


def _yaw(text: str) -> float:
    try:
        yaw_deg = float(text)
    except ValueError:
        yaw_deg = math.nan
    if not math.isfinite(yaw_deg):
        raise ValueError(f"yaw '{shortened(text)}' is no number; give degrees, such as 2.5")
    return yaw_deg
