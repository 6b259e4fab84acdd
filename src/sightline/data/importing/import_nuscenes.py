"""Import of nuScenes' key frames of a camera and the LiDAR as a recording with labels."""

import glob
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.datasets.newer_frames import changed_at
from sightline.data.formats.image_header import IMAGE_SUFFIXES
from sightline.data.formats.kitti_calibration import CalibrationMatrices, check_intrinsics
from sightline.data.formats.kitti_labels import write_objects
from sightline.data.formats.recording_calibration import (
    Lens,
    RecordingCalibration,
    checked_matrices,
)
from sightline.data.formats.undistortion import COEFFICIENTS, LensModel, check_lens
from sightline.data.importing.frames import Rigid
from sightline.data.importing.nuscenes import Moment, Moments, Tables
from sightline.data.importing.nuscenes_files import (
    FrameContents,
    checked_image_header,
    missing_file,
    read_frame,
    read_or_note_damage,
)
from sightline.data.importing.nuscenes_labels import LabelTally, kitti_from_annotations
from sightline.data.importing.nuscenes_mounts import CloudTurns
from sightline.data.importing.nuscenes_tables import REMEDY
from sightline.data.importing.writer import (
    RESULTS,
    STRAIGHT_NOTE,
    CloudTally,
    ImportReport,
    check_not_into_source,
    describe_newer_sources,
    describe_view,
    moved_cloud,
    names_present,
    remove_incomplete,
    staged_doubt,
    staging_folder,
    turned_calibration,
    unusable_error,
    write_calibration,
    write_cloud,
    write_or_keep_times,
)
from sightline.data.layouts.recording_files import (
    CALIBRATION_SUFFIXES,
    CALIBRATIONS,
    IMAGES,
    LABELS,
    POINTS,
    begins_sequence,
)
from sightline.files.atomic import atomic_link
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, Problem
from sightline.geometry.road_height import MAX_TILT_DEG
from sightline.geometry.tilt import Tilt
from sightline.jobs.output_dirs import acquire_output_dir, data_name
from sightline.jobs.progress import track

_MIN_TILT_DEG: Final = 3.0
"""Smallest tilt of a LiDAR that moves boxes; nuScenes' is tilted by 1.4 degrees."""
_MIN_STEP_US: Final = 4_000
"""Smallest time between two key frames; nuScenes' are half a second apart."""
_MAX_GAP_S: Final = 0.15
"""Largest time between image and sweep; a turn of nuScenes' LiDAR takes 0.05 s, others' 0.1 s."""
_MAX_TRIED_FRAMES: Final = 5
"""Number of frames tried at the start: if all are doubtful or unreadable, nothing is written."""
_TABLES_REMEDY: Final = f"correct calibrated_sensor.json or {REMEDY}"


def import_nuscenes(
    tables: Tables,
    out: Path,
    *,
    camera: str,
    lidar: str,
    max_intensity: float,
    undistort: bool,
) -> ImportReport:
    """Import key frames; arguments and errors as in `import_recording`."""
    check_not_into_source(tables.root, out)
    key_frames = tables.moments(camera, lidar)
    listed = key_frames.moments
    missing = {each.name: fault for each in listed if (fault := missing_file(each)) is not None}
    moments = [each for each in listed if each.name not in missing]
    if not moments:
        raise _no_files_error(tables.root, listed, camera, lidar)
    _check_time_unit(moments, tables.folder / "sample_data.json")
    settings = {
        "sightline": version("sightline"),
        "source": data_name(tables.folder),
        "tables": tables.digest(),
        "camera": camera,
        "lidar": lidar,
        "max_intensity": max_intensity,
    }
    _check_first_sizes(moments)  # a wrong size in the tables looks like a wrong calibration
    for moment in moments:
        _calibration(moment)
    lens = next((moment.lens for moment in moments if moment.lens), ())
    if lens and not undistort:
        raise _distorting_lens_error(tables.folder, camera, lens)
    turns = CloudTurns.find(moments, max_intensity)
    doubts = _first_doubts(moments, max_intensity, turns, tables)
    acquire_output_dir(out, settings, results=RESULTS)
    times_s = {moment.name: moment.time_s for moment in listed}
    finished = names_present(out, POINTS)  # a frame's cloud is written last
    absent = missing.keys() - finished
    kept_times = write_or_keep_times(out, times_s, left_out=absent)
    frames = _Frames(out, max_intensity, turns)
    frames.is_labelled = any(
        moment.annotations and (moment.name in finished or frames.read(moment))
        for moment in listed
        if moment.name not in absent
    )
    folders = (CALIBRATIONS, IMAGES, POINTS, *((LABELS,) if frames.is_labelled else ()))
    complete = names_present(out, *folders)
    pending = [moment for moment in moments if moment.name not in complete]
    changed_s = {
        moment.name: max(changed_at(moment.image), changed_at(moment.sweep))
        for moment in moments
        if moment.name in complete
    }
    for moment in track(pending, description="importing"):
        frames.write(moment)
    dropped = frames.faults.keys() - finished
    if dropped:
        remove_incomplete(out, dropped)
        write_or_keep_times(out, times_s, left_out=absent | dropped)
    faults = missing | frames.faults
    written = len(pending) - len(frames.faults)
    there = [moment for moment in listed if moment.name not in absent | dropped]
    return ImportReport(
        out=out,
        written=written,
        skipped=len(there) - written,
        notes=(
            f"{len(there)} key frames of {camera} and {lidar}, {tables.folder.name}",
            *kept_times,
            *((STRAIGHT_NOTE,) if undistort and not lens else ()),
            *_scene_notes(there),
            *_dropped_notes(key_frames, absent, dropped, faults),
            *describe_newer_sources(out, changed_s),
            *_kept_notes((faults.keys() & finished) - complete, faults, len(there)),
            *_time_notes(there),
            *turns.notes(there, camera),
            *(
                (*_label_notes(tables, frames.labels), *_unannotated_notes(there))
                if written
                else ()
            ),
            *frames.clouds.lines(max_intensity),
            *doubts,
            *describe_view(out),
        ),
    )


