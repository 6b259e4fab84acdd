"""JSON lines for each frame: predictions of all tasks, and the time of each task.

docs/perception.md describes their contents.
"""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sightline.files.atomic import atomic_write_text
from sightline.perception.perceiver import FramePredictions
from sightline.structures.predictions import Perception
from sightline.structures.sample import SENSOR_FIELDS, CameraLidarSample
from sightline.tasks import further_keys

_MS_DIGITS = 1  # decimals of milliseconds
_TIME_DIGITS = 9  # decimals of seconds: nanoseconds


def frame_line(
    sample: CameraLidarSample, predictions: FramePredictions, made_by: Mapping[str, str]
) -> str:
    """Write the line of a frame, without the line end.

    Args:
        sample: The frame.
        predictions: Predictions of the tasks.
        made_by: Weights or method of each task.
    """
    tasks: dict[str, dict[str, Any]] = {}
    for name, maker in made_by.items():
        tasks[name] = {"by": maker}
        if name in predictions.lacks:
            tasks[name]["lacks"] = list(predictions.lacks[name])
    line = {
        "frame": sample.sample_id,
        "timestamp_s": _rounded(sample.timestamp_s),
        "image_size_px": list(sample.image_size),
        "sensors": {sensor: sensor not in sample.missing_sensors for sensor in SENSOR_FIELDS},
        "num_points": None if sample.points is None else len(sample.points),
        "tasks": tasks,
        **Perception().to_json(),
        **dict.fromkeys(further_keys(made_by)),
        **predictions.perception.to_json(),
    }
    return json.dumps(line, allow_nan=False)


def retime_line(path: Path, line: Mapping[str, Any], timestamp_s: float | None) -> None:
    """Write a line anew if its time is another one; the file keeps its time of change.

    Predictions do not depend on the time, and whether the frame is newer than they are goes by the
    file's.

    Args:
        path: File of the line.
        line: Its content.
        timestamp_s: Time of the frame in the data [s]; None: unknown.
    """
    time_s = _rounded(timestamp_s)
    if line["timestamp_s"] == time_s:
        return
    changed_ns = path.stat().st_mtime_ns
    text = json.dumps({**line, "timestamp_s": time_s}, allow_nan=False)
    atomic_write_text(path, f"{text}\n")
    os.utime(path, ns=(changed_ns, changed_ns))


def _rounded(time_s: float | None) -> float | None:
    return None if time_s is None else round(time_s, _TIME_DIGITS)


def timing_line(sample: CameraLidarSample, predictions: FramePredictions) -> str:
    """Write the time of each task; separate from `frame_line`, which is the same in every run."""
    milliseconds = {
        name: round(each, _MS_DIGITS) for name, each in predictions.milliseconds.items()
    }
    return json.dumps({"frame": sample.sample_id, "milliseconds": milliseconds})
