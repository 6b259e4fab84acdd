"""`sightline robustness`: measure the loss of a method under sensor faults, for any task."""

from pathlib import Path
from typing import TYPE_CHECKING, get_args

from sightline.cli.network_options import announce_engine, refuse_engine
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file, refuse_given
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.names import EngineChoice
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from sightline.robustness.bench import BenchTask
    from sightline.structures.sample import Sensor


def robustness(
    *,
    out_folder: Path | None = None,
    task: str | None = None,
    method: str | None = None,
    weights: str | None = None,
    data: Path | None = None,
    suite: str | None = None,
    cases: tuple[str, ...] | None = None,
    seed: int | None = None,
    baseline: str | None = None,
    healthy: tuple[str, ...] | None = None,
    results: tuple[str, ...] = (),
    show: str | None = None,
    picture_px: int = 800,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    driver: Driver = "local",
    compare: tuple[str, ...] | None = None,
    page: Path | None = None,
) -> None:
    """Measure robustness to sensor faults: scores in every case of a suite, and summaries.

    OUT_FOLDER gets robustness.json, .csv and .md, and report.html, a page in one file. To resume an
    interrupted run, run it again. With --compare, runs are compared instead; with --results,
    results of any other method are scored.

    Args:
        out_folder: Folder of the run; not needed with --compare.
        task: Task; `sightline tasks` lists them; or joined, the objects of both detectors. Default:
            the task of the weights, or depth-completion.
        method: Method without a network.
        weights: Weights of the network: name of weights in Sightline (`sightline tasks` lists them)
            or a file (.safetensors, .ckpt). Default: the task's own.
        data: A data set; with --results, the folder from `sightline corrupt`.
        suite: Set of cases, see docs/corruptions.md: a suite, a kind, or several kinds together
            (camera_fog+lidar_fog). Default: dgfn7.
        cases: Cases of the suite to run, beside the clean one. Default: all; with --results, all
            cases with results.
        seed: Seed of the random boxes, discs and noise. Default: 0.
        baseline: Baseline of the corruption error: another run, its folder or its robustness.json,
            or weights or a method of the task, which are run as well.
        healthy: Methods of one sensor each, for the gap to the best healthy sensor: camera=A.json
            lidar=B.json, of the same frames.
        results: Folder with a folder of result files for each case, by any method.
        show: Frame of the example pictures. Default: the first.
        picture_px: Width of each example picture; a click on it in the page enlarges it.
        engine: Engine of the networks: by default (auto) openvino on the CPU if it is installed,
            else torch.
        device: Device of the networks in PyTorch.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        workers: Number of processes with one thread each. Any number gives the same files.
        driver: Kind of workers: processes of this machine (local), or of a Ray cluster (ray),
            one CPU each, by pip install '.[ray]'; docs/guides/scale.md tells how.
        compare: Two runs or more to compare: their folders, or the robustness.json in them.
        page: With --compare: page (.html) with the charts.
    """
    if compare is not None:
        if results or any(each is not None for each in (out_folder, data, weights, method)):
            raise ValueError(
                "--compare reads finished runs; leave the folder, --data, --results, "
                "--weights and --method out"
            )
        used = ("out_folder", "data", "results", "weights", "method", "compare", "page")
        refuse_given(robustness, locals(), "with --compare, which reads finished runs", used=used)
        _compare(compare, page)
        return
    if page is not None:
        raise ValueError("--page draws finished runs; give them by --compare, or leave it out")
    if out_folder is None or data is None:
        lacking = "data set (--data)" if data is None else "folder for the run"
        raise ValueError(
            f"robustness needs a {lacking}; give the folder before options with several values, as "
            "in sightline robustness OUT --data DATA --cases camera_blank lidar_blank"
        )
    by_sensor = _by_sensor(healthy or ())
    files = [named_file(each) for each in (weights, baseline, sample_list)]
    only_read = [data, *files, *by_sensor.values()]
    check_outputs({"OUT_FOLDER": out_folder}, data=only_read, results=map(Path, results))
    if results:
        _check_results(results, task, weights, method)
    from sightline.robustness.bench import BenchSettings, run_bench
    from sightline.robustness.results import score_results

    chosen = _chosen_task(task, weights)
    settings = BenchSettings(
        suite=suite,
        seed=seed,
        cases=cases,
        sample_list=sample_list,
        velodyne=velodyne,
        baseline=baseline,
        healthy=by_sensor,
        shown=show,
        picture_px=picture_px,
        workers=workers,
        driver=driver,
    )
    if results or (method is not None and baseline is None):  # a baseline may be a network
        refuse_engine(engine, device)
    if not results:
        report = run_bench(
            chosen,
            data,
            out_folder,
            settings,
            method=method,
            weights=weights,
            engine=engine,
            device=device,
        )
        announce_engine(engine, report.record.made_by.get("engine"), device)
    else:
        report = score_results(chosen, data, Path(results[0]), out_folder, settings)
    deliver(report, None)
    say(*(out_folder / name for name in report.files))


def _check_results(
    results: tuple[str, ...], task: str | None, weights: str | None, method: str | None
) -> None:
    """Refuse options that do not go with --results, or lack."""
    if method is not None or weights is not None:
        raise ValueError("--results needs no method and no weights; leave them out")
    if len(results) > 1:
        raise ValueError(
            f"--results is one folder, got {' '.join(results)}; give the run's own folder first"
        )
    if task is None:
        raise ValueError(
            "--results does not tell what its files are; name it by --task detection2d or "
            "--task detection3d"
        )


def _chosen_task(task: str | None, weights: str | None) -> "BenchTask":
    """Find the task by name, else by the weights; joined objects are one of the bench alone."""
    from sightline.joining.models import JOINED
    from sightline.tasks import choose_task

    if (task or weights) != JOINED:
        return choose_task(task, weights)
    from sightline.joining.robustness import JoinedTask

    return JoinedTask()


def _compare(paths: tuple[str, ...], page: Path | None) -> None:
    from sightline.robustness.compare import compare_runs
    from sightline.robustness.record import files_beside, record_file

    runs = [Path(path) for path in paths]
    read = [record_file(path) for path in runs]
    check_places({"--page": page}, data=read + [each for run in runs for each in files_beside(run)])
    comparison = compare_runs([Path(path) for path in paths])
    if page is not None:  # before the table, whose reader may be gone
        comparison.write(page)
    deliver(comparison, None)
    if page is not None:
        say(page)


def _by_sensor(given: tuple[str, ...]) -> "dict[Sensor, Path]":
    """Parse `camera=A.json lidar=B.json`."""
    from sightline.structures.sample import Sensor

    paths: dict[Sensor, Path] = {}
    for word in given:
        name, _, path = word.partition("=")
        sensor = next((each for each in get_args(Sensor) if each == name), None)
        if sensor is None or not path:
            raise ValueError(
                f"--healthy {word} is invalid: give camera=FILE or lidar=FILE, with the "
                "robustness.json of a method that uses only that sensor"
            )
        if sensor in paths:
            raise ValueError(f"--healthy has two methods of the {sensor}; leave one out")
        paths[sensor] = Path(path)
    return paths
