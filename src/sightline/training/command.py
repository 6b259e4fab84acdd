"""The commands fit, validate and test, up to where PyTorch is needed: its import takes seconds."""

import sys
from collections.abc import Sequence
from pathlib import Path

from sightline.training.arguments import (
    Subcommand,
    asks_for_help,
    help_text,
    nulls_as_configs,
    resolve_recipes,
)
from sightline.training.interruption import ending_like_ctrl_c


def run_training(subcommand: Subcommand, arguments: Sequence[str], recipes: Path) -> int:
    """Trains, validates or tests what a recipe describes.

    `--config NAME` takes a recipe of `recipes` by its name, or any YAML file; other arguments
    replace its settings (`--trainer.max_epochs 5`); `--print_config` shows what comes of them, and
    `--help` all there are. The run's folder gets the settings, TensorBoard's events, last.ckpt,
    best.ckpt and weights.safetensors; `--ckpt_path last` goes on from there.

    Args:
        subcommand: What to do.
        arguments: Of the command line, behind the subcommand.
        recipes: Folder of YAML files.

    Returns:
        Exit status.

    Raises:
        ValueError: The settings or the data are refused; in one sentence.
        Interruption: Ctrl-C or SIGTERM; the message tells how to go on.
    """
    if asks_for_help(arguments):
        print(help_text(subcommand, recipes))
        return 0
    resolved, name = resolve_recipes(arguments, recipes)
    print(f"sightline {subcommand}: {name}", file=sys.stderr, flush=True)  # the rest takes a while
    from sightline.training.lightning_cli import run_lightning

    with ending_like_ctrl_c():
        run_lightning(subcommand, nulls_as_configs(resolved), Path("runs") / name)
    return 0
