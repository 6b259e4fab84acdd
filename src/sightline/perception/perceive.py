"""All tasks on a whole data set, resumable and in parallel, with one line per frame."""

import json
import warnings
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from sightline.data.kitti_trees import Velodyne, describe_absent
from sightline.data.newer_frames import warn_of_newer_frames
from sightline.data.open import (
    SampleDataset,
    has_file,
    open_dataset,
    sweeps_folder,
    warn_of_missing_sensors,
)
from sightline.files.atomic import atomic_write_text, scratch_folder
from sightline.files.problem import refuse_without_effect
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.packed import pack_results
from sightline.inference.predict import (
    Places,
    around_entry,
    output_claims,
    output_places,
    predicted_samples,
    read_sample,
    write_prediction,
)
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import Claim, check_outputs, claim_folders, data_name, read_claim
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job, shard
from sightline.joining.alignment import MIN_FRAMES, Alignment
from sightline.joining.files import write_objects
from sightline.joining.models import JOINED
from sightline.perception.kept_lines import LINES_FOLDER, Lines, read_lines, read_timings
from sightline.perception.lines import frame_line, timing_line
from sightline.perception.perceiver import SWEEP_TASK, MultiTaskPredictor
from sightline.perception.pictures import FPS, MIN_SCORE, PictureFiles
from sightline.perception.results import ALIGNMENT, JOB_NAME
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.tasks import find_task

JOINED_FOLDERS: Final = {JOINED: False, f"{JOINED}-3d": True}
"""Folders in the output folder of joined objects as result files, and whether the scores are those
of the 3D boxes."""

LINES_NAME: Final = "perception.jsonl"
"""File in the output folder with a line for each frame, sorted by name."""

TIMINGS_NAME: Final = "timings.jsonl"
"""File with the time of each prediction: the only output that differs between runs."""

_TIMINGS_FOLDER = "timings"
_NOT_JOINED: Final = (
    "objects are not joined: there are no models of joined scores for these detectors; fit them by "
    "`sightline fit-joined`, and give --joined (MultiTaskPredictor.load(joined=..))"
)
_ON_ALIGNMENT: Final = "; --align no (align=False) takes the frames as they are"


@dataclass(frozen=True, kw_only=True, slots=True)
class PerceiveResult(JobResult):
    """Result of a job, with counts of predicted frames."""

    predicted: Mapping[str, int]
    """Number of predicted frames by task."""

    @property
    def answered(self) -> Mapping[str, int]:
        """Deprecated name of `predicted`."""
        warnings.warn("answered is now predicted", DeprecationWarning, stacklevel=2)
        return self.predicted


