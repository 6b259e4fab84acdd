"""The command line: the only place that parses arguments.

Each command is a typed function; jsonargparse turns its signature and docstring into arguments and
help. Commands import their dependencies themselves, so that `--help` is fast.
"""

import errno
import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jsonargparse

from sightline.cli.adapt import adapt, average, fit_joined
from sightline.cli.calibration import evaluate_calibration
from sightline.cli.check import check
from sightline.cli.config_files import check_settings_files, with_config_first
from sightline.cli.corrupt import corrupt
from sightline.cli.evaluate import (
    depth_command,
    held_out_command,
    objects_command,
    proposals_command,
    realism_command,
)
from sightline.cli.health import health, health_limits
from sightline.cli.importing import import_command
from sightline.cli.interrupts import HOW_TO_FINISH, raised_signal
from sightline.cli.output import discard_output, fail, say, warn
from sightline.cli.parser import REFUSED, OneLineParser
from sightline.cli.perceive import perceive_command
from sightline.cli.predict import predict_commands
from sightline.cli.proposals import proposals
from sightline.cli.report import check_places, check_writable_folder, deliver, named_file
from sightline.cli.reproduce import (
    renamed,
    reproduce_gated_fusion,
    reproduce_shift_conv,
    reproduce_two_stage,
)
from sightline.cli.robustness import robustness
from sightline.cli.serve import serve
from sightline.cli.sharding import shard, unshard
from sightline.cli.show import show
from sightline.cli.simulate import simulate_command
from sightline.cli.tasks import list_tasks
from sightline.export.names import Format
from sightline.files.plain_text import shortened
from sightline.files.problem import error_text, memory_fault
from sightline.tasks import PACKAGE_RECIPES, choose_task, find_task, task_names
from sightline.training.interruption import Interruption

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sightline.export.parity import ParityReport

_INTERRUPTED = 130  # exit status of a program ended by Ctrl-C
_LINK_LOOP = "Symlink loop"  # how `Path.resolve` begins its RuntimeError
_NO_TEMPORARY = "No usable temporary directory"  # in the error of `tempfile.gettempdir`
_BROKEN_PIPE = 141  # exit status of a program ended by SIGPIPE


def export(
    out: Path,
    *,
    weights: str = "depth-best",
    format: Format = "onnx",  # noqa: A002 - the flag's name
) -> None:
    """Export a network to a file that runs without PyTorch, and check that its outputs agree.

    Args:
        out: File to write: .onnx, or .xml for OpenVINO. For joined, a folder.
        weights: Name of weights in Sightline (`sightline tasks` lists them), a file (.safetensors,
            .ckpt), or joined: both detectors and the models that join their boxes.
        format: Format of the file: onnx or openvino.
    """
    from sightline.joining.models import JOINED

    if weights == JOINED:
        from sightline.joining.export import MODELS_NAME, export_joined

        check_writable_folder(out)
        _say_reports(export_joined(out, format))
        say(out / MODELS_NAME)
        return
    from sightline.export.write import export_graphs
    from sightline.files.weights_header import find_weights
    from sightline.inference.network import load_network

    check_places({"OUT": out}, data=[named_file(weights)])
    task = choose_task(None, find_weights(weights))
    say(f"{task.name} by {weights}")
    _say_reports(export_graphs(task.graphs(load_network(task, weights)), out, format))


def _say_reports(reports: "Mapping[Path, ParityReport]") -> None:
    """Print the differences to PyTorch of each exported file."""
    for path, report in reports.items():
        deliver(report, None)
        say(path)


def submission(results: Path, out: Path, *, sample_list: str | None = None) -> None:
    """Check result files and pack them into the archive for KITTI's object benchmark.

    Args:
        results: Folder with one result file per frame (16 fields per line), empty without
            detections.
        out: Archive to write, .zip.
        sample_list: List of the required frames: a list in ImageSets beside the folder or a text
            file with one name per line. Default: all that have a file.
    """
    from sightline.data.submission import write_submission

    check_places({"OUT": out}, data=[named_file(sample_list)], results=[results])
    say(f"{out}: {write_submission(results, out, sample_list=sample_list)} frames")


def demo(out: Path = Path("demo")) -> None:
    """Run all tasks on the embedded frames and write pictures and a report.

    Takes some 100 seconds on two CPU cores.

    Args:
        out: Folder to write to.
    """
    from sightline.inference.demo import run_demo

    names = task_names()
    warn(
        f"demo: {', '.join(names)} on two embedded frames, with scores and pictures; some 100 "
        "seconds on two CPU cores, longer beside other jobs"
    )
    say(*run_demo(out, [find_task(name).demo for name in names]).split("\n"))


_TRAINING = {
    "fit": "Train a network by a recipe: --config NAME|FILE.",
    "validate": "Score a network that is being trained on its validation data.",
    "test": "Score a trained network on test data.",
}


