"""The command line: the only place that parses arguments.

Each command is a typed function; jsonargparse turns its signature and docstring into arguments and
help. What a command needs is imported inside it, so that `--help` answers at once.
"""

import json
import os
import re
import sys
from collections.abc import Mapping
from functools import reduce
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, Protocol, runtime_checkable

import jsonargparse

from sightline.data.atomic import atomic_write_text

if TYPE_CHECKING:
    from rich.table import Table

Method = Literal["nearest", "linear", "classical", "adaptive"]
Velodyne = Literal["velodyne", "velodyne_reduced"]
LidarModel = Literal["hdl-64e", "hdl-32e", "vlp-16"]

_INTERRUPTED = 130  # what a shell reports for a program that Ctrl-C ended
_BROKEN_PIPE = 141  # likewise
_REFUSED = 2
_NUMBER_LISTS = ("--beams", "--ious", "--image-size")
_FILE_WIDTH = 160  # columns of a table that goes to no terminal


@runtime_checkable
class _Report(Protocol):
    def table(self) -> "Table": ...
    def to_json(self) -> Mapping[str, object]: ...


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
    method: Method = "adaptive",
    velodyne: Velodyne = "velodyne",
) -> None:
    """Draws a frame: boxes on the image, LiDAR on the image, bird's-eye view, depth.

    Args:
        data: A KITTI object tree, depth completion tree or raw drive.
        frame: Name of the frame, e.g. 000008.
        out: PNG to write; by default FRAME.png in the current folder.
        method: How the dense depth is completed.
        velodyne: Folder of the sweeps in an object tree.
    """
    from sightline.inference.pictures import write_frame_picture

    written = write_frame_picture(
        data, frame, out or Path(f"{frame}.png"), method=method, velodyne=velodyne
    )
    print(written)


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
    method: Method = "adaptive",
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
        method: How depth is completed.
        split: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a text
            file with one name a line. Default: all.
        velodyne: Folder of the sweeps in an object tree.
        workers: Processes.
        overwrite: Makes files anew that are there already.
        shard_index: Which part of the frames to do, from 0.
        num_shards: Number of parts, each of which can run on another machine.
    """
    from sightline.inference.batch import predict_depth_completion as predict

    result = predict(
        data,
        out,
        method=method,
        sample_list=split,
        velodyne=velodyne,
        workers=workers,
        overwrite=overwrite,
        shard_index=shard_index,
        num_shards=num_shards,
    )
    print(f"{out}: {result.written} depth maps written, {result.skipped} were there already")


def evaluate_objects(
    results: Path,
    labels: Path,
    *,
    split: Path | None = None,
    overlaps: str = "strict",
    bootstrap: int = 0,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Scores result files exactly as KITTI's official object evaluation does.

    Args:
        results: Folder with one result file a frame (16 fields a line).
        labels: Folder with one label file a frame (15 fields a line).
        split: Text file with the frames to score, one a line. Default: all that have labels.
        overlaps: strict, loose, or per class e.g. car=0.7,0.5,0.5 (image, bird's eye, 3D).
        bootstrap: Resamples of the frames for the interval of AP_all_points; 0 leaves it out.
        seed: Of the resamples.
        json: File for the whole report.
    """
    _check_writable(json)
    from sightline.evaluation.kitti_object import evaluate_objects as evaluate
    from sightline.evaluation.kitti_object_rules import parse_overlaps

    report = evaluate(
        results,
        labels,
        split=split,
        overlaps=parse_overlaps(overlaps),
        bootstrap=bootstrap,
        seed=seed,
        progress=True,
    )
    _deliver(report, json)


def evaluate_proposals(
    results: Path,
    labels: Path,
    *,
    split: Path | None = None,
    ious: tuple[float, ...] = (0.5, 0.7),
    max_proposals: int | None = None,
    json: Path | None = None,
) -> None:
    """Recall of proposals: how many labelled objects a first stage finds.

    Args:
        results: Folder with one result file a frame (16 fields a line).
        labels: Folder with one label file a frame (15 fields a line).
        split: Text file with the frames to score, one a line. Default: all that have labels.
        ious: Overlaps from which an object is found, one or several numbers.
        max_proposals: Only so many of a frame, those of the highest score.
        json: File for the whole report.
    """
    _check_writable(json)
    from sightline.evaluation.kitti_object_proposals import evaluate_proposals as evaluate

    report = evaluate(
        results, labels, split=split, ious=ious, max_proposals=max_proposals, progress=True
    )
    _deliver(report, json)


