"""Everything that the page offers to choose, with its colours, as JSON."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from sightline.app.state import (
    FAST,
    MAX_FAULTS,
    MAX_SEED,
    MAX_YAW_DEG,
    PRESETS,
    Breakage,
    choices_of,
)
from sightline.app.timeline import frames_shown
from sightline.corruptions.kinds import KINDS, SEVERITIES
from sightline.health.report import CHECK_MEANINGS
from sightline.structures.sample import SENSOR_FIELDS
from sightline.tasks import find_task, task_names
from sightline.visualization.colors import DEPTH_SCALE, UNCERTAINTY_SCALE, ColorScale, class_color

_CLASSES: Final = ("Car", "Van", "Truck", "Tram", "Pedestrian", "Person_sitting", "Cyclist", "Misc")


def page_setup(title: str, frames: Sequence[str]) -> dict[str, Any]:
    """Describe the data, and all faults and weights that can be chosen.

    Args:
        title: Name of the data on the page.
        frames: Names of the frames.
    """
    return {
        "data": title,
        "frames": list(frames),
        "timeline": frames_shown(frames),
        "kinds": [
            {
                "name": kind.name,
                "sensors": list(kind.at(1).sensors),
                "levels": [kind.describe(severity) for severity in SEVERITIES],
            }
            for kind in KINDS.values()
        ],
        "presets": [_preset(name, broken) for name, broken in PRESETS.items()],
        "tasks": {name: list(choices_of(name)) for name in task_names()},
        "fast": FAST,
        "best": {name: find_task(name).default_weights for name in task_names()},
        "limits": {"faults": MAX_FAULTS, "seed": MAX_SEED, "yaw_deg": MAX_YAW_DEG},
        "sensors": list(SENSOR_FIELDS),
        "checks": CHECK_MEANINGS,
        "colors": {name: class_color(name) for name in _CLASSES},
        "scales": {"depth": _scale(DEPTH_SCALE), "uncertainty": _scale(UNCERTAINTY_SCALE)},
    }


def _preset(name: str, broken: Breakage) -> dict[str, object]:
    faults = [fault._asdict() for fault in broken.faults]
    return {"name": name, "faults": faults, "yaw": broken.yaw_deg}


def _scale(scale: ColorScale) -> dict[str, object]:
    """Colours of a scale for a legend, and its marks: metres and place from 0 to 1."""
    steps = scale.table[:: len(scale.table) // 16].tolist()
    places = scale.positions(np.array(scale.ticks_m)).round(4).tolist()
    marks = list(zip(scale.ticks_m, places, strict=True))
    return {"colors": steps, "marks": marks}
