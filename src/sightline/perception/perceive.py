"""All tasks on a whole data set, resumable and in parallel, with one line per frame."""

import json
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from sightline.data.datasets.newer_frames import (
    ADD_OVERWRITE,
    warn_of_gone_frames,
    warn_of_newer_frames,
)
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import warn_of_missing_sensors
from sightline.data.layouts.kitti_trees import Part, Velodyne, describe_absent
from sightline.data.open import open_dataset
from sightline.files.atomic import atomic_write_text, scratch_folder
from sightline.files.problem import refuse_without_effect
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.packed import pack_results
from sightline.inference.predictor import warn_of_unversioned
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import (
    Claim,
    check_outputs,
    claim_folders,
    differs_only_in,
    finished_names,
    read_claim,
    renew_claims,
)
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job, shard
from sightline.joining.alignment import MIN_FRAMES, Alignment
from sightline.perception.frame_work import (
    FrameWork,
    done_frames,
    further_outputs,
    predicting_tasks,
    result_claims,
    result_places,
)
from sightline.perception.kept_lines import LINES_FOLDER, join_lines
from sightline.perception.perceiver import SWEEP_TASK, MultiTaskPredictor
from sightline.perception.pictures import FPS, MIN_SCORE, PictureFiles
from sightline.perception.results import ALIGNMENT, JOB_NAME
from sightline.structures.lidar_turn import LidarTurn

