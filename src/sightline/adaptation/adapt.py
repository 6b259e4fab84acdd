"""Simulation of a recording's rig, and fine-tuning of the shipped networks on its frames."""

import hashlib
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from sightline.data.layouts.kitti_trees import Part
from sightline.data.open import open_dataset
from sightline.depth_completion.robustness import HeldOutScoring, SimulatedDepthScoring
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.evaluation.held_out_frame import check_for_sweeps
from sightline.export.process_engine import check_device
from sightline.files.atomic import atomic_write_text
from sightline.files.extras import require_library
from sightline.files.problem import FileError
from sightline.files.weights_header import find_weights
from sightline.geometry.arguments import plain_tuple
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments, named_fields
from sightline.jobs.output_dirs import acquire_output_dir, check_outside_dataset, data_name
from sightline.joining.fit_pair import fit_pair
from sightline.joining.models import JOINED, read_models
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.record import RECORD_NAME, Record, read_record
from sightline.robustness.scoring import Scoring
from sightline.simulation.generate import check_simulation, simulate
from sightline.simulation.measured_rig import measure_rig, rig_text
from sightline.simulation.rigs import Rig, read_rig
from sightline.simulation.settings import SimulationConfig
from sightline.tasks import PACKAGE_RECIPES, find_task
from sightline.training.command import run_training
from sightline.training.interruption import Interruption

if TYPE_CHECKING:
    from rich.table import Table

RIG_NAME: Final = "rig.yaml"
"""File with the rig."""
REPORT_NAME: Final = "adapt.json"
"""File with the scores before and after."""
JOINED_NAME: Final = f"{JOINED}.json"
"""File with the models of joined scores for the fine-tuned detectors."""
_DETECTORS: Final = ("detection2d", "detection3d")
_JOINED_FRAMES: Final = 40  # of those for validation, as for the shipped models
_SUITE: Final = "dgfn7"  # of which only the clean case is run
_SHOWN: Final = 4  # metrics of each task in the table
_LEAST: Final = {"frames": 4, "validation_frames": 1, "steps": 1, "workers": 1}  # 4: a batch
_FINISHED: Final = "finished"
_LAST_CHECKPOINT: Final = "last.ckpt"
_WEIGHTS: Final = "weights.safetensors"


@dataclass(frozen=True, kw_only=True, slots=True)
class FineTuning:
    """Recipe and settings by which a task's shipped network is fine-tuned."""

    recipe: str
    learning_rate: float
    """A quarter of the recipe's or less."""
    settings: Mapping[str, str]
    """Further settings of the recipe, as of the command line."""
    without_rings: Mapping[str, str] = field(default_factory=dict)
    """Settings in addition for a LiDAR without rings, which cannot lose some of them."""


