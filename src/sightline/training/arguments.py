"""Arguments of the training commands, parsed before PyTorch is imported."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, Literal

from sightline.files.plain_text import read_text

Subcommand = Literal["fit", "validate", "test"]


@dataclass(frozen=True, kw_only=True, slots=True)
class RunOption:
    """Argument of a run, in addition to those of trainer, model and data."""

    flag: str
    kind: type
    default: object
    help: str


RUN_FOLDER = RunOption(
    flag="--run_folder",
    kind=Path,
    default=None,
    help="Folder for all files of the run; by default runs/NAME, by the recipe's name.",
)
CHECKPOINT_EVERY_N_STEPS = RunOption(
    flag="--checkpoint_every_n_steps",
    kind=int,
    default=500,
    help="Interval [steps] of writing last.ckpt, besides at validations and epoch ends.",
)

KEEP_LAST_WEIGHTS = RunOption(
    flag="--keep_last_weights",
    kind=bool,
    default=False,
    help="Whether weights.safetensors and scores use the last weights, not the best validated.",
)

MIN_DATA_SETTINGS: Final = {
    "batch_size": 1,
    "validation_batch_size": 1,
    "samples_per_epoch": 1,
    "workers": 0,
    "seed": 0,
}
"""Smallest values of the numbers among the settings of `data`."""
_DATA: Final = "--data.init_args."

_HELP = """usage: sightline {subcommand} --config NAME|FILE [--SETTING VALUE ...]

{task}

recipes (or your own YAML file):
{recipes}

arguments of the run:
  --data.init_args.root FOLDER
      Base folder of the data sets.
{options}
  --ckpt_path last|best|FILE
      {checkpoint}
  --seed_everything SEED
      Seed of all random numbers. (default: 0)

Every setting of a recipe is a flag:
  sightline {subcommand} --config {name} --print_config    lists them all
  sightline {subcommand} --config {name} --help            explains them (takes a while)"""
_SCORED_CHECKPOINT = """Checkpoint to score. (default: best, else last, or with
      --keep_last_weights true last, else best; in a folder without checkpoints
      the weights of --model.init_args.initial_weights)"""
_TASKS: dict[Subcommand, tuple[str, str]] = {
    "fit": (
        "Train a network. Its run folder gets the settings, TensorBoard's events, last.ckpt,\n"
        "best.ckpt and weights.safetensors.",
        "Checkpoint to resume from; last is the last one in the run's folder.",
    ),
    "validate": (
        "Score a network of a run on its validation data.",
        _SCORED_CHECKPOINT,
    ),
    "test": (
        "Score a network of a run on test data.",
        _SCORED_CHECKPOINT,
    ),
}


_NO_RECIPE_NAME = "unnamed"  # a run without a recipe


def requests_command_help(arguments: Sequence[str]) -> bool:
    """Whether help on the command itself is requested, not on the settings of a recipe."""
    has_recipe = any(argument.partition("=")[0] in ("--config", "-c") for argument in arguments)
    return not has_recipe and any(argument in ("--help", "-h") for argument in arguments)


def help_text(subcommand: Subcommand, recipes: Path) -> str:
    """Help text of a command."""
    listed = {path.stem: _first_sentence(path) for path in sorted(recipes.glob("*.yaml"))}
    width = max(map(len, listed), default=0)
    options = (
        f"  {option.flag} {option.kind.__name__.upper()}\n      {option.help}"
        + ("" if option.default is None else f" (default: {option.default})")
        for option in (RUN_FOLDER, CHECKPOINT_EVERY_N_STEPS, KEEP_LAST_WEIGHTS)
    )
    task, checkpoint = _TASKS[subcommand]
    return _HELP.format(
        subcommand=subcommand,
        task=task,
        checkpoint=checkpoint,
        recipes="\n".join(f"  {name:<{width}}  {about}" for name, about in listed.items()),
        options="\n".join(options),
        name=next(iter(listed), "FILE"),
    )


def resolve_recipes(arguments: Sequence[str], recipes: Path) -> tuple[list[str], str]:
    """Replace names of recipes by files, and put these first: other arguments replace settings.

    Returns:
        The arguments, and the name of the last recipe.

    Raises:
        ValueError: There is no such recipe, or neither a recipe nor a model is given.
    """
    found: list[str] = []
    others: list[str] = []
    name = _NO_RECIPE_NAME
    waiting = iter(arguments)
    for argument in waiting:
        option, equals, value = argument.partition("=")
        if option not in ("--config", "-c"):
            others.append(argument)
            continue
        value = value if equals else next(waiting, "")
        path = _find_recipe(value, recipes)
        found.append(f"--config={path}")
        name = path.stem
    if name == _NO_RECIPE_NAME and not any(
        argument.startswith("--model") for argument in arguments
    ):
        raise ValueError(f"no recipe is given; {_without_recipe(arguments, recipes)}")
    return found + others, name


def _without_recipe(arguments: Sequence[str], recipes: Path) -> str:
    """Remedy for a missing recipe: the settings in the run's folder, or a list of recipes."""
    words = " ".join(arguments).replace(f"{RUN_FOLDER.flag}=", f"{RUN_FOLDER.flag} ").split()
    for flag, folder in pairwise(words):
        settings = Path(folder) / "config.yaml"
        if flag == RUN_FOLDER.flag and settings.is_file():
            return f"the run's own is {settings}: add --config={settings}"
    return f"name one with --config: {_choice(recipes)}"