@named_arguments
def perceive(
    data: Path | str,
    out: Path | str,
    *,
    perceiver: MultiTaskPredictor | None = None,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    all_outputs: bool = False,
    workers: int = 1,
    driver: Driver = "local",
    overwrite: bool = False,
    shard_index: int = 0,
    num_shards: int = 1,
    video: Path | str | None = None,
    rerun: Path | str | None = None,
    fps: float = FPS,
    min_score: float = MIN_SCORE,
    around: bool | None = None,
    align: bool = True,
) -> PerceiveResult:
    """Run all tasks on every frame of a data set; each frame is loaded once.

    `out` then contains a folder of result files for each task, as from `sightline predict`, the
    folders `joined` and `joined-3d` of objects if there are models of joined scores for the
    detectors' weights, perception.jsonl (docs/perception.md describes its lines) and timings.jsonl.
    For a frame without a sensor, only the tasks that can work without it predict.

    A rotation of the LiDAR in its mount, measured over up to 15 frames of the data, is undone in
    each frame if it is surer than its noise, with a warning; the lines hold it (`undone_turn`).

    Files are written atomically, and finished frames are skipped: to resume a stopped job, run it
    again. Damaged lines and times are left out with a warning.

    Examples:
        >>> import json, sightline, tempfile
        >>> from pathlib import Path
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> weights = {"detection2d": "detection2d-fast-cpu", "depth-completion": "nearest"}
        >>> perceiver = sightline.MultiTaskPredictor.load(weights)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     done = sightline.perceive(PACKAGED_FRAMES, folder, perceiver=perceiver)
        ...     lines = (Path(folder) / "perception.jsonl").read_text().splitlines()
        >>> done.written, [json.loads(line)["frame"] for line in lines]
        (2, ['000000', '000001'])

    Args:
        data: Folder of the data set; see `open_dataset`.
        out: Folder for all results; created if missing.
        perceiver: The tasks with their predictors. None: all, with their default weights.
        sample_list: List of the frames; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        all_outputs: Whether to write also the further outputs of tasks: expected errors, gates.
        workers: Number of workers; 1 on this machine: only this process.
        driver: Kind of workers: processes of this machine, or actors of a Ray cluster.
        overwrite: Whether to replace existing files.
        shard_index: Index of the shard to process, from 0.
        num_shards: Number of shards; shards can run on different machines at the same time.
        video: Additional MP4 file of all frames; see `PictureFiles`.
        rerun: Additional file of the Rerun viewer (.rrd); see `PictureFiles`.
        fps: Frames per second of the video.
        min_score: Score threshold of drawn detections; the results contain all of them.
        around: Whether 3D detection searches whole turns of the LiDAR. None: as the samples say.
        align: Whether to measure and undo the LiDAR's rotation, unless `perceiver` is aligned.

    Raises:
        ValueError: The data cannot be read, `out` lies in them, contains other results or cannot be
            written to, a number is invalid, or a library for the pictures is missing. Errors about
            a frame name it; finished frames stay.
    """
    pictures = PictureFiles.checked(video, rerun, fps=fps, min_score=min_score)
    if num_shards > 1 and pictures:
        raise ValueError(
            "a shard cannot make the whole video; make the pictures in a last run of all frames"
        )
    check_workers(workers, driver)
    shard((), shard_index, num_shards)  # refuses an invalid one before the data are opened
    data, out = Path(data), Path(out)
    check_outputs(
        {
            "out": out,
            "video": None if video is None else Path(video),
            "rerun": None if rerun is None else Path(rerun),
        },
        data=[data],
    )
    perceiver = perceiver or MultiTaskPredictor.load(threads=1)
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=perceiver.parts, needs=()
    )
    warn_of_missing_sensors(dataset, data, perceiver.parts, stacklevel=2)
    _check_tasks(perceiver, around=around)
    if align and perceiver.alignment is None:
        perceiver = _aligned(perceiver, dataset, out, workers, driver)
    if perceiver.alignment:
        warnings.warn(f"{perceiver.alignment}{_ON_ALIGNMENT}", stacklevel=2)
    indices = shard(range(len(dataset)), shard_index, num_shards)
    names = [dataset.sample_ids[index] for index in indices]
    places = _places(perceiver, out, all_outputs=all_outputs)
    made_by = _made_by(perceiver)
    claim_folders(_claims(perceiver, places, data, out, sweeps_folder(dataset), around=around))
    folder = out / LINES_FOLDER
    done = set() if overwrite else _done_frames(dataset, perceiver, places, folder)
    kept = (
        (index, [folder / f"{name}.json"])  # written after the frame's other files
        for index, name in zip(indices, names, strict=True)
        if name in done
    )
    warn_of_newer_frames(dataset, kept, parts=perceiver.parts)
    works = [
        _FrameWork(dataset, index, name, perceiver, places, made_by, out, around)
        for index, name in zip(indices, names, strict=True)
        if name not in done
    ]
    notes = run_job(works, workers, description=JOB_NAME, leave_out=LEAVE_OUT, driver=driver)
    files = _line_files(out)  # before they are read: other shards may go on writing meanwhile
    lines = _join_lines(out)
    _warn_of_missing(out, files, lines, _join_timings(out))
    if pictures:
        pictures.write(dataset, out)
    return PerceiveResult(
        written=len(works),
        skipped=len(names) - len(works),
        notes=notes,
        predicted={
            task: sum(task in _predicting_tasks(lines[name][1]) for name in names)
            for task in made_by
        },
    )


def _check_tasks(perceiver: MultiTaskPredictor, *, around: bool | None) -> None:
    """Refuse an option of a task that is left out, and warn where objects are not joined."""
    is_searched = SWEEP_TASK in perceiver.predictors
    refuse_without_effect("without 3D detection", around=around is not None and not is_searched)
    if perceiver.lacks_models:
        warnings.warn(_NOT_JOINED, stacklevel=3)


def perceive_shards(
    data: Path,
    out: Path,
    *,
    perceiver: MultiTaskPredictor,
    velodyne: Velodyne | None = None,
    all_outputs: bool = False,
    workers: int = 1,
    driver: Driver = "local",
    shard_index: int = 0,
    num_shards: int = 1,
    around: bool | None = None,
) -> JobResult:
    """Run all tasks on a folder of shards, and pack the results of each shard into one.

    The arguments are those of `perceive`; see `pack_results` for `out` and the errors. The shards
    hold each frame's line, but no perception.jsonl and no times, which differ between runs. Frames
    are taken as calibrated, since a shard alone may be too short to measure the LiDAR's rotation.
    """
    _check_tasks(perceiver, around=around)
    return pack_results(
        _ShardWriter(perceiver, velodyne, all_outputs, around),
        data,
        out,
        description=f"shards: {JOB_NAME}",
        workers=workers,
        driver=driver,
        shard_index=shard_index,
        num_shards=num_shards,
    )


