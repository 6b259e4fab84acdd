"""Samples with the faults of a page's state, and commands that make the same."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from sightline.app.state import Breakage, FaultChoice, PageState
from sightline.augmentation.faults import TurnedLidar, fault_rng
from sightline.corruptions.corruption import Corruption
from sightline.corruptions.kinds import find_kind
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import has_file
from sightline.data.layouts.kitti_trees import Part, Velodyne, find_velodyne
from sightline.export.names import EngineChoice
from sightline.structures.sample import CameraLidarSample, Sensor

_LIST: Final = "frame.txt"


def break_sample(sample: CameraLidarSample, broken: Breakage) -> CameraLidarSample:
    """Apply the faults: the camera's first, as they may use the sound sweep, then the LiDAR's.

    Each fault draws as in `sightline corrupt --suite KIND --seed SEED`; the yaw comes last.
    """
    for fault, corruption in _in_order(broken):
        sample = corruption(sample, fault_rng(sample, fault.seed, fault.kind))
    if broken.yaw_deg and sample.points is not None:
        turned = TurnedLidar(yaw_deg=broken.yaw_deg)
        sample = turned(sample, np.random.default_rng(0))  # draws nothing
    return sample


def reproducing_commands(
    state: PageState, data: Path, dataset: SampleDataset, engine: EngineChoice
) -> str:
    """Write commands that give the same predictions: of the shell, else a script in Python.

    `corrupt` writes object trees alone and refuses frames without the sensor of a fault, and no
    command turns a LiDAR by a given angle. The sweeps' folder and the engine are named if they are
    not the default.
    """
    sweeps = _chosen_sweeps(dataset)
    position = list(dataset.sample_ids).index(state.broken.frame)
    if not has_file(dataset, position, "points"):  # nothing is turned, as in `break_sample`
        state = replace(state, broken=state.broken._replace(yaw_deg=0.0))
    if state.broken.yaw_deg or not _can_be_corrupted(state.broken, dataset):
        return _script(state, data, sweeps, engine)
    from_sweeps = f" --velodyne {sweeps}" if sweeps else ""
    folder, lines = str(data), [f"printf '%s\\n' {shlex.quote(state.broken.frame)} > {_LIST}"]
    for number, (fault, _) in enumerate(_in_order(state.broken), 1):
        case = f"{fault.kind}-{fault.severity}"
        lines.append(
            f"sightline corrupt {shlex.quote(folder)} broken{number} --suite {fault.kind} "
            f"--cases {case} --seed {fault.seed} --sample-list {_LIST}{from_sweeps}"
        )
        folder = f"broken{number}/{case}"
    weights = " ".join(f"--{task} {shlex.quote(chosen)}" for task, chosen in state.weights)
    by_engine = f" --engine {engine}" if engine != "auto" else ""
    lines.append(
        f"sightline perceive {shlex.quote(folder)} found --sample-list {_LIST} "
        f"{weights}{from_sweeps}{by_engine}"
    )
    return " &&\n".join(lines)  # a refused step must not go on with an earlier state's frames


def _chosen_sweeps(dataset: SampleDataset) -> Velodyne | None:
    """Folder of an object tree's sweeps, if it is not the default one; else None."""
    if not isinstance(dataset, KittiObjectDataset):
        return None
    default = find_velodyne(dataset.root / dataset.split)
    return None if dataset.velodyne == default else dataset.velodyne


def _can_be_corrupted(broken: Breakage, dataset: SampleDataset) -> bool:
    """Whether `sightline corrupt` can make the faults that the page shows in a frame."""
    if not broken.faults:
        return True
    position = list(dataset.sample_ids).index(broken.frame)
    sensors = {sensor for _, corruption in _in_order(broken) for sensor in corruption.sensors}
    parts: dict[Sensor, Part] = {"camera": "image", "lidar": "points"}
    return isinstance(dataset, KittiObjectDataset) and all(
        has_file(dataset, position, parts[sensor]) for sensor in sensors
    )


def _script(state: PageState, data: Path, sweeps: Velodyne | None, engine: EngineChoice) -> str:
    broken = state.broken
    from_sweeps = f", velodyne={sweeps!r}" if sweeps else ""
    by_engine = f", engine={engine!r}" if engine != "auto" else ""
    faults = "".join(
        f'sample = find_kind("{each.kind}").at({each.severity})'
        f'(sample, fault_rng(sample, {each.seed}, "{each.kind}"))\n'
        for each, _ in _in_order(broken)
    )
    if broken.yaw_deg:
        faults += f"sample = TurnedLidar(yaw_deg={broken.yaw_deg})(sample, fault_rng(sample))\n"
    return f"""import sightline
from sightline.augmentation.faults import TurnedLidar, fault_rng
from sightline.corruptions.kinds import find_kind
from sightline.perception.lines import frame_line

sample = sightline.open_dataset({str(data)!r}, sample_list=[{broken.frame!r}]{from_sweeps})[0]
{faults}perceiver = sightline.MultiTaskPredictor.load({dict(state.weights)!r}{by_engine})
made_by = {{name: each.name for name, each in perceiver.predictors.items()}}
print(frame_line(sample, perceiver.predict_by_task(sample), made_by))"""


def _in_order(broken: Breakage) -> list[tuple[FaultChoice, Corruption]]:
    chosen = [(each, find_kind(each.kind).at(each.severity)) for each in broken.faults]
    return sorted(chosen, key=lambda pair: "lidar" in pair[1].sensors)