def check_data_numbers(arguments: Sequence[str]) -> None:
    """Refuse too small numbers among the flags of `data`, before PyTorch is imported.

    Raises:
        ValueError: See `check_data_number`.
    """
    words = [word for argument in arguments for word in argument.split("=", 1)]
    for flag, value in pairwise(words):
        name = flag.removeprefix("--data.").removeprefix("init_args.")
        if flag.startswith("--data.") and re.fullmatch(r"[+-]?\d+", value):
            check_data_number(name, int(value))


def check_data_number(name: str, value: int | None) -> None:
    """Refuse a number that is too small for a setting of `data`.

    Args:
        name: Name of the setting; settings outside `MIN_DATA_SETTINGS` are not checked.
        value: Its value; None: the default.

    Raises:
        ValueError: It is below the smallest one; the message contains the flag.
    """
    minimum = MIN_DATA_SETTINGS.get(name)
    if minimum is not None and value is not None and value < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {value}: set {_DATA}{name}")


def nulls_as_configs(arguments: Sequence[str]) -> list[str]:
    """Replace each `--SETTING null` by a configuration with only that setting.

    jsonargparse 4.53 accepts nulls in configurations, but not as flags of nested settings
    (`--model.init_args.network.regions null`).
    """
    replaced: list[str] = []
    for argument in arguments:
        previous = replaced[-1] if replaced else ""
        option, _, value = argument.partition("=")
        if _is_inner_setting(option) and value == "null":
            replaced.append(_config_of_null(option))
        elif _is_inner_setting(previous) and "=" not in previous and argument == "null":
            replaced[-1] = _config_of_null(previous)
        else:
            replaced.append(argument)
    return replaced


def _is_inner_setting(flag: str) -> bool:
    return flag.startswith(("--model.", "--data."))


def _config_of_null(flag: str) -> str:
    setting: object = None
    for key in reversed(flag.removeprefix("--").split(".")):
        setting = {key: setting}
    return f"--config={json.dumps(setting)}"


def _find_recipe(name: str, recipes: Path) -> Path:
    if not name:
        raise ValueError(f"--config has no value; name {_choice(recipes)}")
    for path in (Path(name), recipes / f"{name}.yaml"):
        if path.is_file():
            read_text(path)  # refuses one that is too large, or no text
            return path
    raise ValueError(f"there is no recipe {name}; name {_choice(recipes)}")


def _choice(recipes: Path) -> str:
    names = ", ".join(sorted(path.stem for path in recipes.glob("*.yaml"))) or "none"
    return f"a YAML file or one of the package's: {names}"


def _first_sentence(recipe: Path) -> str:
    """First sentence of the comment at a recipe's head."""
    head = []
    for line in recipe.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        head.append(line.removeprefix("#").strip())
    return " ".join(head).partition(": ")[0].partition(". ")[0].rstrip(".:")