def _no_files_error(root: Path, moments: Sequence[Moment], camera: str, lidar: str) -> ValueError:
    """Error for key frames that all lack their image or sweep."""
    files = {camera: [each.image for each in moments], lidar: [each.sweep for each in moments]}
    absent = {
        channel: next((path for path in paths if not path.is_file()), None)
        for channel, paths in files.items()
    }
    channels = [channel for channel, path in absent.items() if path is not None]
    remedy = f"extract the archives with {' and '.join(channels)} into it"
    folders = {path.relative_to(root).parts[0] for path in absent.values() if path is not None}
    renamed = [
        f"{shortened(each.name)} to {folder}"
        for folder in sorted(folders)
        for each in sorted(root.glob(f"*_{glob.escape(folder)}"))  # as Kaggle packs Lyft's
        if each.is_dir() and not (root / folder).exists()
    ]
    if renamed:
        remedy = f"rename {' and '.join(renamed)}, as the tables have them, or {remedy}"
    return ValueError(
        f"{root} lacks files of all {len(moments)} key frames of {camera} and {lidar}, e.g. "
        f"{absent[channels[0]]}; {remedy}"
    )


def _distorting_lens_error(folder: Path, camera: str, lens: tuple[float, ...]) -> ValueError:
    coefficients = ", ".join(f"{value:.4g}" for value in lens)
    return ValueError(
        f"{folder}: the lens of {camera} distorts ({coefficients}); undistort images by --undistort"
    )


def _check_time_unit(moments: Sequence[Moment], path: Path) -> None:
    """Raise a FileError if all sweeps of a scene are too close for times in microseconds."""
    steps_us = [
        1e6 * (after.time_s - before.time_s)
        for before, after in pairwise(moments)
        if not begins_sequence(before.name, after.name)
    ]
    if 0 < (longest_us := max(steps_us, default=0)) < _MIN_STEP_US:
        raise FileError(
            path,
            f"has sweeps of up to {longest_us:.3g} microseconds after the one before, so its "
            "timestamps are probably in seconds or milliseconds",
            "write microseconds in sample.json and sample_data.json",
        )


def _scene_notes(moments: Sequence[Moment]) -> Iterator[str]:
    """Yield a note on several scenes in one recording."""
    names = [moment.name for moment in moments]
    num_scenes = 1 + sum(begins_sequence(*pair) for pair in pairwise(names))
    if num_scenes > 1:
        yield (
            f"{num_scenes} scenes follow each other, told apart by the names of their frames; the "
            "alarms of `sightline health` go on from one to the next"
        )


