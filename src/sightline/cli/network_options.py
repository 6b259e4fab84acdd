"""Options and messages of commands that run networks: field of 3D detection, rig, engine."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Literal

from sightline.cli.output import warn
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.choice import VARIABLE, has_openvino
from sightline.export.names import EngineChoice
from sightline.files.problem import install_command, refuse_without_effect

Around = Literal["auto", "yes", "no"]
"""Field of 3D detection: the LiDAR's whole turn, the camera's view, or as the data say (auto)."""
_CHOICES: Final[dict[str, bool | None]] = {"auto": None, "yes": True, "no": False}


def chosen_field(around: Around) -> bool | None:
    """Convert the choice for the jobs; None: as the samples say."""
    return _CHOICES[around]


def warn_of_rig(
    data: Path,
    weights: Iterable[str],
    *,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
) -> None:
    """Print how far the rig lies from training, if it does; see `rig_distance`."""
    from sightline.inference.rig_distance import rig_distance

    distance = rig_distance(data, weights, sample_list=sample_list, velodyne=velodyne)
    if distance is not None:
        warn(str(distance))


def refuse_engine(engine: EngineChoice, device: str) -> None:
    """Refuse an engine or device that is requested where no network runs.

    Raises:
        ValueError: One is requested.
    """
    refuse_without_effect("without a network", engine=engine != "auto", device=device != "cpu")


def announce_engine(choice: EngineChoice, taken: str | None, device: str) -> None:
    """Print the engine that runs the network, unless the arguments determine it.

    Args:
        choice: The requested engine.
        taken: Name of the engine; None: no network runs.
        device: The requested device; only the CPU has several engines.
    """
    if choice != "auto" or taken is None or device != "cpu" or VARIABLE in os.environ:
        return
    hint = "--engine torch for PyTorch" if taken != "torch" else ""
    if taken == "torch" and not has_openvino():
        hint = f"for openvino, usually two to three times as fast: {install_command('export')}"
    warn(f"engine {taken}{f' ({hint})' if hint else ''}")
