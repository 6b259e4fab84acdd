"""Scores of any other method's results in the cases from `sightline corrupt`."""

import difflib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, get_args

from sightline.corruptions.generate import read_corrupted
from sightline.corruptions.suites import CLEAN, Case, Suite, find_suite
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.frame_lists import list_unequal_files, require_frame_files
from sightline.data.layouts.kitti_trees import Velodyne, describe_absent, part_folder
from sightline.data.open import open_dataset
from sightline.files.plain_text import read_text, shortened
from sightline.files.problem import plain_line
from sightline.files.shard_path import data_path
from sightline.geometry.user_warning import warn_user
from sightline.jobs.output_dirs import MANIFEST_NAME, acquire_output_dir, data_name
from sightline.jobs.run import check_workers
from sightline.robustness.bench import (
    BenchSettings,
    BenchTask,
    check_compared,
    describe_setting,
    read_baseline,
    read_healthy,
    run_settings,
)
from sightline.robustness.examples import ExampleDrawer
from sightline.robustness.record import Record, checked_count, checked_text, describe_case
from sightline.robustness.report import RobustnessReport
from sightline.robustness.result_doubts import file_doubts, tell_doubts
from sightline.robustness.score_job import score_cases
from sightline.robustness.scoring import BenchFrame, BenchPrediction, Scoring

_MIN_SIMILARITY: Final = 0.75  # minimum similarity of a folder's name to the intended case
_MAX_LISTED: Final = 4  # maximum number of folders in an error message
_REMEDY: Final = (
    "give the folder that `sightline corrupt` wrote, which holds a folder for each case"
)


def score_results(
    task: BenchTask, cases: Path, results: Path, out: Path, settings: BenchSettings
) -> RobustnessReport:
    """Score folders of result files, one for each case, and measure the loss in each case.

    Args:
        task: Task with the scoring.
        cases: Output of `sightline corrupt`: a data set for each case, and its settings, which
            include suite and seed.
        results: Folder with a folder for each case, with a result file for each frame. If no cases
            are given, the existing ones are scored, and the report lists the missing ones.
        out: Output folder of the run.
        settings: The sweeps' folder, the suite and the seed are those of `cases`.

    Raises:
        ValueError: The task is not scored by such files; `cases` is something else, or has cases of
            another version; results lack the clean case, a given case or a frame; or as for
            `run_bench`.
    """
    check_workers(settings.workers, settings.driver)
    if out.resolve().is_relative_to(results.resolve()):
        raise ValueError(
            f"{out} is inside the results, {results}, whose folders are cases; name an output "
            "folder elsewhere"
        )
    scoring = task.scoring()
    if not scoring.takes_results:
        raise ValueError(
            f"{task.name} is scored on {scoring.name}, and its input data sets contain the truth: "
            "results of other methods cannot be scored; add the method to Sightline, and leave "
            "--results out"
        )
    made_with = _made_with(cases)
    suite = find_suite(str(made_with["suite"]))
    given = {"suite": settings.suite, "seed": settings.seed, "velodyne": settings.velodyne}
    for name, value in given.items():
        if value not in (None, made_with[name]):
            raise ValueError(
                f"{cases} was written with {name} {made_with[name]}, not {value}; leave --{name} "
                "out, or name other data"
            )
    results = data_path(results)
    requested = settings.chosen_cases(suite)
    unknown = _no_cases(results, suite)
    chosen = _present_cases(results, requested, unknown) if settings.cases is None else requested
    _check_cases(suite, made_with["cases"], cases)
    baseline, healthy = read_baseline(settings.baseline), read_healthy(settings.healthy)
    if baseline is None and settings.baseline is not None:
        raise ValueError(
            f"the baseline of results must be a run's folder or its robustness.json, got "
            f"{shortened(settings.baseline)}; run it first"
        )
    tree = _first_tree(cases, chosen)
    dataset = open_dataset(
        tree,
        sample_list=settings.sample_list,
        velodyne=made_with["velodyne"],
        parts=scoring.parts,
    )
    scoring.check(dataset)
    _check_complete(results, chosen, dataset, scoring)
    _warn_of_other_labels(cases, chosen, tree, dataset.sample_ids)
    drawer = settings.drawer(out, dataset, scoring)
    setting = describe_setting(
        task,
        scoring,
        dataset,
        data=made_with["data"],
        velodyne=made_with["velodyne"],
        suite=suite,
        seed=made_with["seed"],
    )
    if tree.name != CLEAN:  # its files differ from the data's
        setting = replace(setting, files_digest=None)
    infos = {case.name: describe_case(case) for case in chosen}
    check_compared(baseline, healthy, setting, infos)
    made_by = {"results": data_name(results)}
    name = plain_line(results.resolve().name)
    claim = run_settings(setting, suite, name, made_by) | drawer.settings
    acquire_output_dir(out, claim, results=("scores/*",))
    scored = score_cases(
        scoring,
        dataset,
        results,
        tuple(infos),
        out,
        settings.workers,
        driver=settings.driver,
        anew=True,
    )
    doubts = dict(scored.doubts)
    if settings.sample_list is None:  # a list leaves out files on purpose
        for case in infos:
            folder = data_path(results / case)
            doubts[case] += file_doubts(folder, dataset.sample_ids, scoring.suffix)
    record = Record(
        method=name,
        made_by=made_by,
        setting=setting,
        cases=infos,
        scores=scored.scores,
        notes=(*tell_doubts(doubts), *scoring.notes(dataset)),
    )
    _draw(drawer, cases, results, chosen, made_with["velodyne"])
    absent = tuple(case.name for case in requested if case not in chosen)
    report = RobustnessReport(
        record=record,
        baseline=baseline,
        healthy=healthy,
        absent_cases=absent,
        unmade_cases=frozenset(name for name in absent if not (cases / name).is_dir()),
        no_cases=unknown,
    )
    report.write(out)
    return report


