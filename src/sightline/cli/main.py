"""The command line: the only place that parses arguments.

Each command is a typed function; jsonargparse turns its signature and docstring into arguments and
help. What a command needs is imported inside it, so that `--help` answers at once.
"""

import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import jsonargparse

from sightline.cli.evaluate import (
    evaluate_depth,
    evaluate_held_out,
    evaluate_objects,
    evaluate_proposals,
    reproduce_shiftconv,
)
from sightline.cli.parser import (
    REFUSED,
    Device,
    Engine,
    LidarModel,
    Method,
    OneLineParser,
    Velodyne,
    fail,
    join_number_lists,
)
from sightline.cli.report import deliver

_INTERRUPTED = 130  # what a shell reports for a program that Ctrl-C ended
_BROKEN_PIPE = 141  # likewise

PACKAGE_RECIPES = Path(__file__).parents[1] / "recipes"
"""Folder of the recipes that `fit --config` knows by name."""


def check(data: Path, *, workers: int = 2) -> int:
    """Validates KITTI-format data: missing, truncated, non-finite and inconsistent files.

    Prints one line per problem with the file and the remedy. Exit status: 0 if there is none, 1
    otherwise.

    Args:
        data: A KITTI object tree, depth completion tree or raw drive.
        workers: Threads that read.
    """
    from sightline.data.check import check_tree, summarize_tree

    if not data.is_dir():
        raise ValueError(f"{data} is no folder; give the folder of a KITTI data set")
    for summary in summarize_tree(data):
        print(summary)
    num_problems = 0
    for problem in check_tree(data, num_workers=workers):
        print(problem)
        num_problems += 1
    print(f"{num_problems or 'no'} problem{'' if num_problems == 1 else 's'}")
    return int(num_problems > 0)


def show(
    data: Path,
    frame: str,
    *,
    out: Path | None = None,
    method: Method | None = None,
    weights: str | None = None,
    velodyne: Velodyne = "velodyne",
) -> None:
    """Draws a frame: boxes on the image, LiDAR on the image, bird's-eye view, depth.

    Args:
        data: A KITTI object tree, depth completion tree or raw drive.
        frame: Name of the frame, e.g. 000008.
        out: PNG to write; by default FRAME.png in the current folder.
        method: How the dense depth is completed without a network.
        weights: The network: name of weights that come with Sightline (depth-best,
            depth-fast-cpu) or a file (.safetensors, .ckpt). Default: depth-best.
        velodyne: Folder of the sweeps in an object tree.
    """
    from sightline.inference.depth import choose_completer
    from sightline.inference.pictures import write_frame_picture

    completer = choose_completer(method=method, weights=weights)
    path = out or Path(f"{frame}.png")
    print(write_frame_picture(data, frame, path, completer=completer, velodyne=velodyne))


def simulate(
    out: Path,
    *,
    frames: int | None = None,
    seed: int | None = None,
    workers: int = 2,
    sequence_length: int | None = None,
    image_size: tuple[int, int] | None = None,
    focal_px: float | None = None,
    samples_per_pixel: int | None = None,
    lidar: LidarModel | None = None,
    rolling_shutter: bool = False,
    velodyne: Velodyne | None = None,
    validation_frames: int | None = None,
    preset: Literal["street-2k"] | None = None,
    compare: Path | None = None,
) -> None:
    """Makes street frames or drives in KITTI's format, with dense depth and exact labels.

    The same settings give the same files for any number of workers. An interrupted run is finished
    by running it again; more frames extend what is there.

    Args:
        out: Folder for the data.
        frames: How many, over all drives. Default: 100, or the preset's.
        seed: Another seed gives other streets. Default: 0, or the preset's.
        workers: Processes.
        sequence_length: Frames of a drive at 10 Hz, in KITTI's raw layout. Default: 1, every frame
            another street, in the object layout.
        image_size: Width and height in pixels. Default: 1242 375, or the preset's.
        focal_px: Focal length in pixels. Default: KITTI's.
        samples_per_pixel: 1, or 4 for finer pictures. Default: 1.
        lidar: The sensor. Default: hdl-64e.
        rolling_shutter: Lets the LiDAR move during its turn.
        velodyne: velodyne for whole turns of the LiDAR, velodyne_reduced for what the camera sees.
            Default: velodyne, or the preset's.
        validation_frames: So many, the first ones, go to ImageSets/val.txt and not to train.txt.
        preset: A named data set; what is given besides replaces its settings.
        compare: Folder of real frames in KITTI's object layout, to print their statistics beside
            ours; without --frames or --preset, those of the frames that are in OUT already.
    """
    from sightline.simulation.command import run_simulation

    done = run_simulation(
        out,
        frames=frames,
        seed=seed,
        workers=workers,
        sequence_length=sequence_length,
        image_size=image_size,
        focal_px=focal_px,
        samples_per_pixel=samples_per_pixel,
        lidar=lidar,
        rolling_shutter=rolling_shutter,
        velodyne=velodyne,
        validation_frames=validation_frames,
        preset=preset,
        compare_with=compare,
    )
    print(done)