@dataclass(frozen=True, slots=True)
class _ShardWriter:
    """Writer of the results of all tasks."""

    perceiver: MultiTaskPredictor
    velodyne: Velodyne | None
    all_outputs: bool
    around: bool | None

    def open(self, data: Path) -> SampleDataset:
        return open_dataset(data, velodyne=self.velodyne, parts=self.perceiver.parts, needs=())

    def claims(self, data: Path, dataset: SampleDataset, folder: Path) -> list[Claim]:
        places = _places(self.perceiver, folder, all_outputs=self.all_outputs)
        sweeps = sweeps_folder(dataset)
        return _claims(self.perceiver, places, data, folder, sweeps, around=self.around)

    def works(self, dataset: SampleDataset, folder: Path) -> "list[_FrameWork]":
        places = _places(self.perceiver, folder, all_outputs=self.all_outputs)
        made_by = _made_by(self.perceiver)
        shared = (self.perceiver, places, made_by, folder, self.around)
        return [
            _FrameWork(dataset, index, name, *shared, keeps_time=False)
            for index, name in enumerate(dataset.sample_ids)
        ]


def _made_by(perceiver: MultiTaskPredictor) -> dict[str, str]:
    """Names of the predictors by task."""
    return {name: predictor.name for name, predictor in perceiver.predictors.items()}


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Work item: runs all tasks on a frame and writes its files; the line comes last."""

    dataset: SampleDataset
    index: int
    name: str
    perceiver: MultiTaskPredictor
    places: Mapping[str, Places]
    made_by: Mapping[str, str]
    out: Path
    around: bool | None
    keeps_time: bool = True
    """Write the time of each prediction, too."""

    def __str__(self) -> str:
        return f"sample {self.name}"

    def run(self) -> str:
        sample = read_sample(self.dataset, self.index, around=self.around)
        predictions = self.perceiver.predict_by_task(sample)
        sample = undo_turn(sample, predictions.undone_turn or LidarTurn())
        remarks = [
            write_prediction(self.places[task], sample, prediction)
            for task, prediction in predictions.by_task.items()
        ]
        if predictions.objects is not None:
            for folder, in_space in JOINED_FOLDERS.items():
                path = self.out / folder / f"{self.name}.txt"
                path.parent.mkdir(exist_ok=True)
                write_objects(path, sample, predictions.objects, in_space=in_space)
        if self.keeps_time:
            self._write_line(_TIMINGS_FOLDER, timing_line(sample, predictions))
        self._write_line(LINES_FOLDER, frame_line(sample, predictions, self.made_by))
        return "; ".join(filter(None, remarks))

    def _write_line(self, folder: str, line: str) -> None:
        atomic_write_text(self.out / folder / f"{self.name}.json", f"{line}\n")


@dataclass(frozen=True)
class _MountWork:
    """Measurement of the LiDAR's mount in a process of its own.

    The networks may run for it, and OpenVINO cannot run in workers that are forked afterwards.
    """

    dataset: SampleDataset
    perceiver: MultiTaskPredictor
    into: Path

    def __str__(self) -> str:
        """Name in errors."""
        return "the LiDAR's mount"

    def run(self) -> None:
        """Write the alignment as JSON."""
        alignment = self.perceiver.aligned(self.dataset).alignment or Alignment()
        atomic_write_text(self.into, json.dumps(asdict(alignment)))  # not rounded


def _aligned(
    perceiver: MultiTaskPredictor,
    dataset: SampleDataset,
    out: Path,
    workers: int,
    driver: Driver,
) -> MultiTaskPredictor:
    """Undo the LiDAR's rotation as the output folder says, else as the frames do."""
    held = (read_claim(out) or {}).get(ALIGNMENT)
    if isinstance(held, dict):
        with suppress(TypeError, ValueError):  # of a manifest that was edited
            return perceiver.with_alignment(Alignment.from_json(held))
    if len(dataset) < MIN_FRAMES or not {"image", "points"} <= set(perceiver.parts):
        return perceiver
    if workers == 1 or driver != "local":  # other drivers fork no process
        return perceiver.aligned(dataset)
    with scratch_folder() as folder:
        work = _MountWork(dataset, perceiver, folder / "alignment.json")
        run_job([work], workers, description="measuring the LiDAR's mount")
        measured = json.loads(work.into.read_text())
    turn = LidarTurn(**measured.pop("turn"))
    return perceiver.with_alignment(Alignment(turn=turn, **measured))


def _places(perceiver: MultiTaskPredictor, out: Path, *, all_outputs: bool) -> dict[str, Places]:
    """Folders by task: one named after the task for its first output, one per further output."""
    places = {}
    for name, predictor in perceiver.predictors.items():
        task = find_task(name)
        also = {
            output.name: out / f"{name}-{output.name}"
            for output in task.outputs[1:]
            if all_outputs and output.name in predictor.gives
        }
        places[name] = output_places(task, predictor, out / name, also)
    return places