# Beams of 64 are all of a sweep's: the rig has its own rings, and none is left out.
FINE_TUNINGS: Final[Mapping[str, FineTuning]] = {
    "detection2d": FineTuning(
        recipe="detection2d-best",
        learning_rate=3e-4,
        settings={},
        without_rings={"data.init_args.preparation.init_args.faults": "[]"},
    ),
    "detection3d": FineTuning(
        recipe="detection3d-best",
        learning_rate=5e-4,
        settings={"data.init_args.preparation.init_args.settings.changes.beams": "[64]"},
    ),
    "depth-completion": FineTuning(
        recipe="depth-best-further",
        learning_rate=2e-4,
        settings={"data.init_args.preparation.init_args.settings.beams": "[64]"},
    ),
}
"""Fine-tuning of each task that can be adapted."""


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class AdaptSettings:
    """Size of an adaptation."""

    tasks: tuple[str, ...] = tuple(FINE_TUNINGS)
    frames: int = 600
    """Simulated frames for training."""
    validation_frames: int = 100
    """Further simulated frames, by which the networks are scored."""
    steps: int = 600
    """Steps of each fine-tuning, of four frames each."""
    seed: int = 39000
    """Seed of the streets."""
    workers: int = 2
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Check the numbers and the tasks."""
        for name, least in _LEAST.items():
            if getattr(self, name) < least:
                raise ValueError(f"{name} must be at least {least}, got {getattr(self, name)}")
        object.__setattr__(self, "tasks", plain_tuple("tasks", self.tasks))
        unknown = [name for name in self.tasks if name not in FINE_TUNINGS]
        if unknown or not self.tasks:
            raise ValueError(
                f"tasks must be some of {', '.join(FINE_TUNINGS)}, got "
                f"{unknown[0] if unknown else 'none'}"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class AdaptReport:
    """Scores of each task's network before and after, on simulated frames of the rig."""

    rig: Rig
    before: Mapping[str, Record]
    after: Mapping[str, Record]
    weights: Mapping[str, Path]
    """Fine-tuned weights by task."""
    joined: Path | None = None
    """Models of joined scores for the fine-tuned detectors."""

    def table(self) -> "Table":
        """Format the first metrics of each task."""
        from rich.table import Table

        table = Table(
            "task",
            "metric",
            "before",
            "after",
            title=f"simulated frames of {self.rig.name}",
            caption="\n".join(self._notes_on_rings()) or None,
        )
        for task, record in self.before.items():
            for metric in record.setting.metrics[:_SHOWN]:
                scores = (each[task].score("clean", metric) for each in (self.before, self.after))
                table.add_row(task, f"{metric.title} [{metric.unit}]", *map(_format, scores))
        return table

    def to_json(self) -> dict[str, object]:
        """Convert to the content of adapt.json: all metrics of each task."""
        return {
            "rig": self.rig.name,
            "tasks": {
                task: {
                    "weights": str(self.weights[task]),
                    "is_better": self.is_better(task),
                    "before": dict(self.before[task].scores["clean"]),
                    "after": dict(self.after[task].scores["clean"]),
                }
                for task in self.before
            },
            "joined": None if self.joined is None else str(self.joined),
            "notes": [*filter(None, [self.rig.source]), *self._notes_on_rings()],
        }

    def _notes_on_rings(self) -> list[str]:
        """List the differences from the adaptation to a LiDAR with rings."""
        notes = []
        for task, record in self.before.items():
            if not _has_rings(self.rig) and FINE_TUNINGS[task].without_rings:
                notes.append(f"{task} is trained without lost rings: the LiDAR has none")
            if record.setting.scoring == SimulatedDepthScoring.name:
                notes.append(f"{task} is scored on simulated depth, not on held-out rings")
        return notes

    def is_better(self, task: str) -> bool:
        """Whether a task's most important metric with a score has improved."""
        for metric in self.before[task].setting.metrics:
            before = self.before[task].score("clean", metric)
            after = self.after[task].score("clean", metric)
            if before is not None and after is not None:
                return metric.lead(after, before) > 0
        return False


def _has_rings(rig: Rig) -> bool:
    """Test whether a rig's LiDAR has rings."""
    return rig.lidar.rosette is None


def _format(score: float | None) -> str:
    return "-" if score is None else f"{score:.1f}"