def _dropped_notes(
    key_frames: Moments,
    absent: Collection[str],
    unreadable: Collection[str],
    faults: Mapping[str, FileError],
) -> Iterator[str]:
    """Yield notes on left-out key frames of the tables, with counts.

    Args:
        key_frames: Key frames of the tables.
        absent: Names of those without an image or sweep.
        unreadable: Names of those whose image or sweep cannot be read.
        faults: Errors by name.
    """
    if absent:
        yield (
            f"dropped {len(absent)} of {len(key_frames.moments)} key frames, whose image or "
            "sweep is missing"
        )
    if unreadable:
        name = min(unreadable)
        yield (
            f"warning: dropped {len(unreadable)} of {len(key_frames.moments)} key frames, whose "
            f"image or sweep cannot be read; the first, {name}: {faults[name]}"
        )
    if key_frames.num_invalid:
        yield f"dropped {key_frames.num_invalid} images and sweeps that the tables call invalid"
    if key_frames.num_incomplete:
        yield f"dropped {key_frames.num_incomplete} samples without a key frame of each channel"
    if key_frames.num_repeated:
        yield f"dropped {key_frames.num_repeated} repeated key frames of a sample and channel"
    if key_frames.other_lidars:
        others = ", ".join(map(shortened, key_frames.other_lidars))
        yield f"other LiDARs are left out: {others}; choose one by --lidar-topic"


def _kept_notes(
    kept: Collection[str], faults: Mapping[str, FileError], num_frames: int
) -> Iterator[str]:
    """Yield a warning of frames of an earlier run that can no longer be written anew."""
    if kept:
        name = min(kept)
        yield (
            f"warning: {len(kept)} of {num_frames} frames stay as imported before, without the "
            "files that they lack, as their image or sweep is missing or cannot be read; the "
            f"first, {name}: {faults[name]}"
        )


def _time_notes(moments: Sequence[Moment]) -> Iterator[str]:
    """Yield a warning of images that were taken long before or after their sweep."""
    gaps_s = {each.name: abs(each.image_time_s - each.time_s) for each in moments}
    apart = [name for name, gap_s in gaps_s.items() if gap_s > _MAX_GAP_S]
    if apart:
        yield (
            f"warning: {len(apart)} of {len(moments)} images were taken more than {_MAX_GAP_S:g} s "
            f"before or after their sweep, e.g. {apart[0]} by {gaps_s[apart[0]]:.3g} s: moving "
            "objects are elsewhere in it; correct the timestamps in sample_data.json, or choose "
            "other channels"
        )


def _label_notes(tables: Tables, labels: LabelTally) -> tuple[str, ...]:
    """Counts of labels, or a warning that the tables of annotations are missing."""
    absent = tables.absent_annotation_tables()
    if labels.annotations or not absent:
        return labels.lines()
    return (
        f"warning: {tables.folder.name} lacks {', '.join(absent)}, so the frames have no labels; "
        f"if they are annotated, {REMEDY}",
    )


def _unannotated_notes(moments: Sequence[Moment]) -> Iterator[str]:
    """Yield a warning of frames without annotations among frames with some."""
    names = [moment.name for moment in moments if not moment.annotations]
    if 0 < len(names) < len(moments):
        yield (
            f"warning: {len(names)} of {len(moments)} frames have no annotation and get empty "
            f"label files, e.g. {names[0]}: they count as frames without objects; if they were "
            "not annotated, train and score by a sample list of the other frames"
        )


def _first_doubts(
    moments: Sequence[Moment], max_intensity: float, turns: CloudTurns, tables: Tables
) -> tuple[str, ...]:
    """Check frames up to the first plausible one, and describe the doubts of those before.

    Raises:
        FileError: Some first frames are all doubtful or unreadable.
    """
    doubts: list[Problem] = []
    faults: dict[str, FileError] = {}
    for moment in moments[:_MAX_TRIED_FRAMES]:
        with staging_folder() as staged:
            trial = _Frames(staged, max_intensity, turns)
            trial.write(moment)
            faults |= trial.faults
            if trial.faults:
                continue
            doubt = staged_doubt(
                staged,
                moment.image,
                points=moment.sweep,
                objects=tables.folder / "sample_annotation.json",
            )
        if doubt is None:
            return tuple(f"warning: {each}" for each in doubts)
        doubts.append(doubt)
    raise unusable_error(doubts[0]) if doubts else next(iter(faults.values()))