def evaluate_depth(
    predictions: Path, truth: Path, *, workers: int = 2, json: Path | None = None
) -> None:
    """Scores depth maps exactly as KITTI's depth completion evaluation does.

    Args:
        predictions: A 16-bit depth PNG or a folder of them.
        truth: Ground truth likewise; matched by name.
        workers: Threads that read and score.
        json: File for the whole report.
    """
    _check_writable(json)
    from sightline.evaluation.depth import evaluate_depth as evaluate

    _deliver(evaluate(predictions, truth, workers=workers), json)


def evaluate_held_out(
    data: Path,
    *,
    method: Method = "adaptive",
    beams: tuple[int, ...] = (64, 32, 16, 8),
    split: str | None = None,
    velodyne: Velodyne = "velodyne",
    json: Path | None = None,
) -> None:
    """Scores depth completion without ground truth, on LiDAR rings that the method never sees.

    Args:
        data: A KITTI object tree or raw drive with sweeps in KITTI's order.
        method: How depth is completed.
        beams: How many of 64 beams the method gets, one or several numbers.
        split: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a text
            file with one name a line. Default: all.
        velodyne: Folder of the sweeps in an object tree.
        json: File for the whole report.
    """
    _check_writable(json)
    from sightline.data.open import open_dataset
    from sightline.evaluation.held_out import evaluate_held_out as evaluate
    from sightline.inference.depth import DepthCompleter

    dataset = open_dataset(data, sample_list=split, velodyne=velodyne, parts={"points"})
    samples = (dataset[index] for index in range(len(dataset)))
    _deliver(evaluate(samples, DepthCompleter(method), beams=beams, total=len(dataset)), json)


def demo(out: Path = Path("demo")) -> None:
    """Runs the main job on the embedded frames and writes pictures and a report.

    Args:
        out: Folder to write to.
    """
    from sightline.inference.demo import run_demo

    print(run_demo(out))


_COMMANDS: dict[str, Any] = {
    "demo": demo,
    "check": check,
    "show": show,
    "simulate": simulate,
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
}


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit status; errors are one line on standard error."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        status = jsonargparse.auto_cli(
            _COMMANDS,
            args=reduce(_join_numbers, _NUMBER_LISTS, given),
            prog="sightline",
            version=version("sightline"),
            parser_class=_OneLineParser,
        )
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _BROKEN_PIPE
    except KeyboardInterrupt:
        return _fail("interrupted; run the same command again to finish", _INTERRUPTED)
    except (ValueError, OSError) as error:
        return _fail(str(error), _REFUSED)
    return status if isinstance(status, int) else 0


class _OneLineParser(jsonargparse.ArgumentParser):
    """Refuses arguments in one line, and writes options with dashes."""

    def add_argument(self, *names: str, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        dashed = [
            name.replace("_", "-") if name.startswith("--") and name != "--print_config" else name
            for name in names
        ]
        if settings.get("type") is bool:  # `--overwrite`, not `--overwrite true`
            del settings["type"]
            settings["action"] = jsonargparse.ActionYesNo(no_prefix="no-")
        return super().add_argument(*dashed, **settings)

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        del ex  # its text is in the message
        sys.exit(_fail(f"{message}; see sightline --help", _REFUSED))


def _check_writable(path: Path | None) -> None:
    """Refuses the place of a report before the work for it is done."""
    if path is None:
        return
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
        raise ValueError(f"{path} cannot be written; name a file in a folder that you may write to")


def _deliver(report: _Report, path: Path | None) -> None:
    """Prints a report and writes it to a JSON file."""
    from rich.console import Console

    console = Console()
    console.print(report.table(), width=None if console.is_terminal else _FILE_WIDTH)
    if path is not None:
        atomic_write_text(path, json.dumps(report.to_json(), indent=2) + "\n")


def _fail(message: str, status: int) -> int:
    one_line = re.sub(r"\s+", " ", message).strip()
    print(f"sightline: {one_line}", file=sys.stderr)
    return status


def _join_numbers(arguments: list[str], option: str) -> list[str]:
    """Lets `--beams 64 32` stand for the list that jsonargparse writes `--beams=[64,32]`."""
    if option not in arguments:
        return arguments
    start = arguments.index(option)
    end = start + 1
    while end < len(arguments) and re.fullmatch(r"[0-9.]+", arguments[end]):
        end += 1
    if end == start + 1:
        return arguments  # the parser says what is wrong
    joined = f"{option}=[{','.join(arguments[start + 1 : end])}]"
    return [*arguments[:start], joined, *arguments[end:]]