@named_arguments
def adapt(
    data: Path, out: Path, settings: AdaptSettings, *, rig_file: Path | None = None
) -> AdaptReport:
    """Adapt the shipped networks of some tasks to a recording's rig.

    OUT gets the rig (rig.yaml), simulated frames of it, a run folder for each task with its
    weights.safetensors, scores before and after, models that join the boxes of both detectors
    (joined.json), and adapt.json. Steps that are finished are skipped, so a stopped adaptation goes
    on where it was; tasks of an earlier run stay in the report.

    Args:
        data: Data set with sweeps, by whose first frames the rig is measured.
        out: Output folder.
        settings: Tasks and sizes.
        rig_file: Rig in YAML, in place of the measured one.

    Raises:
        ValueError: An extra is not installed, the device cannot be used, the rig cannot be measured
            or simulated, or `out` holds another adaptation.
        Interruption: Ctrl-C or SIGTERM; the same command goes on.
    """
    check_outside_dataset(data, [out])
    require_library("lightning", "train")  # before the simulation, which takes long
    check_device(settings.device)
    rig, notes = _rig(data, out, rig_file)
    for note in notes:  # before the work, which a wrong rig makes worthless
        warn_user(note)
    frames = settings.frames + settings.validation_frames
    config = SimulationConfig(seed=settings.seed, rig=rig)
    check_simulation(config, frames, validation_frames=settings.validation_frames)
    claim = {
        "adapt": data_name(data),
        "rig": rig_text(rig),
        "frames": settings.frames,
        "validation_frames": settings.validation_frames,
        "steps": settings.steps,
        "seed": settings.seed,
    }
    acquire_output_dir(out, claim, results=("frames", *FINE_TUNINGS))
    atomic_write_text(out / RIG_NAME, rig_text(rig))
    rig = read_rig(out / RIG_NAME)  # a later run reads it, too, by the same name
    simulated = out / "frames"
    simulate(
        simulated,
        frames=frames,
        validation_frames=settings.validation_frames,
        config=replace(config, rig=rig),
        workers=settings.workers,
    )
    before, after, weights = {}, {}, {}
    for name in FINE_TUNINGS:
        if name not in settings.tasks and not _is_finished(name, out):
            continue
        default = find_task(name).default_weights
        assert default is not None, "each of FINE_TUNINGS has one"
        shipped = find_weights(default)
        before[name] = _score(name, shipped, simulated, out / "before" / name, settings, rig)
        weights[name] = _fine_tune(name, simulated, out / name, settings, rig)
        after[name] = _score(name, weights[name], simulated, out / "after" / name, settings, rig)
    joined = _fit_joined(weights, simulated, out / JOINED_NAME)
    report = AdaptReport(rig=rig, before=before, after=after, weights=weights, joined=joined)
    atomic_write_text(out / REPORT_NAME, json.dumps(report.to_json(), indent=2) + "\n")
    return report


def _fit_joined(weights: Mapping[str, Path], frames: Path, out: Path) -> Path | None:
    """Fit the joined scores to the fine-tuned detectors, each with the shipped other one if alone.

    None: no detector was fine-tuned, or their boxes are too few for a fit.
    """
    if not set(_DETECTORS) & weights.keys():
        return None
    of_image, of_sweep = (
        str(weights.get(name, find_task(name).default_weights)) for name in _DETECTORS
    )
    in_image, in_sweep = DetectionPredictor.load(of_image), Detection3DPredictor.load(of_sweep)
    data = data_name(frames)
    with suppress(FileError):  # damaged or absent models are fitted
        kept = read_models(out)
        if kept.fits(in_image.sha256, in_sweep.sha256) and kept.provenance.get("data") == data:
            return out
    dataset = open_dataset(frames, sample_list="val", parts=("image", "points", "objects"))
    try:
        models = fit_pair(dataset, in_image, in_sweep, data=data, frames=_JOINED_FRAMES)
    except ValueError as error:
        warn_user(f"objects of these detectors cannot be joined: {error}")
        return None
    models.write(out)
    return out


def _is_finished(name: str, out: Path) -> bool:
    """Test whether an output folder has the fine-tuned weights of a task, and their scores."""
    is_scored = all((out / when / name / RECORD_NAME).exists() for when in ("before", "after"))
    return is_scored and (out / name / _FINISHED).exists()


def _rig(data: Path, out: Path, rig_file: Path | None) -> tuple[Rig, tuple[str, ...]]:
    """Take the given rig, that of an earlier run, or measure it."""
    if rig_file is not None:
        return read_rig(rig_file), ()
    if (out / RIG_NAME).exists():
        kept = read_rig(out / RIG_NAME)
        source = f" ({kept.source})" if kept.source else ""
        return kept, (f"the rig is that of {out / RIG_NAME}{source}",)
    parts: set[Part] = {"points"}
    dataset = open_dataset(data, parts=parts, needs=())  # some sweeps are enough
    check_for_sweeps(dataset)
    measured = measure_rig(dataset, RIG_NAME.removesuffix(".yaml"))
    return measured.rig, measured.notes


