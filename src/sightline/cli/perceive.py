"""`sightline perceive`: run all registered tasks together."""

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
from sightline.tasks import find_task, task_names, weights_of

_HELP = """Run all tasks on every frame; write their result files and one line of JSON per frame.

Each frame is loaded once. OUT gets a folder for each task, as from `sightline predict`, and
perception.jsonl; docs/perception.md describes its lines. For a frame without a sensor, only the
tasks that can work without it predict. Files are written atomically; to resume an interrupted
run, run it again.

Args:
    data: A recording, or a KITTI object tree, depth completion tree or raw drive.
    out: Folder for all results.
{tasks}    joined: Models of joined scores for the detectors' weights (.json), from
        `sightline fit-joined` or `adapt`. Default: those in Sightline, for its own weights.
    engine: Engine of the networks: by default (auto) openvino on the CPU if it is
        installed, else torch.
    device: Device of the networks in PyTorch.
    all_outputs: Also writes the further outputs of the tasks: expected errors of depth, gates.
    sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or
        a text file with one name per line. Default: all.
    velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
        velodyne_reduced.
    workers: Number of processes with one thread each; fastest with one per core.
    driver: Kind of workers: processes of this machine (local), or of a Ray cluster (ray),
        one CPU each, by pip install '.[ray]'; docs/guides/scale.md tells how.
    overwrite: Replaces existing files.
    shard_index: Index of the shard of frames to process, from 0.
    num_shards: Number of shards, each of which can run on another machine.
    pack: Writes the results of each shard of DATA as a shard, with checksums. Shards that are whole
        are skipped, and one that fails does not stop the others.
    video: MP4 file of all frames: camera with boxes, depth, bird's-eye view. H.264 with
        pip install '.[viz]'.
    rerun: File for the Rerun viewer (.rrd): image, depth, points, boxes on a time line. Needs
        pip install '.[viz]'.
    fps: Frames per second of the video.
    min_score: Score threshold of drawn detections; the results contain all of them.
    around: Field of 3D detection: yes for the whole turn of the LiDAR, no for the camera's view,
        or auto: the whole turn for recordings whose sweeps have one.
    align: auto: measures the LiDAR's rotation in its mount over up to 15 frames, and undoes it if
        it is surer than its noise; no: takes the calibration as it is, as --pack always does.
"""
_TASK_HELP = """    {argument}: Weights of {name}: name ({known}) or file
        (.safetensors, .ckpt){methods}, or none to leave the task out. Default: {default}.
"""


def perceive_command() -> Callable[..., None]:
    """Create the command for the currently registered tasks."""

    def command(**settings: Any) -> None:  # noqa: ANN401 - see the signature below
        weights = {name: settings.pop(_argument(name)) for name in task_names()}
        _run({name: chosen for name, chosen in weights.items() if chosen is not None}, **settings)

    text = _HELP.format(tasks="".join(map(_task_help, task_names())))
    tasks: dict[str, tuple[Any, object]] = {
        _argument(name): (str | None, None) for name in task_names()
    }
    options: dict[str, tuple[Any, object]] = {
        "joined": (str | None, None),
        "engine": (EngineChoice, "auto"),
        "device": (Device, "cpu"),
        "all_outputs": (bool, False),
        "sample_list": (str | None, None),
        "velodyne": (Velodyne | None, None),
        "workers": (int, 2),
        "driver": (Driver, "local"),
        "overwrite": (bool, False),
        "shard_index": (int, 0),
        "num_shards": (int, 1),
        "pack": (bool, False),
        "video": (Path | None, None),
        "rerun": (Path | None, None),
        "fps": (float, 10.0),
        "min_score": (float, 0.3),
        "around": (Around, "auto"),
        "align": (Literal["auto", "no"], "auto"),
    }
    return declare(command, {"data": Path, "out": Path}, tasks | options, help_text=text)


def _argument(task_name: str) -> str:
    return task_name.replace("-", "_")


def _task_help(name: str) -> str:
    task = find_task(name)
    return _TASK_HELP.format(
        argument=_argument(name),
        name=name,
        known=", ".join(weights_of(task)) or "none in Sightline",
        methods=f", a method ({', '.join(task.methods)})" if task.methods else "",
        default=task.default_weights or "none",
    )


def _run(
    weights: dict[str, str],
    *,
    data: Path,
    out: Path,
    joined: str | None,
    engine: EngineChoice,
    device: Device,
    around: Around,
    pack: bool,
    align: Literal["auto", "no"],
    **job: Any,  # noqa: ANN401 - the options of `perceive`
) -> None:
    places = {"OUT": out, "--video": job["video"], "--rerun": job["rerun"]}
    files = [named_file(each) for each in (*weights.values(), joined, job["sample_list"])]
    check_outputs(places, data=[data, *files])
    not_packed = {name: job[name] for name in ("sample_list", "overwrite", "video", "rerun")}
    if pack:
        refuse_with_pack(**not_packed)
    from sightline.data.open import existing_folder
    from sightline.perception.kept_lines import LINES_NAME
    from sightline.perception.perceive import perceive, perceive_shards
    from sightline.perception.perceiver import MultiTaskPredictor
    from sightline.perception.pictures import PictureFiles

    existing_folder(data)  # before networks are loaded
    PictureFiles.checked(**{name: job[name] for name in ("video", "rerun", "fps", "min_score")})
    # One thread per worker; with several threads PyTorch's last digits differ.
    perceiver = MultiTaskPredictor.load(
        weights, joined=joined, engine=engine, device=device, threads=1
    )
    engines = {each.made_by.get("engine") for each in perceiver.predictors.values()} - {None}
    announce_engine(engine, next(iter(engines), None), device)
    if not engines:
        refuse_engine(engine, device)
    if pack:
        kept = job.keys() - not_packed.keys() - {"fps", "min_score"}
        options = {name: job[name] for name in kept} | {"around": chosen_field(around)}
        say(f"{out}: shards: {perceive_shards(data, out, perceiver=perceiver, **options)}")
        return
    names = [each.name for each in perceiver.predictors.values()]
    warn_of_rig(data, names, sample_list=job["sample_list"], velodyne=job["velodyne"])
    job |= {"around": chosen_field(around), "align": align == "auto"}
    result = perceive(data, out, perceiver=perceiver, **job)
    predicted = ", ".join(f"{task} {count}" for task, count in result.predicted.items())
    say(f"{out / LINES_NAME}: frames: {result}; predicted: {predicted}")
