"""Lightning's command line with the folder of a run: settings, claims, checkpoints, scores."""

import json
import math
import os
import re
import signal
import sys
from argparse import ArgumentError
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from jsonargparse import Namespace
from lightning import LightningModule, Trainer
from lightning.fabric.plugins import CheckpointIO
from lightning.fabric.plugins.environments.torchelastic import TorchElasticEnvironment
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import Callback, ProgressBar
from lightning.pytorch.cli import LightningArgumentParser, LightningCLI, SaveConfigCallback
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from sightline.files.atomic import atomic_write_text, disk_fault
from sightline.files.settings import shorten_parser_error, without_backspaces
from sightline.files.weights import read_checkpoint_weights
from sightline.files.weights_header import RUN_WEIGHTS, has_weights, read_description
from sightline.jobs.output_dirs import check_outside_dataset
from sightline.training.arguments import (
    CHECKPOINT_EVERY_N_STEPS,
    KEEP_LAST_WEIGHTS,
    RUN_FOLDER,
    Subcommand,
)
from sightline.training.callbacks import (
    LogShortRuns,
    LogSteps,
    ReturnFreeMemory,
    checkpoint_callbacks,
)
from sightline.training.checked_settings import check_nulls, check_trainer_settings
from sightline.training.data import CameraLidarData
from sightline.training.interruption import Interruption
from sightline.training.last_checkpoint import AtomicCheckpointIO, check_checkpoint_file
from sightline.training.module import STEP, TrainingModule
from sightline.training.progress import RunProgress
from sightline.training.quiet import quiet_lightning
from sightline.training.resumed_settings import resumed_settings_note
from sightline.training.run_folder import check_name, claimed

_TENSORBOARD = (None, True)
_NO_ACCELERATOR = re.compile(r"No supported \w+ backend found|can ?not run on your system")
"""Values of `trainer.logger` that stand for TensorBoard's."""
_CONFIG_NAMES = {
    "fit": "config.yaml",
    "validate": "config_validate.yaml",
    "test": "config_test.yaml",
}


def run_lightning(subcommand: Subcommand, arguments: Sequence[str], run_folder: Path) -> None:
    """Train, validate or test with Lightning's arguments.

    Args:
        subcommand: fit, validate or test.
        arguments: Arguments of Lightning's command line.
        run_folder: Folder of the run, if the arguments name none.

    Raises:
        ValueError: The settings or the data are refused, in one sentence.
        Interruption: Ctrl-C or SIGTERM; the message explains how to resume.
    """
    with quiet_lightning(), ExitStack() as claims:
        run = _Run(run_folder, claims)
        try:
            _TrainingCLI(subcommand, arguments, run)
        except _RefusedError as error:
            message = _named_by_flag(shorten_parser_error(str(error)), arguments)
            raise ValueError(f"{message}; see sightline {subcommand} --help") from error
        except (MisconfigurationException, ValueError) as error:
            message = shorten_parser_error(str(error))
            if _NO_ACCELERATOR.search(message):
                message = (
                    "--trainer.accelerator names a device that PyTorch does not find here; leave "
                    "it out or give cpu"
                )
            raise ValueError(message) from error
        except OSError as error:  # from writing best.ckpt and the events, in other libraries
            fault = disk_fault(error, run.folder)
            if fault is None:
                raise
            raise fault from error
        except SystemExit as end:
            # Lightning leaves this way after a KeyboardInterrupt.
            if isinstance(end.__context__, KeyboardInterrupt):
                raise _with_remedy(end.__context__, run, subcommand) from end
            raise
        except KeyboardInterrupt as interruption:
            raise _with_remedy(interruption, run, subcommand) from interruption


def _named_by_flag(message: str, arguments: Sequence[str]) -> str:
    """Replace the parser's keys, which leave parts out, by the given flag, or else by one path."""
    keys = re.match(r'(Parser key "[\w.]+": +)+', message)
    if keys is None:
        return message
    names = re.findall('"(.*?)"', keys[0])
    flags = [word.partition("=")[0] for word in arguments if word.startswith("--")]
    given = [flag for flag in flags if f".{flag.removeprefix('--')}".endswith(f".{names[-1]}")]
    rest = message[keys.end() :]
    return f"{given[-1] if given else '.'.join(names)}: {rest[:1].lower()}{rest[1:]}"


@dataclass
class _Run:
    """State of a run before its command line is fully parsed."""

    folder: Path
    claims: ExitStack