def _score(
    name: str, weights: Path, frames: Path, out: Path, settings: AdaptSettings, rig: Rig
) -> Record:
    """Score a network on the simulated validation frames.

    Raises:
        FileError: There are scores of other weights.
    """
    if not (out / RECORD_NAME).exists():
        run_bench(
            find_task(name),
            frames,
            out,
            BenchSettings(suite=_SUITE, cases=(), sample_list="val", workers=settings.workers),
            weights=weights,
            engine="torch",
            device=settings.device,
            scoring=_depth_scoring(frames, rig) if name == "depth-completion" else None,
        )
    record = read_record(out / RECORD_NAME)
    if record.made_by.get("weights_sha256") != _checksum(weights):
        reason = f"holds the scores of other weights than {weights}"
        raise FileError(out / RECORD_NAME, reason, f"remove {out}, and run it again")
    return record


def _depth_scoring(frames: Path, rig: Rig) -> Scoring:
    """Scoring by held-out rings if all validation frames show some, else by simulated depth."""
    scoring, without_rings = HeldOutScoring(), SimulatedDepthScoring()
    if not _has_rings(rig):  # any that are found are none
        return without_rings
    dataset = open_dataset(frames, sample_list="val", parts=scoring.parts)
    for index in range(len(dataset)):
        sample = dataset[index]
        try:
            scoring.prepare(sample)
        except ValueError:
            return without_rings
    return scoring


def _fine_tune(name: str, frames: Path, folder: Path, settings: AdaptSettings, rig: Rig) -> Path:
    """Train a task's shipped network on; returns the weights of the last step."""
    weights = folder / _WEIGHTS
    finished = folder / _FINISHED
    if finished.exists():
        _check_weights(weights, finished)
        return weights
    arguments = _arguments(name, frames, folder, settings, rig)
    if (folder / _LAST_CHECKPOINT).exists():
        arguments.append("--ckpt_path=last")
    try:
        run_training("fit", arguments, PACKAGE_RECIPES)
    except ValueError as error:
        last = folder / _LAST_CHECKPOINT
        if not str(error).startswith(f"{last} "):
            raise
        cause = str(error).removeprefix(f"{last} ").partition(";")[0]
        raise FileError(last, cause, f"remove {folder}, and run it again") from error
    except ChildProcessError as error:
        from sightline.training.loader import NO_WORKERS_REMEDY

        text = str(error).replace(NO_WORKERS_REMEDY, "give --workers 1")
        raise ChildProcessError(text) from error
    except Interruption as interruption:
        raise Interruption(
            f"interrupted while {name} was fine-tuned; run the same command again to go on",
            interruption.number,
        ) from None
    atomic_write_text(finished, _checksum(weights) + "\n")
    return weights


def _check_weights(weights: Path, finished: Path) -> None:
    """Check that weights are those of the training that has finished, which are scored.

    Raises:
        FileError: They are absent or others.
    """
    expected = finished.read_text(encoding="utf-8").strip()
    remedy = f"remove {finished.parent} and {finished.parent.parent / 'after'}, and run it again"
    if not weights.is_file():
        raise FileError(weights, "is absent, though its training has finished", remedy)
    if expected and _checksum(weights) != expected:  # an older version wrote none
        raise FileError(weights, "is not as its training wrote it", remedy)


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _arguments(
    name: str, frames: Path, folder: Path, settings: AdaptSettings, rig: Rig
) -> list[str]:
    tuning = FINE_TUNINGS[name]
    chosen = {
        "run_folder": str(folder),
        "keep_last_weights": "true",
        "data.init_args.root": str(frames),
        "data.init_args.training": "[{path: ., sample_list: train}]",
        "data.init_args.workers": str(min(settings.workers - 1, 1)),
        "model.init_args.initial_weights": find_task(name).default_weights,
        "model.init_args.optimizer.learning_rate": str(tuning.learning_rate),
        "trainer.max_steps": str(settings.steps),
        "trainer.max_epochs": "-1",
        "trainer.limit_val_batches": "0",
        "trainer.accelerator": "cpu" if settings.device == "cpu" else "auto",
        **tuning.settings,
        **({} if _has_rings(rig) else tuning.without_rings),
    }
    flags = [f"--{key}={value}" for key, value in chosen.items()]
    return ["--config", tuning.recipe, *flags]