def _commands() -> dict[str, Any]:
    """All commands, with the tasks currently registered."""
    return {
        "demo": demo,
        "import": import_command,
        "check": check,
        "shard": shard,
        "unshard": unshard,
        "show": show,
        "serve": serve,
        "simulate": simulate_command(),
        "corrupt": corrupt,
        "health": health,
        "health-limits": health_limits,
        **{name: {"_help": text} for name, text in _TRAINING.items()},  # for --help
        "adapt": adapt,
        "average": average,
        "fit-joined": fit_joined,
        "tasks": list_tasks,
        "predict": predict_commands(),
        "perceive": perceive_command(),
        "proposals": proposals,
        "evaluate": {
            "_help": "Score results.",
            "objects": objects_command,
            "proposals": proposals_command,
            "calibration": evaluate_calibration,
            "depth": depth_command,
            "held-out": held_out_command,
            "realism": realism_command,
        },
        "robustness": robustness,
        "reproduce": {
            "_help": "Print a paper's tables beside our own results.",
            "gated-fusion": reproduce_gated_fusion,
            "two-stage": reproduce_two_stage,
            "shift-conv": reproduce_shift_conv,
            "dgfn": renamed(reproduce_gated_fusion, "dgfn", "gated-fusion"),
            "shiftconv": renamed(reproduce_shift_conv, "shiftconv", "shift-conv"),
        },
        "export": export,
        "submission": submission,
    }


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit status; errors are one line on standard error."""
    given = sys.argv[1:] if arguments is None else arguments
    try:
        Path.cwd()  # libraries abort without one
    except OSError:
        return fail("the current folder no longer exists; change to another one", REFUSED)
    try:
        return _run(given)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        discard_output(sys.stdout)
        return _BROKEN_PIPE
    except KeyboardInterrupt as error:
        status = error.exit_status if isinstance(error, Interruption) else _INTERRUPTED
        return fail(str(error) or HOW_TO_FINISH, status)
    except (Exception, SystemExit) as error:
        if (number := raised_signal()) is not None:
            return fail(HOW_TO_FINISH, Interruption("", number).exit_status)
        if isinstance(error, (ValueError, OSError)):
            return fail(_fault_of_system(error) or error_text(error), REFUSED)
        if isinstance(error, UserWarning):
            return fail(f"{error} (a warning, which PYTHONWARNINGS makes an error)", REFUSED)
        if isinstance(error, RuntimeError) and str(error).startswith(_LINK_LOOP):
            return fail(
                f"{error}: a link that leads to itself; remove it, or give another path", REFUSED
            )
        if (fault := memory_fault(error)) is None:
            raise
        return fail(fault, REFUSED)


def _fault_of_system(error: Exception) -> str | None:
    """Describe a name that is too long, a lack of temporary folders or of processes; else None."""
    if isinstance(error, FileNotFoundError) and _NO_TEMPORARY in str(error):
        return (
            "no temporary folder (TMPDIR, /tmp, ..) can be written to; make room, or name another "
            "one by the variable TMPDIR"
        )
    if isinstance(error, BlockingIOError):  # of a process that cannot be started
        return memory_fault(error)
    if not isinstance(error, OSError) or error.errno != errno.ENAMETOOLONG:
        return None
    path = os.fsdecode(error.filename or "")
    longest = max((len(os.fsencode(part)) for part in path.split("/")), default=0)
    return (
        f"{shortened(path, 100)}: the path is too long ({len(os.fsencode(path))} bytes, its "
        f"longest name {longest}; a name may have 255, a path 4095); choose a shorter one"
    )


def _refuse_shell_mistakes(arguments: list[str]) -> None:
    """Refuse arguments that a mistake in the shell would turn into a wrong path.

    `-` would not be standard input or output but a file's name, an empty word (a variable without a
    value) the current folder, and `~` a folder of that name, as shells leave it in `--json=~/x`.
    """
    for argument in arguments:
        option, _, value = argument.rpartition("=")
        if not value and (not option or option.startswith("--")):
            empty = f"the value of {option}" if option else "an argument"
            raise ValueError(
                f"{empty} is empty, probably a variable of the shell without a value; name a file "
                "or folder, or . for the current folder"
            )
        if value.startswith("~/") and (not option or option.startswith("--")):
            raise ValueError(
                f"{argument}: ~ stands for the home folder only where the shell replaces it; write "
                "the path in full, such as $HOME/out"
            )
        if value == "-" and (not option or option.startswith("--")):
            raise ValueError(
                f"{argument} stands for no file: standard input and output are not supported; name "
                "a file, such as out.json, or ./- for one of that name"
            )


def _named(commands: dict[str, Any], arguments: list[str]) -> dict[str, Any]:
    """Select the named command, as each parser takes 6 ms to build; without a name, keep all."""
    name = next(iter(arguments), "")
    if name not in commands or name == "_help":
        return commands
    command = commands[name]
    if isinstance(command, dict):
        command = {"_help": command["_help"]} | _named(command, arguments[1:])
    return {name: command}


def _run(arguments: list[str]) -> int:
    _refuse_shell_mistakes(arguments)
    match arguments:
        case ["fit" | "validate" | "test" as training, *rest]:
            # Unparsed: Lightning creates the parser for the recipe's classes.
            from sightline.training.command import run_training

            check_settings_files(rest)
            return run_training(training, rest, recipes=PACKAGE_RECIPES)
    commands = _named(_commands(), arguments)
    status = jsonargparse.auto_cli(
        commands,
        args=with_config_first(arguments, commands),
        prog="sightline",
        version=version("sightline"),
        parser_class=OneLineParser,
    )
    return status if isinstance(status, int) else 0