def _with_remedy(interrupt: KeyboardInterrupt, run: _Run, subcommand: Subcommand) -> Interruption:
    """Add the remedy to an interruption."""
    remedy = "run the same command again"
    if subcommand == "fit":
        is_resumable = (run.folder / "last.ckpt").is_file()
        remedy = (
            "add --ckpt_path last to the same command to resume"
            if is_resumable
            else (f"there is no checkpoint yet: {remedy}")
        )
    number = interrupt.number if isinstance(interrupt, Interruption) else signal.SIGINT
    return Interruption(f"interrupted; {remedy}", number)


class _RefusedError(Exception):
    """Invalid arguments. Not a ValueError, which jsonargparse catches."""


class _Parser(LightningArgumentParser):
    """Parser that raises instead of exiting, and refuses abbreviated flags."""

    def __init__(self, *positional: Any, **named: Any) -> None:  # noqa: ANN401 - as base
        super().__init__(*positional, **{"allow_abbrev": False, **named})

    def format_help(self, *positional: Any, **named: Any) -> str:  # noqa: ANN401 - as base
        return without_backspaces(super().format_help(*positional, **named))

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        if isinstance(ex, ArgumentError):
            is_named = ex.argument_name is None or ex.message.startswith("Parser key")
            message = ex.message if is_named else f"{ex.argument_name}: {ex.message}"
        raise _RefusedError(message)