def _draw(
    drawer: ExampleDrawer, cases: Path, results: Path, chosen: Sequence[Case], velodyne: Velodyne
) -> None:
    """Draw pictures of one frame, for the cases with existing frames."""
    for case in chosen:
        corrupted = read_corrupted(cases / case.name, drawer.frame, case.corruption, velodyne)
        if corrupted is not None:
            path = data_path(results / case.name) / f"{drawer.frame}{drawer.scoring.suffix}"
            output = drawer.scoring.read(path, corrupted.sample)
            drawer(case, BenchPrediction(BenchFrame(corrupted.sample, None), corrupted, output))


def _made_with(cases: Path) -> dict[str, Any]:
    """Read the manifest of the cases; its texts are made safe for display."""
    path = cases / MANIFEST_NAME
    content: Any = None
    if path.is_file():
        try:
            content = json.loads(read_text(path))
        except (ValueError, RecursionError):
            content = None
    match content:
        case {"suite": suite, "seed": seed, "velodyne": sweeps, "data": data, "cases": dict()}:
            with suppress(TypeError):
                made_with = {
                    "suite": checked_text(suite),
                    "seed": checked_count(seed),
                    "data": checked_text(data),
                }
                if sweeps in get_args(Velodyne):
                    return {**content, **made_with}
    raise ValueError(f"{cases} is no output of `sightline corrupt`; {_REMEDY}")


def _check_cases(suite: Suite, written: Mapping[str, object], cases: Path) -> None:
    for case in suite.cases:
        if written.get(case.name) != describe_case(case).parameters:
            raise ValueError(
                f"{cases} was written with another case {case.name} than this version's; write the "
                "cases again"
            )


def _no_cases(results: Path, suite: Suite) -> tuple[str, ...]:
    """List folders of results that match no case, each with the most similar case."""
    known = [case.name for case in suite.cases]
    unknown = []
    for path in sorted(results.iterdir()) if results.is_dir() else ():
        if path.is_dir() and path.name not in known and not path.name.startswith("."):
            close = difflib.get_close_matches(path.name, known, n=1, cutoff=_MIN_SIMILARITY)
            hint = f" (perhaps {close[0]} is meant)" if close else ""
            unknown.append(f"{shortened(path.name)}{hint}")
    return tuple(unknown)


def _present_cases(
    results: Path, requested: Sequence[Case], unknown: Sequence[str]
) -> tuple[Case, ...]:
    """Select the cases with a folder of results; the clean one must be among them."""
    present = tuple(case for case in requested if (results / case.name).is_dir())
    if CLEAN not in {case.name for case in present}:
        raise ValueError(
            f"{results} has no folder {CLEAN} for the results of sound sensors, the reference of "
            f"all cases; add it{_hint(unknown)}"
        )
    if len(present) == 1:
        names = ", ".join(case.name for case in requested[1:7])
        raise ValueError(
            f"{results} has a folder {CLEAN} and none of a broken case; name folders as the cases "
            f"are named ({names}{', ..' if len(requested) > 7 else ''}){_hint(unknown)}"
        )
    return present


def _hint(unknown: Sequence[str]) -> str:
    return f"; there is {', '.join(unknown[:_MAX_LISTED])}" if unknown else ""


def _first_tree(cases: Path, chosen: Sequence[Case]) -> Path:
    """Find a case's tree with the labels, which are equal in all cases."""
    for case in chosen:
        if (cases / case.name).is_dir():
            return cases / case.name
    raise ValueError(
        f"{cases} holds none of the cases {', '.join(c.name for c in chosen)}; {_REMEDY}"
    )


def _warn_of_other_labels(
    cases: Path, chosen: Sequence[Case], tree: Path, names: Sequence[str]
) -> None:
    """Warn of cases whose labels differ from those of the tree, by which all are scored."""
    place = Path("training") / part_folder("objects")
    by_case = {
        case.name: list_unequal_files(tree / place, cases / case.name / place, names)
        for case in chosen
    }
    others = [case for case, unequal in by_case.items() if unequal]
    frames = sorted({name for unequal in by_case.values() for name in unequal})
    if others:
        warn_user(
            f"{tree / place}: scores of all cases are by these labels, but those of "
            f"{', '.join(others)} differ in {len(frames):,} frames ({describe_absent(frames)}): "
            "labels were changed between the cases; write the cases again, into another folder",
        )


def _check_complete(
    results: Path, cases: Sequence[Case], dataset: SampleDataset, scoring: Scoring
) -> None:
    """Check that all results exist, before any is scored."""
    for case in cases:
        folder = data_path(results / case.name)
        if not folder.is_dir():
            raise ValueError(
                f"{results} has no folder {case.name} for the results of that case; add it, or "
                "name the cases that there are (--cases)"
            )
        require_frame_files(
            folder,
            dataset.sample_ids,
            "result",
            "write an empty one where nothing was found, or name a list of the frames to score",
            scoring.suffix,
        )