@dataclass(slots=True)
class _Frames:
    """Writer of a frame's files; the cloud comes last and marks complete frames."""

    out: Path
    max_intensity: float
    turns: CloudTurns
    is_labelled: bool = True
    """Frames get label files, as the tables hold annotations."""
    labels: LabelTally = field(default_factory=LabelTally)
    clouds: CloudTally = field(default_factory=CloudTally)
    faults: dict[str, FileError] = field(default_factory=dict)
    """Errors of the frames that are not written, by name."""

    def read(self, moment: Moment) -> FrameContents | None:
        """Read a frame's image and sweep, or note why they are unusable."""
        return read_or_note_damage(
            lambda each: read_frame(each, self.max_intensity), moment, self.faults
        )

    def write(self, moment: Moment) -> None:
        """Write a frame, or note why its image or sweep is unusable: then nothing is written."""
        if moment.name in self.faults or (contents := self.read(moment)) is None:
            return
        new_from_old, _ = self.turns.of(moment)
        calibration = turned_calibration(_calibration(moment), new_from_old)
        points = moved_cloud(contents.echoes, new_from_old)
        lidar_from_world = new_from_old @ np.linalg.inv(moment.world_from_lidar)
        level_from_lidar = _level_from_lidar(moment.tilt, new_from_old)
        objects, tally = kitti_from_annotations(
            moment.annotations,
            _levelled(calibration.matrices, level_from_lidar),
            level_from_lidar @ lidar_from_world,
            contents.header.size,
            moved_cloud(points, level_from_lidar),
        )
        labels = self.out / LABELS / f"{moment.name}.txt"
        calibrations = (f"{moment.name}{suffix}" for suffix in CALIBRATION_SUFFIXES)
        if not any((self.out / CALIBRATIONS / name).exists() for name in calibrations):
            write_calibration(self.out, calibration, moment.name)  # else perhaps corrected
        if self.is_labelled and not labels.exists():
            write_objects(labels, objects)
        suffix = moment.image.suffix
        if suffix.lower() not in IMAGE_SUFFIXES:  # else no command reads it
            suffix = f".{contents.header.file_format}"
        atomic_link(self.out / IMAGES / f"{moment.name}{suffix}", moment.image)
        write_cloud(self.out, moment.name, points)
        self.labels += tally
        self.clouds += contents.clouds


def _check_first_sizes(moments: Sequence[Moment]) -> None:
    """Raise the FileError of the first image, unless one of the first few has its size."""
    faults: dict[str, FileError] = {}
    first = moments[:_MAX_TRIED_FRAMES]
    if not any(read_or_note_damage(checked_image_header, moment, faults) for moment in first):
        raise next(iter(faults.values()))


def _level_from_lidar(tilt: Tilt, new_from_old: Rigid) -> Rigid:
    """Rotation to the frame of upright boxes.

    It is the identity if the LiDAR is nearly level, or tilted so much that its rotation is probably
    wrong.

    Args:
        tilt: Tilt of the LiDAR in the data.
        new_from_old: Turn of its clouds.
    """
    turned = Tilt.from_up(new_from_old[:3, :3] @ tilt.up)
    is_used = _MIN_TILT_DEG <= turned.angle_deg <= MAX_TILT_DEG
    return turned.level_from_lidar if is_used else np.eye(4)


def _levelled(matrices: CalibrationMatrices, level_from_lidar: Rigid) -> CalibrationMatrices:
    camera_from_level = matrices.camera_from_lidar @ level_from_lidar.T
    return replace(matrices, camera_from_lidar=camera_from_level)


def _calibration(moment: Moment) -> RecordingCalibration:
    """Calibration of a frame, with the checks of the recording's reader.

    Raises:
        FileError: It is no valid calibration of a camera and a LiDAR.
    """
    camera = np.pad(np.array(moment.camera_matrix), ((0, 0), (0, 1)))
    try:
        matrices = checked_matrices(camera, moment.camera_from_lidar)
    except ValueError as error:
        raise FileError(moment.image, f"is unusable: its {error}", _TABLES_REMEDY) from error
    doubts = check_intrinsics(camera[:, :3], moment.image_size, moment.image, usual=False)
    if doubts:
        problem = f"is unusable: its calibration {doubts[0].problem}"
        raise FileError(moment.image, problem, _TABLES_REMEDY)
    return RecordingCalibration(
        matrices=matrices, lens=_lens(moment), lidar_height_m=moment.lidar_height_m
    )


def _lens(moment: Moment) -> Lens | None:
    """Lens of a frame's camera; None: it does not distort.

    Raises:
        FileError: It is no valid lens.
    """
    if not moment.lens:
        return None
    is_short = len(moment.lens) in COEFFICIENTS["plumb_bob"]
    model: LensModel = "plumb_bob" if is_short else "rational_polynomial"
    try:
        check_lens(model, moment.lens)
    except ValueError as error:
        problem = f"is unusable: {error} (camera_distortion in calibrated_sensor.json)"
        raise FileError(moment.image, problem, _TABLES_REMEDY) from error
    return Lens(model=model, coefficients=moment.lens)
