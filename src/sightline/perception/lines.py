"""JSON lines for each frame: predictions of all tasks, and the time of each task.

docs/perception.md describes their contents.
"""

import json
from collections.abc import Mapping
from typing import Any

import torch

from sightline.perception.perceiver import FrameAnswers
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_PX, _M, _RAD, _SCORE, _MS = 2, 3, 4, 4, 1  # decimals
_TIME_DIGITS = 9  # decimals of seconds: nanoseconds


def frame_line(
    sample: CameraLidarSample, answered: FrameAnswers, made_by: Mapping[str, str]
) -> str:
    """Write the line of a frame, without the line end.

    Args:
        sample: The frame.
        answered: Predictions of the tasks.
        made_by: Weights or method of each task.
    """
    told = answered.perception
    at = sample.timestamp_s
    tasks: dict[str, dict[str, Any]] = {}
    for name, maker in made_by.items():
        tasks[name] = {"by": maker}
        if name in answered.lacks:
            tasks[name]["lacks"] = list(answered.lacks[name])
    line = {
        "frame": sample.sample_id,
        "timestamp_s": None if at is None else round(at, _TIME_DIGITS),
        "image_size_px": list(sample.image_size),
        "sensors": {"camera": sample.image is not None, "lidar": sample.points is not None},
        "num_points": None if sample.points is None else len(sample.points),
        "tasks": tasks,
        "detections2d": None if told.detections2d is None else _objects_2d(told.detections2d),
        "detections3d": None if told.detections3d is None else _objects_3d(told.detections3d),
        "depth": None if told.depth is None else _depth_summary(told.depth),
    }
    return json.dumps(line, allow_nan=False)


def timing_line(sample: CameraLidarSample, answered: FrameAnswers) -> str:
    """Write the time of each task; separate from `frame_line`, which is the same in every run."""
    milliseconds = {name: round(each, _MS) for name, each in answered.milliseconds.items()}
    return json.dumps({"frame": sample.sample_id, "milliseconds": milliseconds})


def _objects_2d(found: Detections2D) -> list[dict[str, Any]]:
    columns = zip(
        found.class_names, found.scores.tolist(), found.boxes.tensor.tolist(), strict=True
    )
    return [
        {"class": name, "score": round(score, _SCORE), "box_px": [round(x, _PX) for x in box]}
        for name, score, box in columns
    ]


def _objects_3d(found: Detections3D) -> list[dict[str, Any]]:
    columns = zip(
        found.class_names, found.scores.tolist(), found.boxes.tensor.tolist(), strict=True
    )
    return [
        {
            "class": name,
            "score": round(score, _SCORE),
            "center_m": [round(x, _M) for x in box[:3]],
            "size_m": [round(x, _M) for x in box[3:6]],
            "yaw_rad": round(box[6], _RAD),
        }
        for name, score, box in columns
    ]


def _depth_summary(depth: DepthMap) -> dict[str, float | None]:
    """Summary of the valid pixels; None: there are none, or there is no estimate."""
    believed = depth.depth_m[depth.valid]
    summary: dict[str, float | None] = {
        "valid_share": round(float(depth.valid.float().mean()), 4),
        "nearest_m": None,
        "median_m": None,
        "farthest_m": None,
        "median_expected_error_m": None,
    }
    if len(believed):
        summary["nearest_m"] = round(float(believed.min()), _M)
        summary["median_m"] = round(float(believed.median()), _M)
        summary["farthest_m"] = round(float(believed.max()), _M)
    if len(believed) and depth.uncertainty_m is not None:
        error_m = float(torch.median(depth.uncertainty_m[depth.valid]))
        summary["median_expected_error_m"] = round(error_m, _M)
    return summary