class _SaveConfig(SaveConfigCallback):
    """Callback that writes the settings into the run's folder, for `fit --config`."""

    def __init__(
        self,
        parser: LightningArgumentParser,
        config: Namespace,
        *,
        path: Path,
        initial_weights: Path | None,
    ) -> None:
        """Store the folder and the initial weights of the run."""
        super().__init__(parser, config, save_to_log_dir=False)
        self._path = path
        self._initial_weights = initial_weights

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Do nothing yet: the checkpoint to resume from may be refused after this."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the settings at the start of a training."""
        super().setup(trainer, pl_module, "fit")

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        super().setup(trainer, pl_module, "validate")

    def on_test_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        super().setup(trainer, pl_module, "test")

    def save_config(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        del trainer, pl_module, stage
        config = self.config.clone()
        # For repeating the run, not for resuming it.
        config["ckpt_path"] = None
        if self._initial_weights is not None:
            config["model"]["init_args"]["initial_weights"] = self._initial_weights
        atomic_write_text(self._path, self.parser.dump(config, skip_unset=False))


def _check_outside_data(subcommand: str | None, settings: Namespace, folder: Path) -> None:
    """Refuse a run's folder inside a data set of its sources, before anything is created.

    `test` alone reads the test sources: recipes name one at the root, where others may give none.
    """
    for use in ("training", "validation", *(["test"] if subcommand == "test" else [])):
        for source in settings[use] or ():
            given = source.get("init_args", source)
            check_outside_dataset(Path(settings["root"], given["path"]), [folder])


def _check_ranks(trainer: Trainer) -> None:
    """Refuse ranks started by torchrun that would not work together, each on all frames.

    Raises:
        ValueError: The trainer has another number of ranks.
    """
    numbers = {name: os.environ.get(name, "") for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE")}
    if not TorchElasticEnvironment.detect() or not all(map(str.isdecimal, numbers.values())):
        return
    started, of_machine = map(int, numbers.values())
    if started == trainer.world_size:
        return
    machines = f" --trainer.num_nodes {started // of_machine}" if started > of_machine else ""
    raise ValueError(
        f"torchrun started {started} ranks, but the trainer has {trainer.world_size}: add "
        f"--trainer.devices {of_machine} --trainer.strategy ddp{machines}, or start one process "
        "without torchrun"
    )


class _TrainingCLI(LightningCLI):
    """Lightning's command line with our run folder, checkpoints and logger."""

    def __init__(self, subcommand: Subcommand, arguments: Sequence[str], run: _Run) -> None:
        self._run = run
        self._requested = subcommand
        self._initial_weights: Path | None = None
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

    def subcommands(self) -> dict[str, set[str]]:  # type: ignore[override] # a static method there
        """The requested subcommand of the Trainer, with the arguments to leave out.

        Alone, as the parser of each takes 0.1 s of processor time.
        """
        is_fit = self._requested == "fit"
        loaders = {"train_dataloaders", "val_dataloaders"} if is_fit else {"dataloaders"}
        return {self._requested: {"model", "datamodule", "weights_only"} | loaders}

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        """Add the arguments of a run beside model, data and trainer."""
        defaults = {RUN_FOLDER: self._run.folder}
        for option in (RUN_FOLDER, CHECKPOINT_EVERY_N_STEPS, KEEP_LAST_WEIGHTS):
            default = defaults.get(option, option.default)
            parser.add_argument(option.flag, type=option.kind, default=default, help=option.help)
        parser.link_arguments("seed_everything", "data.init_args.seed", compute_fn=int)

    def parse_arguments(self, parser: LightningArgumentParser, args: Any) -> None:  # noqa: ANN401 - as base
        """Parse the arguments; Lightning's method warns if they do not come from sys.argv."""
        self.config = parser.parse_args(args)

    def _parse_ckpt_path(self) -> None:
        """Do nothing: our checkpoints hold no arguments."""

    def before_instantiate_classes(self) -> None:
        """Find the checkpoint; refuse misplaced nulls, and a run that would overwrite another.

        If the initial weights of the run are gone, its checkpoint replaces them: it contains
        everything that was loaded from them.
        """
        config = self.config[self.subcommand]
        for component in ("model", "data"):
            check_nulls(component, config[component])
        check_trainer_settings(config["trainer"])
        folder: Path = config["run_folder"]
        self._run.folder = folder
        _check_outside_data(self.subcommand, config["data"]["init_args"], folder)
        if config["trainer"]["logger"] in _TENSORBOARD:
            check_name(folder)
        self._initial_weights = config["model"]["init_args"].get("initial_weights")
        given: str | None = config["ckpt_path"]
        is_given = given is not None
        if self.subcommand == "fit":
            if (
                getattr(rank_zero_only, "rank", 0) == 0
            ):  # only one process of the run locks the folder
                self._run.claims.enter_context(claimed(folder))
            if given is None and (folder / "last.ckpt").exists():
                raise ValueError(
                    f"{folder} holds a run already; resume it by --ckpt_path last, or name "
                    "another folder with --run_folder"
                )
        elif given is None:
            given = self._checkpoint_to_score(folder)
        if given is None:
            return
        path = folder / f"{given}.ckpt" if given in ("best", "last") else Path(given)
        check_checkpoint_file(path, is_given=is_given)
        read_checkpoint_weights(path)  # raises one-line errors
        config["ckpt_path"] = str(path)
        self._warn_of_other_settings(path.parent / _CONFIG_NAMES["fit"], config)
        if self._initial_weights is not None and not has_weights(self._initial_weights):
            config["model"]["init_args"]["initial_weights"] = path

    def _warn_of_other_settings(self, path: Path, config: Namespace) -> None:
        """Warn of settings that the resumed run did not begin with."""
        if self.subcommand != "fit":
            return
        settings = self._parser(self.subcommand).dump(config, skip_unset=False)
        note = resumed_settings_note(path, settings)
        if note is not None:
            rank_zero_only(print)(f"sightline: warning: {note}", file=sys.stderr)

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:  # noqa: ANN401 - as base
        """Add the logger and the callbacks of a run to those of the recipe."""
        config = self.config[self.subcommand]
        folder: Path = config["run_folder"]
        self.save_config_kwargs = {
            "path": folder / _CONFIG_NAMES[str(self.subcommand)],
            "initial_weights": self._initial_weights,
        }
        settings = self.config_init[self.subcommand]["trainer"]
        if settings["logger"] in _TENSORBOARD:
            kwargs["logger"] = TensorBoardLogger(folder, name="", version="")
        if settings["default_root_dir"] is not None:
            raise ValueError(
                "--trainer.default_root_dir has no effect: all files of a run go to its folder; "
                "give --run_folder"
            )
        kwargs["default_root_dir"] = folder
        given = settings["callbacks"] or []
        given = list(given) if isinstance(given, list) else [given]
        kwargs["callbacks"] = given + self._run_callbacks(folder, config, settings, given)
        plugins = settings["plugins"] or []
        plugins = list(plugins) if isinstance(plugins, list) else [plugins]
        if not any(isinstance(each, CheckpointIO) for each in plugins):
            kwargs["plugins"] = [*plugins, AtomicCheckpointIO()]
        trainer = super().instantiate_trainer(**kwargs)
        _check_ranks(trainer)
        return trainer

    def before_fit(self) -> None:
        """Score weights from elsewhere before they are changed."""
        self.model.is_resumed = self.config[self.subcommand]["ckpt_path"] is not None
        is_scored = self._initial_weights is not None and not self.model.is_resumed
        if is_scored and self.datamodule.sources["validation"]:
            self.datamodule.check_training_sources(world=self.trainer.world_size)
            self.model.load_start()
            self.trainer.validate(self.model, datamodule=self.datamodule, verbose=False)

    def after_fit(self) -> None:
        """Print the path of the weights.

        Raises:
            ValueError: There was no step of training, and there are no weights.
        """
        folder = self._run.folder
        is_written = (folder / RUN_WEIGHTS).is_file()  # not by a trial run (fast_dev_run)
        if not self.trainer.global_step:
            raise ValueError(
                f"{folder}: the training ended without a step and has no weights; give "
                "--trainer.max_steps or --trainer.max_epochs of at least 1, and no limit of "
                "batches or time that leaves none"
            )
        if self.trainer.global_step == self.model.resumed_step and not is_written:
            checkpoint = self.config[self.subcommand]["ckpt_path"]
            raise ValueError(
                f"{folder}: no weights were written: the training ended without a step after the "
                f"{self.trainer.global_step} of {checkpoint}; resume in the folder of that run, or "
                f"start from its weights: --model.init_args.initial_weights {checkpoint} in place "
                "of --ckpt_path"
            )
        if self.trainer.is_global_zero:
            kept = f"the weights are in {RUN_WEIGHTS}" if is_written else "no weights were written"
            print(f"{folder}: {kept}{self._chosen_by(folder / RUN_WEIGHTS) if is_written else ''}")

    def _chosen_by(self, path: Path) -> str:
        """Describe the step of written weights, and the score that chose them."""
        provenance = read_description(path).provenance
        name, _ = self.model.monitored
        by = f", the best by {name}: {provenance[name]}" if name in provenance else ""
        return f" (step {int(provenance['steps']):,} of {self.trainer.global_step:,}{by})"

    def after_validate(self) -> None:
        """Write the metrics."""
        self._write_metrics()

    def after_test(self) -> None:
        """Write the metrics."""
        self._write_metrics()

    def _run_callbacks(
        self,
        folder: Path,
        config: Namespace,
        settings: Namespace,
        given: Sequence[Callback],
    ) -> list[Callback]:
        """The callbacks of every run."""
        callbacks: list[Callback] = []
        has_bar = any(isinstance(callback, ProgressBar) for callback in given)
        if settings["enable_progress_bar"] is not False and not has_bar:
            callbacks.append(RunProgress())
        if settings["log_every_n_steps"] is None:
            callbacks.append(LogShortRuns())
        callbacks += [LogSteps(), ReturnFreeMemory()]
        if settings["enable_checkpointing"] is False or settings["fast_dev_run"]:
            return callbacks
        return callbacks + checkpoint_callbacks(
            folder,
            every_n_steps=config["checkpoint_every_n_steps"],
            monitored=self.model.monitored if self.datamodule.sources["validation"] else None,
            keep_last_weights=config["keep_last_weights"],
        )

    def _checkpoint_to_score(self, folder: Path) -> str | None:
        """Choose the checkpoint of a run to score; None: there are only initial weights."""
        keep_last = self.config[self.subcommand]["keep_last_weights"]
        order = ("last", "best") if keep_last else ("best", "last")
        names = [name for name in order if (folder / f"{name}.ckpt").is_file()]
        if names or self._initial_weights is None:
            return (names or ["last"])[0]
        return None

    def _write_metrics(self) -> None:
        if not self.trainer.is_global_zero:
            return
        config = self.config[self.subcommand]
        checkpoint, initial = config["ckpt_path"], self._initial_weights
        if checkpoint is None:
            summary = f"scored {initial}; there is no checkpoint"
        elif initial is None:
            summary = f"scored {checkpoint}"
        else:
            summary = f"scored {checkpoint}, which started from {initial}"
        print(f"{self._run.folder}: {summary}")
        for note in self.model.notes:
            print(note)
        difference = self.model.difference_in_use()
        if difference is not None:
            print(f"{difference}; for figures of use: sightline predict, then sightline evaluate")
        scores = {
            name: float(value)
            for name, value in self.trainer.callback_metrics.items()
            if name != STEP
        }
        report = {
            "checkpoint": checkpoint,
            "initial_weights": None if initial is None else str(initial),
            "metrics": {
                name: score if math.isfinite(score) else None for name, score in scores.items()
            },
            "notes": [*self.model.notes, *filter(None, [self.datamodule.unscored])],
        }
        path = config["run_folder"] / f"{self.subcommand}.json"
        atomic_write_text(path, json.dumps(report, indent=2) + "\n")
