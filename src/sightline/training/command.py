"""The commands fit, validate and test: a recipe, flags over it, and the folder of the run."""

import json
import logging
import signal
import warnings
from argparse import ArgumentError
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NoReturn

from jsonargparse import Namespace
from lightning import LightningModule, Trainer
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, ModelCheckpoint, ProgressBar, RichProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback
from lightning.pytorch.loggers import TensorBoardLogger
from rich.console import Console

from sightline.data.atomic import atomic_write_text
from sightline.training.callbacks import LastCheckpoint, RandomState, WriteWeights
from sightline.training.checkpoint import read_checkpoint_weights
from sightline.training.data import CameraLidarData
from sightline.training.module import TrainingModule

Subcommand = Literal["fit", "validate", "test"]

LIGHTNING_NOISE = (
    "The '.*_dataloader' does not have many workers",
    "The number of training batches .* is smaller than the logging interval",
    "Checkpoint directory .* exists and is not empty",
    "You're using the WeightAveraging callback, but loading a checkpoint outside",
    "`isinstance.treespec, LeafSpec.` is deprecated",
    r"\s*By default only one JsonargparseDeprecationWarning",
    r"\s*``instantiate_classes`` was deprecated",
)
"""Beginnings of Lightning's warnings that the user of a recipe can or need do nothing about."""

