"""Robustness bench: a method's predictions in every case of a suite, scored and measured.

All arguments are checked first. Then predictions are made and stored frame by frame, scored case by
case, and measured and reported together; each step skips the results of an earlier run.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from sightline.corruptions.suites import CLEAN, Case, Suite, find_suite
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import dataset_title, sweeps_folder
from sightline.data.layouts.frame_lists import lasting_list
from sightline.data.layouts.kitti_trees import Velodyne, suggest_frames
from sightline.export.names import EngineChoice
from sightline.files.plain_text import shortened
from sightline.files.problem import plain_line
from sightline.geometry.arguments import plain_tuple
from sightline.geometry.choices import check_choices
from sightline.geometry.wrong_types import named_arguments, named_fields
from sightline.inference.predictor import Predictor, check_predictor
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import acquire_output_dir, check_outside_dataset
from sightline.robustness.comparable import check_baseline, check_healthy
from sightline.robustness.examples import ExampleDrawer
from sightline.robustness.frames import digest_files, open_frames
from sightline.robustness.predictions import MethodRun, check_numbers, predict_in_cases
from sightline.robustness.record import (
    RECORD_NAME,
    CaseInfo,
    Record,
    Setting,
    describe_case,
    digest_names,
    read_record,
)
from sightline.robustness.report import RobustnessReport
from sightline.robustness.result_doubts import tell_doubts
from sightline.robustness.score_job import score_cases
from sightline.robustness.scoring import Scoring
from sightline.structures.sample import Sensor

_PREDICTIONS: Final = "answers"  # folder
_SUITE: Final = "dgfn7"
_BASELINE: Final = "baseline"


@runtime_checkable  # for beartype, which checks arguments under pytest
class BenchTask(Protocol):
    """Part of a task used by the bench; see `sightline.tasks.Task`."""

    @property
    def name(self) -> str:
        """Name of the task in records."""
        ...

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods without a network."""
        ...

    def scoring(self) -> Scoring:
        """Scoring of the predictions."""
        ...

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> Predictor:
        """Load a predictor."""
        ...


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class BenchSettings:
    """Settings of a run, and records for comparison."""

    suite: str | Suite | None = None
    """Suite, by name or as an object. None: dgfn7, or for results that of the data."""
    seed: int | None = None
    """Seed. None: 0, or for results that of the data."""
    cases: tuple[str, ...] | None = None
    """Cases of the suite; the clean one is always included. None: all."""
    sample_list: str | Path | Sequence[str] | None = None
    velodyne: Velodyne | None = None
    """The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced."""
    baseline: str | None = None
    """Baseline for CE: another run, its folder or its record (.json), or weights or a method, which
    run as well."""
    healthy: Mapping[Sensor, Path] | None = None
    """Records of single-sensor methods, by their sensor."""
    shown: str | None = None
    """Frame of the example pictures. None: the first."""
    picture_px: int = 800
    """Width of these pictures."""
    workers: int = 2
    driver: Driver = "local"
    """Kind of workers."""

    def __post_init__(self) -> None:
        """Check the choices, and keep the names of iterators."""
        check_choices(self)
        if self.cases is not None:
            object.__setattr__(self, "cases", plain_tuple("cases", self.cases))
        object.__setattr__(self, "sample_list", lasting_list(self.sample_list))

    def chosen_cases(self, suite: Suite) -> tuple[Case, ...]:
        """List the requested cases.

        Raises:
            ValueError: The suite has no such case.
        """
        return suite.cases if self.cases is None else suite.select([CLEAN, *self.cases])

    def drawer(self, out: Path, dataset: SampleDataset, scoring: Scoring) -> ExampleDrawer:
        """Make the drawer of a run's example pictures.

        Raises:
            ValueError: The data set has no such frame, or the width is invalid.
        """
        names, shown = dataset.sample_ids, self.shown
        if shown is not None and shown not in names:
            raise ValueError(
                f"frame {shortened(shown)} to draw is none of the run's: "
                f"{suggest_frames(shown, names)}; give one of them"
            )
        return ExampleDrawer(
            out=out, frame=shown or names[0], scoring=scoring, width_px=self.picture_px
        )