_NOT_JOINED: Final = (
    "objects are not joined: there are no models of joined scores for these detectors; fit them by "
    "`sightline fit-joined`, and give --joined (MultiTaskPredictor.load(joined=..))"
)
_AS_HELD: Final = (
    "; it was measured when this output was begun: to measure it anew, overwrite all its frames in "
    "one run, or name another output"
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
        warn_user("answered is now predicted", DeprecationWarning)
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
        overwrite: Whether to replace existing files. Where all of them are replaced, the LiDAR's
            rotation is measured anew.
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
    warn_of_missing_sensors(dataset, data, perceiver.parts)
    _check_tasks(perceiver, around=around, all_outputs=all_outputs)
    indices = shard(range(len(dataset)), shard_index, num_shards)
    names = [dataset.sample_ids[index] for index in indices]
    folder = out / LINES_FOLDER
    finished = {name for name in finished_names(folder, ".json") if not name.startswith(".")}
    is_measurable = not align or len(dataset) >= MIN_FRAMES
    is_all_anew = overwrite and is_measurable and finished <= set(names)
    held = None
    if align and perceiver.alignment is None:
        held = None if is_all_anew else _held_alignment(out)
        perceiver = (
            _aligned(perceiver, dataset, workers, driver)
            if held is None
            else perceiver.with_alignment(held)
        )
    if perceiver.alignment:
        origin = "" if held is None else _AS_HELD
        warn_user(f"{perceiver.alignment}{origin}{_ON_ALIGNMENT}")
    places = result_places(perceiver, out, all_outputs=all_outputs)
    claims = result_claims(perceiver, places, data, dataset, out, around=around)
    if is_all_anew:
        _drop_other_alignment(claims, folder)
    _claim_folders(claims)
    warn_of_gone_frames(dataset, folder, finished)
    done = set() if overwrite else done_frames(dataset, perceiver, places, folder)
    kept = (
        (index, [folder / f"{name}.json"])  # written after the frame's other files
        for index, name in zip(indices, names, strict=True)
        if name in done
    )
    warn_of_newer_frames(dataset, kept, parts=perceiver.parts)
    warn_of_unversioned(perceiver.predictors.values(), len(done & set(names)), remedy=ADD_OVERWRITE)
    works = [
        FrameWork(dataset, index, name, perceiver, places, out, around)
        for index, name in zip(indices, names, strict=True)
        if name not in done
    ]
    notes = run_job(works, workers, description=JOB_NAME, leave_out=LEAVE_OUT, driver=driver)
    lines = join_lines(out)
    _check_all_there(out, names, lines)
    if pictures:
        pictures.write(dataset, out)
    return PerceiveResult(
        written=len(works),
        skipped=len(names) - len(works),
        notes=notes,
        predicted={
            task: sum(task in predicting_tasks(lines[name][1]) for name in names)
            for task in perceiver.predictors
        },
    )


def _claim_folders(claims: Sequence[Claim]) -> None:
    """Claim all folders; a refusal for the LiDAR's rotation alone has its own remedies.

    Raises:
        ValueError: See `claim_folders`.
    """
    held, now = read_claim(claims[0].folder), claims[0].settings
    try:
        claim_folders(claims)
    except ValueError as error:
        is_only_difference = all(differs_only_in(each, ALIGNMENT) for each in claims)
        if held is None or held.get(ALIGNMENT) == now.get(ALIGNMENT) or not is_only_difference:
            raise
        go_on = ""
        if ALIGNMENT not in held:
            go_on = "add --align no (align=False) to take all frames as they are, or "
        elif ALIGNMENT not in now:
            go_on = "leave --align no out, or "
        raise ValueError(
            f"{error}; or {go_on}overwrite all its frames in one run (--overwrite), which measures "
            "the rotation of the LiDAR anew, once lines of frames that the data do not have are "
            "removed"
        ) from error


def _drop_other_alignment(claims: Sequence[Claim], lines: Path) -> None:
    """Drop the lines of all frames if their LiDAR was turned otherwise, and renew the claims.

    The claim on the whole folder is renewed last: until then another run is refused, or overwrites
    all frames, too.
    """
    is_other = any(
        (read_claim(each.folder) or each.settings).get(ALIGNMENT) != each.settings.get(ALIGNMENT)
        for each in claims
    )
    if not is_other or not all(differs_only_in(each, ALIGNMENT) for each in claims):
        return  # nothing else is refused here
    for path in lines.glob("*.json"):
        path.unlink()
    renew_claims(claims[::-1], ALIGNMENT)


def _check_all_there(out: Path, names: Sequence[str], lines: Collection[str]) -> None:
    """Refuse a folder from which lines of finished frames were removed meanwhile."""
    gone = [name for name in names if name not in lines]
    if gone:
        raise ValueError(
            f"{out} lacks the lines of {len(gone)} of {len(names)} frames, "
            f"{describe_absent(gone)}: they were written, but removed or changed meanwhile; run "
            "the same command again"
        )


def _check_tasks(perceiver: MultiTaskPredictor, *, around: bool | None, all_outputs: bool) -> None:
    """Refuse an option of a task that is left out, and warn where objects are not joined."""
    has_further = any(further_outputs(*each) for each in perceiver.predictors.items())
    refuse_without_effect(
        "on these tasks and predictors, which have no further outputs",
        all_outputs=all_outputs and not has_further,
    )
    is_searched = SWEEP_TASK in perceiver.predictors
    refuse_without_effect("without 3D detection", around=around is not None and not is_searched)
    if perceiver.lacks_models:
        warn_user(_NOT_JOINED)


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
    _check_tasks(perceiver, around=around, all_outputs=all_outputs)
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

    @property
    def parts(self) -> Collection[Part]:
        return self.perceiver.parts

    def open(self, data: Path) -> SampleDataset:
        return open_dataset(data, velodyne=self.velodyne, parts=self.perceiver.parts, needs=())

    def claims(self, data: Path, dataset: SampleDataset, folder: Path) -> list[Claim]:
        places = result_places(self.perceiver, folder, all_outputs=self.all_outputs)
        return result_claims(self.perceiver, places, data, dataset, folder, around=self.around)

    def works(self, dataset: SampleDataset, folder: Path) -> "list[FrameWork]":
        places = result_places(self.perceiver, folder, all_outputs=self.all_outputs)
        shared = (self.perceiver, places, folder, self.around)
        return [
            FrameWork(dataset, index, name, *shared, keeps_time=False)
            for index, name in enumerate(dataset.sample_ids)
        ]


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


def _held_alignment(out: Path) -> Alignment | None:
    """Read the LiDAR's rotation that an output folder was begun with; None: it holds none."""
    held = (read_claim(out) or {}).get(ALIGNMENT)
    if isinstance(held, dict):
        with suppress(TypeError, ValueError):  # of a manifest that was edited
            return Alignment.from_json(held)
    return None


def _aligned(
    perceiver: MultiTaskPredictor, dataset: SampleDataset, workers: int, driver: Driver
) -> MultiTaskPredictor:
    """Undo the LiDAR's rotation as the frames show it."""
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
