"""Commands fit, validate and test, before PyTorch is needed: its import takes seconds."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from sightline.files.extras import require_library
from sightline.training.arguments import (
    Subcommand,
    check_data_numbers,
    help_text,
    nulls_as_configs,
    requests_command_help,
    resolve_recipes,
)
from sightline.training.interruption import ending_by_signals, terminating_workers

_WAIT_POLICY: Final = "OMP_WAIT_POLICY"


def run_training(subcommand: Subcommand, arguments: Sequence[str], recipes: Path) -> int:
    """Trains, validates or tests with a recipe.

    `--config NAME` reads a recipe of `recipes` by its name, or any YAML file; other arguments
    replace its settings (`--trainer.max_epochs 5`). `--print_config` shows the resulting settings,
    `--help` all settings. The run's folder gets the settings, TensorBoard's events, last.ckpt,
    best.ckpt and weights.safetensors; `--ckpt_path last` resumes the run.

    Args:
        subcommand: fit, validate or test.
        arguments: Arguments of the command line after the subcommand.
        recipes: Folder of YAML files.

    Returns:
        Exit status.

    Raises:
        ValueError: Lightning is not installed, or the settings or the data are refused, in one
            sentence.
        Interruption: Ctrl-C or SIGTERM; the message explains how to resume.
    """
    if requests_command_help(arguments):
        print(help_text(subcommand, recipes))
        return 0
    require_library("lightning", "train")
    check_data_numbers(arguments)
    resolved, name = resolve_recipes(arguments, recipes)
    print(f"sightline {subcommand}: {name}", file=sys.stderr, flush=True)  # the rest takes a while
    _set_passive_waiting()
    from sightline.training.lightning_cli import run_lightning

    with ending_by_signals(), terminating_workers():
        run_lightning(subcommand, nulls_as_configs(resolved), Path("runs") / name)
    return 0


def _set_passive_waiting() -> None:
    """Set OpenMP's waiting policy, unless the user has, before PyTorch reads it.

    By default, threads wait for each other in busy loops. Beside other jobs, these take the
    processor from the thread that is waited for.
    """
    if "torch" in sys.modules or {_WAIT_POLICY, "GOMP_SPINCOUNT", "KMP_BLOCKTIME"} & set(
        os.environ
    ):
        return
    os.environ[_WAIT_POLICY] = "passive"
    if os.environ.get("OMP_NUM_THREADS") != "1":
        print(
            "PyTorch's threads wait passively; OMP_NUM_THREADS=1 may be faster beside other "
            f"jobs, {_WAIT_POLICY}=active on an idle machine",
            file=sys.stderr,
            flush=True,
        )