@named_arguments
def run_bench(
    task: BenchTask,
    data: Path,
    out: Path,
    settings: BenchSettings,
    *,
    method: str | None = None,
    weights: str | Path | None = None,
    engine: EngineChoice = "auto",
    device: str = "cpu",
    scoring: Scoring | None = None,
) -> RobustnessReport:
    """Run a method in every case, and measure the loss in each.

    A stopped run can be resumed, to the same bytes of robustness.json.

    Args:
        task: Task of the method.
        data: Folder of the data set; see `open_dataset`.
        out: Output folder of the run; its sightline.json records the settings.
        settings: Cases and comparisons.
        method: A method without a network.
        weights: Weights of a network. Neither: the task's default.
        engine: Inference engine: by default openvino on the CPU, if it is installed.
        device: Device of the networks.
        scoring: Scoring of the predictions. None: the task's own.

    Raises:
        ValueError: There is no such suite, case, method or frame; the data lack a part needed by a
            case or the scoring; a record for comparison does not match; or `out` holds another run.
            All of these are raised before any work. Errors about a frame contain its name.
    """
    suite, seed = settings.suite or _SUITE, settings.seed or 0
    if isinstance(suite, str):
        suite = find_suite(suite)
    cases = _with_earlier(settings.chosen_cases(suite), suite, out)
    check_numbers(seed, settings.workers, settings.driver)
    check_outside_dataset(data, [out])
    baseline = read_baseline(settings.baseline)
    healthy = read_healthy(settings.healthy)
    scoring = scoring or task.scoring()
    methods = [(method, weights)]
    if baseline is None and settings.baseline is not None:
        is_method = settings.baseline in task.methods
        methods.append((settings.baseline, None) if is_method else (None, settings.baseline))
    predictors = [  # with several threads PyTorch's last digits differ
        task.predictor(method=name, weights=file, engine=engine, device=device, threads=1)
        for name, file in methods
    ]
    for each in predictors:
        check_predictor(each)
    dataset = open_frames(
        data,
        {*scoring.parts, *(part for each in predictors for part in each.parts)},
        cases,
        sample_list=settings.sample_list,
        velodyne=settings.velodyne,
    )
    scoring.check(dataset)
    setting = describe_setting(
        task,
        scoring,
        dataset,
        data=dataset_title(dataset, data),
        velodyne=sweeps_folder(dataset),
        suite=suite,
        seed=seed,
    )
    infos = {case.name: describe_case(case) for case in cases}
    check_compared(baseline, healthy, setting, infos)
    drawer = settings.drawer(out, dataset, scoring)
    folders = [out, out / _BASELINE][: len(predictors)]
    for folder, predictor in zip(folders, predictors, strict=True):
        claim = run_settings(setting, suite, predictor.name, predictor.made_by) | drawer.settings
        acquire_output_dir(folder, claim, results=(f"{_PREDICTIONS}/*",))
    runs = [
        MethodRun(predictor=predictor, cases=cases, folder=folder / _PREDICTIONS, also=also)
        for folder, predictor, also in zip(folders, predictors, (drawer, None), strict=False)
    ]
    description = f"{task.name} in {suite.name}"
    predict_in_cases(
        dataset,
        runs,
        scoring,
        seed=seed,
        workers=settings.workers,
        driver=settings.driver,
        description=description,
    )
    records = []
    for folder, predictor in zip(folders, predictors, strict=True):
        scored = score_cases(
            scoring,
            dataset,
            folder / _PREDICTIONS,
            tuple(infos),
            folder,
            settings.workers,
            driver=settings.driver,
        )
        records.append(
            Record(
                method=plain_line(predictor.name),
                made_by={name: plain_line(value) for name, value in predictor.made_by.items()},
                setting=setting,
                cases=infos,
                scores=scored.scores,
                notes=(*tell_doubts(scored.doubts), *scoring.notes(dataset)),
            )
        )
    own, *other = records
    report = RobustnessReport(
        record=own, baseline=baseline or next(iter(other), None), healthy=healthy
    )
    report.write(out)
    return report


def _with_earlier(cases: Sequence[Case], suite: Suite, out: Path) -> tuple[Case, ...]:
    """Add the cases of the folder's report: a run is extended, and keeps all its cases."""
    names = {case.name for case in cases}
    with suppress(ValueError):  # a damaged report is made again
        names |= set(read_record(out / RECORD_NAME).cases)
    return tuple(case for case in suite.cases if case.name in names)


@named_arguments
def read_baseline(baseline: str | None) -> Record | None:
    """Read the baseline's record; None for weights, a method or no baseline."""
    if baseline is None:
        return None
    is_record = baseline.endswith(".json") or (Path(baseline) / RECORD_NAME).is_file()
    return read_record(Path(baseline)) if is_record else None


@named_arguments
def read_healthy(healthy: Mapping[Sensor, Path] | None) -> dict[Sensor, Record]:
    """Read the records of single-sensor methods, by sensor."""
    return {sensor: read_record(path) for sensor, path in (healthy or {}).items()}


@named_arguments
def check_compared(
    baseline: Record | None,
    healthy: Mapping[Sensor, Record],
    setting: Setting,
    cases: Mapping[str, CaseInfo],
) -> None:
    """Check that records can be compared; see `check_baseline` and `check_healthy`."""
    if baseline is not None:
        check_baseline(baseline, setting, cases)
    for sensor, record in healthy.items():
        check_healthy(sensor, record, setting)


@named_arguments
def describe_setting(
    task: BenchTask,
    scoring: Scoring,
    dataset: SampleDataset,
    *,
    data: str,
    velodyne: Velodyne,
    suite: Suite,
    seed: int,
) -> Setting:
    """Describe the setting of a run's scores.

    Args:
        task: Task of the methods.
        scoring: Scoring of their predictions.
        dataset: The frames.
        data: Name of the data in records; see `dataset_title`.
        velodyne: The sweeps' folder.
        suite: Suite of the cases.
        seed: Seed of the cases' random draws.
    """
    return Setting(
        task=task.name,
        scoring=scoring.name,
        data=data,
        velodyne=velodyne,
        frames=len(dataset),
        frames_sha256=digest_names(dataset.sample_ids),
        files_digest=digest_files(dataset),
        metrics=scoring.metrics,
        suite=suite.name,
        seed=seed,
    )


@named_arguments
def run_settings(
    setting: Setting, suite: Suite, method: str, made_by: Mapping[str, str]
) -> dict[str, Any]:
    """Collect all settings that a run's files depend on, except the suite's requested cases."""
    plain = setting.to_json()
    del plain["figures"]
    cases = {case.name: asdict(describe_case(case)) for case in suite.cases}
    return {"sightline": version("sightline"), "method": method, **made_by, **plain, "cases": cases}
