"""Health of the sensors along a drive, with its alarms."""

from collections.abc import AsyncGenerator, Sequence
from dataclasses import replace
from typing import Any, Final

from sightline.app.answers import Answers
from sightline.app.state import PageState
from sightline.files.problem import plain_line
from sightline.health.sequence import Alarm, HysteresisConfig
from sightline.structures.health import Health

MAX_FRAMES: Final = 400
"""Most frames of a time line; of more, evenly spread ones."""

_JUDGED: Final = ("camera", "lidar", "alignment")


def frames_shown(frames: Sequence[str]) -> list[str]:
    """Frames of the time line."""
    return list(frames[:: -(-len(frames) // MAX_FRAMES) or 1])


async def health_along(
    answers: Answers, state: PageState, frames: Sequence[str]
) -> AsyncGenerator[tuple[str, Any]]:
    """Judge the frames of the time line in order, with the faults of a state.

    Yields the health of each frame with the alarms after it. Each frame is judged by itself; alarms
    have the hysteresis of `sightline health`. A frame that cannot be read yields its fault.
    """
    alarms = {name: Alarm(HysteresisConfig()) for name in _JUDGED}
    for frame in frames_shown(frames):
        of_frame = replace(state, broken=state.broken._replace(frame=frame))
        try:
            judged = (await answers.part("health", of_frame)).content
        except ValueError as error:
            yield "fault", {"part": "timeline", "frame": frame, "reason": plain_line(str(error))}
            continue
        for name, alarm in alarms.items():
            alarm.update(_health(judged[name]))
        scores = {name: judged[name] and judged[name]["score"] for name in _JUDGED}
        active = [name for name, alarm in alarms.items() if alarm.is_on]
        yield "frame", {"frame": frame, "scores": scores, "alarms": active}


def _health(judged: dict[str, Any] | None) -> Health | None:
    return None if judged is None else Health(score=judged["score"], worst_check=judged["worst"])