_TRIED = (
    "Does not validate against any of the Union subtypes",
    "Subtypes: ",
    "Errors:",
    "Expected a <class 'NoneType'>",
    "Given value type: ",
    "Given value: NestedArg",
)
_LONG_VALUE = 80  # characters


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
        KeyboardInterrupt: Ctrl-C; the message tells how to go on.
    """
    arguments, name = _resolve_recipes(arguments, recipes)
    run_folder = Path("runs") / name
    with _quiet_lightning():
        try:
            _TrainingCLI(subcommand, arguments, run_folder)
        except _RefusedError as error:
            said = _shorten(str(error))
            raise ValueError(f"{said}; see sightline {subcommand} --help") from error
        except (MisconfigurationException, ValueError) as error:
            raise ValueError(_shorten(str(error))) from error
        except SystemExit as end:
            # Lightning leaves this way after Ctrl-C.
            if isinstance(end.__context__, KeyboardInterrupt):
                signal.signal(signal.SIGINT, signal.default_int_handler)
                raise KeyboardInterrupt(
                    "interrupted; add --ckpt_path last to the same command to go on"
                ) from end
            raise
    return 0


class _RefusedError(Exception):
    """Arguments that cannot be understood. Not a ValueError, which jsonargparse catches."""


class _Parser(LightningArgumentParser):
    """Raises instead of leaving the process, and takes no flag that is cut short."""

    def __init__(self, *positional: Any, **named: Any) -> None:  # noqa: ANN401 - as base
        super().__init__(*positional, **{"allow_abbrev": False, **named})

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        if isinstance(ex, ArgumentError):
            message = ex.message
        raise _RefusedError(message)


class _SaveConfig(SaveConfigCallback):
    """Writes the settings into the run's folder, where `fit --config` reads them again."""

    def __init__(self, parser: LightningArgumentParser, config: Namespace, *, folder: Path) -> None:
        super().__init__(parser, config, save_to_log_dir=False)
        self._folder = folder

    def save_config(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        del trainer, pl_module
        name = "config.yaml" if stage == "fit" else f"config_{stage}.yaml"
        config = self.config.clone()
        config["ckpt_path"] = None  # to repeat the run, not to go on from its middle
        atomic_write_text(self._folder / name, self.parser.dump(config, skip_unset=False))


class _TrainingCLI(LightningCLI):
    """Lightning's command line with our run folder, checkpoints and logger."""

    def __init__(self, subcommand: Subcommand, arguments: Sequence[str], run_folder: Path) -> None:
        self._default_run_folder = run_folder
        super().__init__(
            TrainingModule,
            CameraLidarData,
            subclass_mode_model=True,
            subclass_mode_data=True,
            save_config_callback=_SaveConfig,
            trainer_defaults={"use_distributed_sampler": False},
            seed_everything_default=0,
            parser_class=_Parser,
            parser_kwargs={"prog": "sightline"},
            auto_configure_optimizers=False,
            load_from_checkpoint_support=False,
            args=[subcommand, *arguments],
        )

    @staticmethod
    def subcommands() -> dict[str, set[str]]:
        """Those of a Trainer that this command line has, each with the arguments to leave out."""
        skipped = {"model", "datamodule"}
        return {
            "fit": skipped | {"train_dataloaders", "val_dataloaders", "weights_only"},
            "validate": skipped | {"dataloaders", "weights_only"},
            "test": skipped | {"dataloaders", "weights_only"},
        }

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Adds what a run has beside model, data and trainer."""
        parser.add_argument(
            "--run_folder",
            type=Path,
            default=self._default_run_folder,
            help="Folder for all that the run writes.",
        )
        parser.add_argument(
            "--checkpoint_every_n_steps",
            type=int,
            default=500,
            help="How often last.ckpt is written, besides at the end of each epoch.",
        )
        parser.link_arguments("seed_everything", "data.init_args.seed", compute_fn=int)

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:  # noqa: ANN401 - as base
        """Parses; Lightning's own warns about arguments that do not come from sys.argv."""
        self.config = parser.parse_args(args)

    def _parse_ckpt_path(self) -> None:
        """Does nothing: our checkpoints hold no arguments."""

    def before_instantiate_classes(self) -> None:
        """Finds the checkpoint, and refuses a run that would overwrite another."""
        config = self.config[self.subcommand]
        folder: Path = config["run_folder"]
        given: str | None = config["ckpt_path"]
        starts_elsewhere = config["model"]["init_args"].get("initial_weights") is not None
        if self.subcommand == "fit":
            if given is None and (folder / "last.ckpt").exists():
                raise ValueError(
                    f"{folder} holds a run already; go on with it by --ckpt_path last, or name "
                    "another folder with --run_folder"
                )
        elif given is None and not starts_elsewhere:
            given = "best" if (folder / "best.ckpt").is_file() else "last"
        if given is None:
            return
        path = folder / f"{given}.ckpt" if given in ("best", "last") else Path(given)
        if not path.is_file():
            raise ValueError(
                f"there is no checkpoint {path}; name one with --ckpt_path, or the folder of "
                "another run with --run_folder"
            )
        read_checkpoint_weights(path)  # says in one line what may be wrong with it
        config["ckpt_path"] = str(path)

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:  # noqa: ANN401 - as base
        """Adds the logger and the callbacks of a run to what the recipe asks for."""
        config = self.config[self.subcommand]
        folder: Path = config["run_folder"]
        self.save_config_kwargs = {"folder": folder}
        settings = self.config_init[self.subcommand]["trainer"]
        if settings["logger"] in (None, True):
            kwargs["logger"] = TensorBoardLogger(folder, name="", version="")
        if settings["default_root_dir"] is None:
            kwargs["default_root_dir"] = folder
        given = settings["callbacks"] or []
        given = list(given) if isinstance(given, list) else [given]
        kwargs["callbacks"] = given + self._run_callbacks(folder, config, settings, given)
        return super().instantiate_trainer(**kwargs)

    def after_fit(self) -> None:
        """Says where the weights are."""
        if self.trainer.is_global_zero:
            folder: Path = self.config[self.subcommand]["run_folder"]
            Console().print(f"{folder}: the weights are in weights.safetensors", highlight=False)

    def after_validate(self) -> None:
        """Writes the metrics."""
        self._write_metrics()

    def after_test(self) -> None:
        """Writes the metrics."""
        self._write_metrics()

    def _run_callbacks(
        self,
        folder: Path,
        config: Namespace,
        settings: Namespace,
        given: Sequence[Callback],
    ) -> list[Callback]:
        """The callbacks of every run; checkpoints in the order in which they need each other."""
        callbacks: list[Callback] = [RandomState()]
        has_bar = any(isinstance(callback, ProgressBar) for callback in given)
        if settings["enable_progress_bar"] is not False and not has_bar:
            callbacks.append(RichProgressBar())
        if settings["enable_checkpointing"] is False or settings["fast_dev_run"]:
            return callbacks
        best = None
        if self.datamodule.sources["validation"]:
            monitor, mode = self.model.monitored
            best = ModelCheckpoint(
                folder,
                "best",
                monitor=monitor,
                mode=mode,
                save_on_train_epoch_end=False,  # but when validated, before the weights
                enable_version_counter=False,
            )
            callbacks.append(best)
        last = LastCheckpoint(folder, every_n_steps=config["checkpoint_every_n_steps"])
        return [*callbacks, last, WriteWeights(folder, last, best)]

    def _write_metrics(self) -> None:
        if not self.trainer.is_global_zero:
            return
        config = self.config[self.subcommand]
        report = {
            "checkpoint": config["ckpt_path"],
            "metrics": {
                name: float(value) for name, value in self.trainer.callback_metrics.items()
            },
        }
        path = config["run_folder"] / f"{self.subcommand}.json"
        atomic_write_text(path, json.dumps(report, indent=2) + "\n")


def _resolve_recipes(arguments: Sequence[str], recipes: Path) -> tuple[list[str], str]:
    """The arguments with files for names of recipes, and the name of the last recipe."""
    resolved: list[str] = []
    name = "unnamed"
    expected = False
    for argument in arguments:
        option, equals, value = argument.partition("=")
        if expected:
            path = _find_recipe(argument, recipes)
            resolved.append(str(path))
            name = path.stem
        elif equals and option == "--config":
            path = _find_recipe(value, recipes)
            resolved.append(f"{option}={path}")
            name = path.stem
        else:
            resolved.append(argument)
        expected = not expected and argument in ("--config", "-c")
    return resolved, name


def _find_recipe(name: str, recipes: Path) -> Path:
    for path in (Path(name), recipes / f"{name}.yaml"):
        if path.is_file():
            return path
    known = ", ".join(sorted(path.stem for path in recipes.glob("*.yaml"))) or "none"
    raise ValueError(
        f"there is no recipe {name}; name a YAML file or one of the package's: {known}"
    )


def _shorten(message: str) -> str:
    """Takes out of jsonargparse's messages which types it tried before it gave up."""
    lines = [line.strip().removeprefix("- ") for line in message.splitlines()]
    told = [line for line in lines if not line.startswith(_TRIED)]
    return " ".join(
        line for line in told if not line.startswith("Given value: ") or len(line) < _LONG_VALUE
    )


@contextmanager
def _quiet_lightning() -> Iterator[None]:
    """Keeps Lightning from telling what nobody asked for; its real warnings stay."""
    loggers = [logging.getLogger(f"lightning.{part}") for part in ("pytorch", "fabric")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.WARNING)
    try:
        with warnings.catch_warnings():
            for beginning in LIGHTNING_NOISE:
                warnings.filterwarnings("ignore", beginning)
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