def predict_depth_completion(
    data: Path,
    out: Path,
    *,
    method: Method | None = None,
    weights: str | None = None,
    engine: Engine = "torch",
    device: Device = "cpu",
    uncertainty: Path | None = None,
    split: str | None = None,
    velodyne: Velodyne = "velodyne",
    workers: int = 2,
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
) -> None:
    """Completes the depth of every frame and writes 16-bit depth PNGs (metres times 256).

    A file appears whole or not at all; an interrupted run is finished by running it again.

    Args:
        data: A KITTI object tree, depth completion tree or raw drive.
        out: Folder for the PNGs.
        method: How depth is completed without a network.
        weights: The network: name of weights that come with Sightline (depth-best,
            depth-fast-cpu) or a file (.safetensors, .ckpt). Default: depth-best.
        engine: What runs the network.
        device: Where PyTorch runs the network.
        uncertainty: Folder for the network's expected errors, as PNGs in the same format.
        split: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a text
            file with one name a line. Default: all.
        velodyne: Folder of the sweeps in an object tree.
        workers: Processes; of several, each runs a network on one thread.
        overwrite: Makes files anew that are there already.
        shard_index: Which part of the frames to do, from 0.
        num_shards: Number of parts, each of which can run on another machine.
    """
    from sightline.inference.batch import predict_depth_completion as predict

    result = predict(
        data,
        out,
        method=method,
        weights=weights,
        engine=engine,
        device=device,
        uncertainty=uncertainty,
        sample_list=split,
        velodyne=velodyne,
        workers=workers,
        overwrite=overwrite,
        shard_index=shard_index,
        num_shards=num_shards,
    )
    print(f"{out}: {result.written} depth maps written, {result.skipped} were there already")


def export(
    out: Path,
    *,
    weights: str = "depth-best",
    format: Literal["onnx", "openvino"] = "onnx",  # noqa: A002 - the flag's name
) -> None:
    """Writes a network as a file that runs without PyTorch, and checks that it gives the same.

    Args:
        out: File to write: .onnx, or .xml for OpenVINO.
        weights: Name of weights that come with Sightline, or a file (.safetensors, .ckpt).
        format: Of the file.
    """
    from sightline.inference.export_weights import export_weights

    deliver(export_weights(weights, out, format), None)
    print(out)


def demo(out: Path = Path("demo")) -> None:
    """Runs the main job on the embedded frames and writes pictures and a report.

    Args:
        out: Folder to write to.
    """
    from sightline.inference.demo import run_demo

    print(run_demo(out))


_TRAINING = {
    "fit": "Train a network by a recipe: --config NAME|FILE.",
    "validate": "Score a network that is being trained on its validation data.",
    "test": "Score a trained network on test data.",
}
_COMMANDS: dict[str, Any] = {
    "demo": demo,
    "check": check,
    "show": show,
    "simulate": simulate,
    **{name: {"_help": text} for name, text in _TRAINING.items()},  # for --help
    "predict": {
        "_help": "Run a task over a data set.",
        "depth-completion": predict_depth_completion,
    },
    "evaluate": {
        "_help": "Score results.",
        "objects": evaluate_objects,
        "proposals": evaluate_proposals,
        "depth": evaluate_depth,
        "held-out": evaluate_held_out,
    },
    "reproduce": {
        "_help": "Print a paper's tables beside our own figures.",
        "shiftconv": reproduce_shiftconv,
    },
    "export": export,
}


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit status; errors are one line on standard error."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        return _run(given)
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except KeyboardInterrupt as error:
        how = str(error) or "interrupted; run the same command again to finish"
        return fail(how, _INTERRUPTED)
    except (ValueError, OSError) as error:
        return fail(str(error), REFUSED)


def _run(arguments: list[str]) -> int:
    match arguments:
        case ["fit" | "validate" | "test" as training, *rest]:
            # As they are: Lightning makes the parser, of what the recipe names.
            from sightline.training.command import run_training

            return run_training(training, rest, recipes=PACKAGE_RECIPES)
    status = jsonargparse.auto_cli(
        _COMMANDS,
        args=join_number_lists(arguments),
        prog="sightline",
        version=version("sightline"),
        parser_class=OneLineParser,
    )
    return status if isinstance(status, int) else 0
