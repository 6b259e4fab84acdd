"""KITTI's object evaluation of a folder of result files, identical to the official program.

2D boxes, orientation, bird's-eye view and 3D; Car, Pedestrian, Cyclist; easy, moderate, hard.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from sightline.data.formats.kitti_labels import (
    KittiObjects,
    parse_objects,
    read_labels,
    read_results,
)
from sightline.data.layouts.frame_lists import (
    LABEL_PLACES,
    TIMES_NAME,
    capital_suffixes,
    folders_below,
    have_equal_files,
    is_note,
    lasting_list,
    locate_frame_files,
    read_sample_list,
    require_frame_files,
)
from sightline.data.layouts.kitti_trees import list_files
from sightline.data.layouts.recording_files import is_recording
from sightline.evaluation.inputs import check_apart
from sightline.evaluation.kitti_object_comparison import ObjectComparison, compare_submissions
from sightline.evaluation.kitti_object_pairs import MatchingData, concatenate, find_pairs
from sightline.evaluation.kitti_object_rules import STRICT, MinimumOverlaps
from sightline.evaluation.kitti_object_scores import check_edges, score_by_distance, score_objects
from sightline.evaluation.object_report import ObjectReport
from sightline.evaluation.object_tally import ObjectTally, tallied, unread_files
from sightline.files.byte_source import url_of
from sightline.files.leftovers import is_leftover
from sightline.files.problem import FileError, read_or_note, shown_place
from sightline.files.shard_path import data_path
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import is_split
from sightline.jobs.progress import track

_FRAMES_AT_A_TIME = 64
_MAX_PAIRS = 2_000_000  # results times labels in one frame; KITTI's fullest has some thousands
_MAX_RESAMPLES = 100_000  # this gives the interval's ends to a tenth of their last digit


@named_arguments
def evaluate_objects(
    results_dir: Path | str,
    labels_dir: Path | str,
    *,
    sample_list: Path | str | Sequence[str] | None = None,
    overlaps: MinimumOverlaps = STRICT,
    bootstrap: int = 0,
    seed: int = 0,
    by_distance: Sequence[float] = (),
    missing_as_empty: bool = False,
    progress: bool = False,
) -> ObjectReport:
    r"""Evaluate result files against label files like KITTI's official program.

    3D entries also have nuScenes' scores by the distance of centres: see `CentreScores`. Frames are
    read and dropped one after the other; memory grows only with the number of scores.

    Examples:
        >>> import sightline, tempfile
        >>> from pathlib import Path
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> labels = PACKAGED_FRAMES / "training" / "label_2"
        >>> with tempfile.TemporaryDirectory() as results:
        ...     for path in labels.iterdir():  # the labels themselves, each with a score of 1
        ...         lines = [f"{line} 1.0" for line in path.read_text().splitlines()]
        ...         _ = Path(results, path.name).write_text("\n".join(lines))
        ...     report = sightline.evaluate_objects(results, labels)
        >>> report.frames
        2

    Args:
        results_dir: One file per frame, 16 fields per line; empty without detections.
        labels_dir: One file per frame, 15 fields per line.
        sample_list: Frames to evaluate; see `read_sample_list`. None: all with labels.
        overlaps: Overlaps that a match must exceed, by class and metric.
        bootstrap: Resamples of the frames for the intervals of `AP_all_points` and of AP by centre
            distance, up to 100,000; 0: no interval. Fewer than 10 frames have none.
        seed: Seed of the resamples.
        by_distance: Edges of distance bands [m] that are scored separately, too; ascending.
        missing_as_empty: Whether a frame without a result file counts as one without detections.
        progress: Whether to show the progress.

    Raises:
        ValueError: If a frame lacks its file (KITTI's program would skip it, which improves the
            recall), a file is invalid, or a frame has far too many objects; the message contains
            its name and the remedy. Or as for `score_by_distance`.
    """
    check_resampling(bootstrap, seed)
    by_distance = tuple(by_distance)
    check_edges(by_distance)
    found = _read_submission(
        results_dir,
        labels_dir,
        sample_list,
        overlaps,
        missing_as_empty=missing_as_empty,
        progress=progress,
    )
    report = score_objects(found.data, overlaps, bootstrap=bootstrap, seed=seed)
    bands = score_by_distance(found.data, overlaps, by_distance) if by_distance else ()
    return replace(
        report,
        bands=bands,
        frames_without_results=found.num_missing,
        remarks=found.remarks,
        tally=found.tally,
    )


def compare_objects(
    results_dir: Path | str,
    labels_dir: Path | str,
    against_dir: Path | str,
    *,
    sample_list: Path | str | Sequence[str] | None = None,
    overlaps: MinimumOverlaps = STRICT,
    bootstrap: int = 1000,
    seed: int = 0,
    missing_as_empty: bool = False,
    progress: bool = False,
) -> ObjectComparison:
    """Compare two folders of result files on the same frames, with paired intervals.

    Args:
        results_dir: The first submission, as for `evaluate_objects`.
        labels_dir: As for `evaluate_objects`.
        against_dir: The second submission.
        sample_list: As for `evaluate_objects`.
        overlaps: Overlaps that a match must exceed, by class and metric.
        bootstrap: Resamples of the frames, 1 to 100,000; see `compare_submissions`.
        seed: Seed of the resamples.
        missing_as_empty: Whether a frame without a result file counts as one without detections.
        progress: Whether to show the progress.

    Raises:
        ValueError: As for `evaluate_objects`, for either submission.
    """
    if bootstrap == 0:
        raise ValueError("bootstrap must be positive to compare, got 0: give e.g. 1000")
    check_resampling(bootstrap, seed)
    folders = data_path(results_dir), data_path(against_dir)
    sample_list = lasting_list(sample_list)
    first, second = (
        _read_submission(
            folder,
            labels_dir,
            sample_list,
            overlaps,
            missing_as_empty=missing_as_empty,
            progress=progress,
        )
        for folder in folders
    )
    remarks = []
    if have_equal_files(*folders, first.names):
        remarks.append(
            f"WARNING: {results_dir} and {against_dir} hold the same results to the byte: name "
            "another folder to compare with."
        )
    for folder, each in ((results_dir, first), (against_dir, second)):
        if each.num_missing:
            remarks.append(
                f"{folder}: {each.num_missing:,} frames had no result file and counted as empty."
            )
        remarks += [f"{folder}: {line}" for line in each.remarks]
    return ObjectComparison(
        first=str(results_dir),
        second=str(against_dir),
        frames=first.data.num_frames,
        num_resamples=bootstrap,
        entries=compare_submissions(
            first.data, second.data, overlaps, num_resamples=bootstrap, seed=seed
        ),
        remarks=tuple(remarks),
    )


def check_resampling(bootstrap: int, seed: int) -> None:
    """Check the numbers of a bootstrap.

    Raises:
        ValueError: One is negative, or there are far too many resamples.
    """
    if bootstrap < 0:
        raise ValueError(f"bootstrap must not be negative, got {bootstrap}: give 0 to leave it out")
    if bootstrap > _MAX_RESAMPLES:
        raise ValueError(
            f"bootstrap must be at most {_MAX_RESAMPLES:,}, got {bootstrap}: more resamples take "
            "time and do not improve the interval"
        )
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")


class _Submission(NamedTuple):
    """Result files of all frames, matched with the labels."""

    names: tuple[str, ...]
    """Names of the frames."""
    data: MatchingData
    num_missing: int
    """Frames without a result file."""
    remarks: tuple[str, ...]
    """Remarks on files and objects that are not scored."""
    tally: ObjectTally


def _read_submission(
    results_dir: Path | str,
    labels_dir: Path | str,
    sample_list: Path | str | Sequence[str] | None,
    overlaps: MinimumOverlaps,
    *,
    missing_as_empty: bool,
    progress: bool,
) -> _Submission:
    results_dir, labels_dir = data_path(results_dir), data_path(labels_dir)
    names = frame_names(labels_dir, sample_list)
    missing = _missing_results(results_dir, labels_dir, names) if missing_as_empty else set()
    frames = read_frames(results_dir, labels_dir, names, empty=missing, progress=progress)
    tally = ObjectTally(counts_empty=not missing)
    parts: list[MatchingData] = []
    for batch in _batches(tallied(frames, tally)):
        detections, labels = zip(*batch, strict=True)
        parts.append(find_pairs(detections, labels, overlaps.as_array()))
    unread = unread_files(results_dir, labels_dir, names) if sample_list is None else ()
    remarks = (*unread, *tally.remarks())
    return _Submission(tuple(names), concatenate(parts), len(missing), remarks, tally)


def read_frames(
    results_dir: Path,
    labels_dir: Path,
    sample_list: Path | str | Sequence[str] | None,
    *,
    empty: Collection[str] = (),
    progress: bool,
) -> Iterator[tuple[KittiObjects, KittiObjects]]:
    """Read results and labels frame by frame; missing files are found before the first.

    Args:
        results_dir: One file per frame.
        labels_dir: One file per frame.
        sample_list: The frames; see `read_sample_list`. None: all with labels.
        empty: Frames without detections; their result files are not read.
        progress: Whether to show the progress.

    Raises:
        ValueError: If a frame lacks a file, a file is invalid, a frame has too many results times
            labels for matching in reasonable time, or both folders are one.
    """
    check_apart(results_dir, labels_dir, "the labels")
    names = frame_names(labels_dir, sample_list)
    require_frame_files(
        labels_dir,
        names,
        "label",
        "extract the labels again, or leave the frames out of the list",
    )
    scored = [name for name in names if name not in empty]
    lacking = (name for name in scored if not (results_dir / f"{name}.txt").exists())
    for name in islice(lacking, 1):  # a text that is not of labels is named as such
        read_labels(labels_dir / f"{name}.txt")
    require_frame_files(
        results_dir,
        scored,
        "result",
        "write an empty one where nothing was found (`evaluate objects --missing-as-empty` takes "
        "missing ones as empty), or name a list of the frames to score",
        other_than=labels_dir,
    )
    tracked: Iterable[str] = track(names, description="reading results") if progress else names
    return (
        _read_frame(
            None if name in empty else results_dir / f"{name}.txt", labels_dir / f"{name}.txt"
        )
        for name in tracked
    )


def _missing_results(results_dir: Path, labels_dir: Path, names: Sequence[str]) -> set[str]:
    missing = {name for name in names if not (results_dir / f"{name}.txt").exists()}
    if len(missing) == len(names):
        elsewhere = (
            locate_frame_files(results_dir, names, other_than=labels_dir)
            if results_dir.is_dir()
            else None
        )
        raise ValueError(
            f"{results_dir} has no result file of any of {len(names):,} frames; "
            f"{elsewhere or 'name the folder of the results'}"
        )
    capitals = capital_suffixes((path.name for path in results_dir.iterdir()), missing)
    if capitals:
        raise ValueError(f"{results_dir}: {capitals}")
    return missing


def _read_frame(results: Path | None, labels: Path) -> tuple[KittiObjects, KittiObjects]:
    labelled = read_labels(labels)
    if results is None:
        return parse_objects(b"", labels, with_scores=True), labelled
    found = read_results(results)
    if len(found) * len(labelled) > _MAX_PAIRS:
        raise FileError(
            results,
            f"holds {len(found):,} results for the {len(labelled):,} labels of {labels}, more than "
            f"{_MAX_PAIRS:,} pairs",
            "write one file for each frame, and only its best results",
        )
    return found, labelled


def frame_names(labels_dir: Path, sample_list: Path | str | Sequence[str] | None) -> Sequence[str]:
    """List the frames to score: those of a list, or all with labels.

    Raises:
        ValueError: There are none, the first is not of labels, or the list is invalid.
    """
    if sample_list is not None:
        return read_sample_list(sample_list, _data_root(labels_dir))
    if not labels_dir.is_dir():
        raise ValueError(f"{shown_place(labels_dir)} is no folder; give the folder of the labels")
    names = _text_names(labels_dir)
    if not names:
        below = next(filter(Path.is_dir, (labels_dir / each for each in LABEL_PLACES)), None)
        remedy = locate_frame_files(labels_dir, ()) or "give KITTI's folder label_2"
        entries = [each for each in sorted(labels_dir.iterdir()) if not is_leftover(each.name)]
        deeper = next(filter(_has_labels, folders_below(entries)), None)
        if deeper is not None:
            remedy = f"there are labels in {deeper}; name that folder"
        if below is not None:
            remedy = f"it is a data set, whose labels are in {below}; name that folder"
        raise ValueError(f"{labels_dir} has no label files (*.txt); {remedy}")
    read_labels(labels_dir / f"{names[0]}.txt")  # other texts are no frames that lack results
    return names


def _text_names(folder: Path) -> list[str]:
    """List the names of the texts in a folder that may be labels."""
    files = list_files(folder, (".txt",)).values()
    named = [path for path in files if path.suffix == ".txt" and path.name.lower() != TIMES_NAME]
    return [path.stem for path in named if not is_note(path.stem)]


def _has_labels(folder: Path) -> bool:
    """Test if the first text in a folder is of labels, not of a calibration or of readings."""
    first = next((folder / f"{name}.txt" for name in _text_names(folder)), None)
    return read_or_note(read_labels, first, []) is not None


def _data_root(labels_dir: Path) -> Path:
    """Folder of the data set with these labels, which may have its own lists of frames."""
    is_address = url_of(Path(str(labels_dir))) is not None  # also of a path in shards
    places = (labels_dir,) if is_address else (labels_dir.absolute(), labels_dir.resolve())
    for folder in (data_path(place).parent for place in places):
        if is_split(folder):
            return folder.parent
        if is_recording(folder):
            return folder
    return places[0].parent.parent


def _batches(
    frames: Iterable[tuple[KittiObjects, KittiObjects]],
) -> Iterator[list[tuple[KittiObjects, KittiObjects]]]:
    """Group frames into batches, smaller if the frames have many objects."""
    batch: list[tuple[KittiObjects, KittiObjects]] = []
    num_pairs = 0
    for found, labels in frames:
        batch.append((found, labels))
        num_pairs += len(found) * len(labels)
        if len(batch) == _FRAMES_AT_A_TIME or num_pairs > _MAX_PAIRS:
            yield batch
            batch, num_pairs = [], 0
    if batch:
        yield batch
