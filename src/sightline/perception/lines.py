"""JSON lines for each frame: predictions of all tasks, and the time of each task.

docs/perception.md describes their contents.
"""

import json
from collections.abc import Mapping
from typing import Any

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
    timestamp_s = sample.timestamp_s
    tasks: dict[str, dict[str, Any]] = {}
    for name, maker in made_by.items():
        tasks[name] = {"by": maker}
        if name in predictions.lacks:
            tasks[name]["lacks"] = list(predictions.lacks[name])
    line = {
        "frame": sample.sample_id,
        "timestamp_s": None if timestamp_s is None else round(timestamp_s, _TIME_DIGITS),
        "image_size_px": list(sample.image_size),
        "sensors": {sensor: sensor not in sample.missing_sensors for sensor in SENSOR_FIELDS},
        "num_points": None if sample.points is None else len(sample.points),
        "tasks": tasks,
        **Perception().to_json(),
        **dict.fromkeys(further_keys(made_by)),
        **predictions.perception.to_json(),
    }
    return json.dumps(line, allow_nan=False)


def timing_line(sample: CameraLidarSample, predictions: FramePredictions) -> str:
    """Write the time of each task; separate from `frame_line`, which is the same in every run."""
    milliseconds = {
        name: round(each, _MS_DIGITS) for name, each in predictions.milliseconds.items()
    }
    return json.dumps({"frame": sample.sample_id, "milliseconds": milliseconds})
