"""`sightline perceive`: runs all registered tasks together."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from sightline.cli.declared import declare
from sightline.cli.engine import tell_engine
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import named_file
from sightline.data.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.jobs.output_dirs import check_outputs
from sightline.tasks import find_task, task_names, weights_of

_HELP = """Asks all tasks about every frame: result files of each, and one line of JSON a frame.

Each frame is loaded once. OUT holds a folder for each task, the same as `sightline predict` makes,
and perception.jsonl; docs/perception.md tells what stands in it. A frame without a sensor is
answered by the tasks that can do without it. A file appears whole or not at all; an interrupted
run is finished by running it again.

Args:
    data: A recording, or a KITTI object tree, depth completion tree or raw drive.
    out: Folder for all results.
{tasks}    engine: What runs the networks: by default (auto) openvino where it is installed, on the
        CPU, and torch elsewhere.
    device: Where PyTorch runs the networks.
    all_outputs: Writes the further outputs of the tasks, too: expected errors of depth, gates.
    sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or
        a text file with one name a line. Default: all.
    velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
        velodyne_reduced.
    workers: Processes, each of one thread: as many as there are cores is fastest.
    overwrite: Makes files anew that are there already.
    shard_index: Which part of the frames to do, from 0.
    num_shards: Number of parts, each of which can run on another machine.
    video: MP4 to write of all frames: camera with boxes, depth, bird's-eye view. H.264 with
        pip install '.[viz]'.
    rerun: File for the Rerun viewer (.rrd) to write: image, depth, points, boxes on a time line.
        Needs pip install '.[viz]'.
    fps: Frames per second of the video.
    min_score: Detections that are less sure are in the results, and in neither picture.
"""
_TASK_HELP = """    {argument}: What answers {name}: weights by name ({known}) or file
        (.safetensors, .ckpt){methods}, or none, which leaves the task out. Default: {default}.
"""


def perceive_command() -> Callable[..., None]:
    """Create the command for the currently registered tasks."""

    def command(**settings: Any) -> None:  # noqa: ANN401 - the signature below says what
        weights = {name: settings.pop(_argument(name)) for name in task_names()}
        _run({name: chosen for name, chosen in weights.items() if chosen is not None}, **settings)

    text = _HELP.format(tasks="".join(map(_task_help, task_names())))
    tasks: dict[str, tuple[Any, object]] = {
        _argument(name): (str | None, None) for name in task_names()
    }
    options: dict[str, tuple[Any, object]] = {
        "engine": (EngineChoice, "auto"),
        "device": (Device, "cpu"),
        "all_outputs": (bool, False),
        "sample_list": (str | None, None),
        "velodyne": (Velodyne | None, None),
        "workers": (int, 2),
        "overwrite": (bool, False),
        "shard_index": (int, 0),
        "num_shards": (int, 1),
        "video": (Path | None, None),
        "rerun": (Path | None, None),
        "fps": (float, 10.0),
        "min_score": (float, 0.3),
    }
    return declare(command, {"data": Path, "out": Path}, tasks | options, help_text=text)


def _argument(task_name: str) -> str:
    return task_name.replace("-", "_")


def _task_help(name: str) -> str:
    task = find_task(name)
    return _TASK_HELP.format(
        argument=_argument(name),
        name=name,
        known=", ".join(weights_of(task)) or "none come with Sightline",
        methods=f", a method ({', '.join(task.methods)})" if task.methods else "",
        default=task.default_weights or "none",
    )


def _run(
    weights: dict[str, str],
    *,
    data: Path,
    out: Path,
    engine: EngineChoice,
    device: Device,
    **job: Any,  # noqa: ANN401 - the options of `perceive`
) -> None:
    places = {"OUT": out, "--video": job["video"], "--rerun": job["rerun"]}
    files = [named_file(each) for each in (*weights.values(), job["sample_list"])]
    check_outputs(places, data=[data, *files])  # before networks are loaded
    from sightline.perception.perceive import LINES_NAME, perceive
    from sightline.perception.perceiver import MultiTaskPredictor

    # One thread per worker; with several threads PyTorch's last digits differ.
    perceiver = MultiTaskPredictor.load(weights, engine=engine, device=device, threads=1)
    taken = {each.made_by.get("engine") for each in perceiver.predictors.values()} - {None}
    tell_engine(engine, next(iter(taken), None), device)
    result = perceive(data, out, perceiver=perceiver, **job)
    answers = ", ".join(f"{task} {count}" for task, count in result.answered.items())
    say(f"{out / LINES_NAME}: frames: {result}; answers to them: {answers}")