def _claims(
    perceiver: MultiTaskPredictor,
    places: Mapping[str, Places],
    data: Path,
    out: Path,
    velodyne: Velodyne,
    *,
    around: bool | None,
) -> list[Claim]:
    """Create the claims on the whole folder, and on each task's folder as `predict` does."""
    made_by = {
        name: {"method": predictor.name, **predictor.made_by}
        for name, predictor in perceiver.predictors.items()
    }
    aligned = {ALIGNMENT: perceiver.alignment.to_json()} if perceiver.alignment else {}
    settings = {
        "job": JOB_NAME,
        "folders": [folder.name for task in places.values() for _, folder in task],
        "data": data_name(data),
        "velodyne": velodyne,
        "sightline": version("sightline"),
        **around_entry(around=around),
        **aligned,
        **made_by,
        **perceiver.models_entry,
    }
    claims = [Claim(folder=out, settings=settings, results=(f"{LINES_FOLDER}/*.json", LINES_NAME))]
    for name, predictor in perceiver.predictors.items():
        task, chosen = find_task(name), around_entry(around=around) | aligned
        claims += output_claims(task, predictor, places[name], data, velodyne, chosen=chosen)
    models = perceiver.join_models
    if models is not None:
        joined = {key: settings[key] for key in ("job", "data", "velodyne", "sightline")}
        claims += [
            Claim(
                folder=out / folder,
                settings={**joined, "models": models.identity, **aligned},
                results=("*.txt",),
            )
            for folder in JOINED_FOLDERS
        ]
    return claims


def _done_frames(
    dataset: SampleDataset,
    perceiver: MultiTaskPredictor,
    places: Mapping[str, Places],
    folder: Path,
) -> set[str]:
    """Frames with a line of these tasks and all files of the tasks that predicted.

    A missing sensor in a line is accepted only if the data still has no file of the sensor.
    """
    present = {task: predicted_samples(task_places) for task, task_places in places.items()}
    lines = read_lines(folder)
    done = set()
    for index, name in enumerate(dataset.sample_ids):
        if name not in lines:
            continue
        line = lines[name][1]
        tasks = line["tasks"]
        has_same_predictors = all(
            task in tasks and tasks[task]["by"] == predictor.name
            for task, predictor in perceiver.predictors.items()
        )
        lacking = {part for entry in tasks.values() for part in entry.get("lacks", ())}
        still_lacks = not any(has_file(dataset, index, part) for part in lacking)
        has_files = all(name in present.get(task, ()) for task in _predicting_tasks(line))
        if line["objects"] is not None:
            paths = (folder.parent / each / f"{name}.txt" for each in JOINED_FOLDERS)
            has_files &= all(path.is_file() for path in paths)
        if has_same_predictors and still_lacks and has_files:
            done.add(name)
    return done


def _join_lines(out: Path) -> Lines:
    """Join all frames' lines in one file, including lines written by other shards meanwhile."""
    while True:
        lines = read_lines(out / LINES_FOLDER)
        atomic_write_text(out / LINES_NAME, "".join(f"{text}\n" for text, _ in lines.values()))
        # Another shard may have ended between the reading and the writing: its file was complete,
        # and this one has just replaced it.
        if read_lines(out / LINES_FOLDER) == lines:
            return lines


def _join_timings(out: Path) -> Lines:
    """Join the times of all frames in one file; see `_join_lines`."""
    timings: Lines | None = None
    while timings != (timings := read_timings(out / _TIMINGS_FOLDER)):
        atomic_write_text(out / TIMINGS_NAME, "".join(f"{text}\n" for text, _ in timings.values()))
    return timings


def _line_files(out: Path) -> list[str]:
    """Names of the frames that have a file with their line."""
    return sorted(path.stem for path in (out / LINES_FOLDER).glob("*.json"))


def _warn_of_missing(out: Path, files: Sequence[str], lines: Lines, timings: Lines) -> None:
    """Warn of frames that have files in the folder but no entry in the joined files."""
    for entry, names, joined in (
        ("line", [name for name in files if name not in lines], LINES_NAME),
        ("time", [name for name in lines if name not in timings], TIMINGS_NAME),
    ):
        if names:
            warnings.warn(
                f"{out / joined} lacks the {entry} of {len(names)} of {len(files)} frames, "
                f"{describe_absent(names)}: the file of each is missing, damaged or has other "
                "content; run this again for these frames with --overwrite",
                stacklevel=3,
            )


def _predicting_tasks(line: Mapping[str, Any]) -> Collection[str]:
    """Names of the tasks that predicted for the frame of a line."""
    return [name for name, entry in line["tasks"].items() if "lacks" not in entry]
