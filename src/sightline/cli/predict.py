"""`sightline predict`: one command per task, generated from the task's declaration."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from sightline.cli.network_options import (
    Around,
    announce_engine,
    chosen_field,
    refuse_engine,
    warn_of_rig,
)
from sightline.cli.output import say
from sightline.cli.parser import Device, declare
from sightline.cli.report import named_file, refuse_with_pack
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import check_outputs
from sightline.tasks import Task, find_task, task_names, weights_of

_HELP = """{summary}

Files are written atomically; to resume an interrupted run, run it again.

Args:
    data: A recording, or KITTI's object tree, depth completion tree or raw drive.
    out: Folder for the first output: {first}
    method: Method without a network.
    weights: Weights of the network: name of weights in Sightline ({known}) or a file
        (.safetensors, .ckpt). Default: {default}.
    engine: Engine of the network: by default (auto) openvino on the CPU if it is installed, else
        torch.
    device: Device of the network in PyTorch.
{task_options}    sample_list: List of frames: kitti-object-train, kitti-object-val, a list in
        ImageSets or a text file with one name per line. Default: all.
    velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
        velodyne_reduced.
    workers: Number of processes with one thread each; fastest with one per core. Any number gives
        the same files.
    driver: Kind of workers: processes of this machine (local), or of a Ray cluster (ray),
        one CPU each, by pip install '.[ray]'; docs/guides/scale.md tells how.
    overwrite: Replaces existing files.
    shard_index: Index of the shard of frames to process, from 0.
    num_shards: Number of shards, each of which can run on another machine.
    pack: Writes the results of each shard of DATA as a shard, with checksums. Shards that are whole
        are skipped, and one that fails does not stop the others.
"""

_AROUND_HELP = """    around: Field of 3D detection: yes for the whole turn of the LiDAR, no for the
        camera's view, or auto: the whole turn for recordings whose sweeps have one.
"""


def predict_commands() -> dict[str, Any]:
    """Create the commands by task name, for jsonargparse."""
    commands = {name: _command(find_task(name)) for name in task_names()}
    return {"_help": "Run a task over a data set.", **commands}


def _command(task: Task) -> Callable[..., None]:
    """Create a function whose signature and docstring contain the task's methods and outputs."""

    def command(**settings: Any) -> None:  # noqa: ANN401 - see the signature below
        _run(task, **settings)

    task_options = [
        f"    {output.name}: Folder for a further output: {output.summary}\n"
        for output in task.outputs[1:]
    ]
    if task.detects_around:
        task_options.append(_AROUND_HELP)
    task_options += [f"    {switch.name}: {switch.summary}\n" for switch in task.switches]
    text = _HELP.format(
        summary=task.summary,
        first=task.outputs[0].summary,
        known=", ".join(weights_of(task)) or "none",
        default=task.default_weights or "none",
        task_options="".join(task_options),
    )
    return declare(command, {"data": Path, "out": Path}, _options(task), help_text=text)


def _options(task: Task) -> dict[str, tuple[Any, object]]:
    """Types and defaults of the options by name."""
    method: dict[str, tuple[Any, object]] = {}
    if task.methods:
        method["method"] = (Literal[task.methods] | None, None)
    own: dict[str, tuple[Any, object]] = {
        **{output.name: (Path | None, None) for output in task.outputs[1:]},
        **({"around": (Around, "auto")} if task.detects_around else {}),
        **{switch.name: (bool, False) for switch in task.switches},
    }
    network: dict[str, tuple[Any, object]] = {
        "weights": (str | None, None),
        "engine": (EngineChoice, "auto"),
        "device": (Device, "cpu"),
    }
    job: dict[str, tuple[Any, object]] = {
        "sample_list": (str | None, None),
        "velodyne": (Velodyne | None, None),
        "workers": (int, 2),
        "driver": (Driver, "local"),
        "overwrite": (bool, False),
        "shard_index": (int, 0),
        "num_shards": (int, 1),
        "pack": (bool, False),
    }
    others = {"data", "out", "method", "config", "print_config", "help"}
    taken = {*others, *network, *job} & own.keys()
    if taken:
        raise ValueError(
            f"the task {task.name} has an output or switch named {' and '.join(sorted(taken))}, "
            "which predict takes for something else; choose another name"
        )
    return method | network | own | job


def _run(
    task: Task,
    *,
    data: Path,
    out: Path,
    weights: str | None,
    engine: EngineChoice,
    device: Device,
    sample_list: str | None,
    velodyne: Velodyne | None,
    workers: int,
    driver: Driver,
    overwrite: bool,
    shard_index: int,
    num_shards: int,
    pack: bool,
    method: str | None = None,
    around: Around = "auto",
    **task_options: Any,  # noqa: ANN401 - folders of further outputs, and switches
) -> None:
    also = {
        output.name: task_options[output.name]
        for output in task.outputs[1:]
        if task_options[output.name] is not None
    }
    places = {"OUT": out} | {f"--{name}": folder for name, folder in also.items()}
    check_outputs(places, data=[data, named_file(weights), named_file(sample_list)])
    if pack:
        refuse_with_pack(sample_list=sample_list, overwrite=overwrite, **also)
    from sightline.data.open import existing_folder
    from sightline.inference.predict import predict, predict_shards
    from sightline.inference.predictor import check_predictor

    if method is not None:
        refuse_engine(engine, device)
    existing_folder(data)  # before the network is loaded
    predictor = task.predictor(
        method=method,
        weights=weights,
        engine=engine,
        device=device,
        threads=1,  # per worker; with several threads PyTorch's last digits differ
    )
    check_predictor(predictor)
    announce_engine(engine, predictor.made_by.get("engine"), device)
    switches = [switch.name for switch in task.switches if task_options[switch.name]]
    job: dict[str, Any] = {
        "switches": switches,
        "velodyne": velodyne,
        "workers": workers,
        "driver": driver,
        "shard_index": shard_index,
        "num_shards": num_shards,
        "around": chosen_field(around),
    }
    if pack:
        say(f"{out}: shards: {predict_shards(task, predictor, data, out, **job)}")
        return
    warn_of_rig(data, [predictor.name], sample_list=sample_list, velodyne=velodyne)
    result = predict(
        task,
        predictor,
        data,
        out,
        also=also,
        sample_list=sample_list,
        overwrite=overwrite,
        **job,
    )
    say(f"{out}: {task.outputs[0].name} of frames: {result}")
