"""Writer of imported recordings, frame by frame."""

import re
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.checks.between_frames import check_orientations
from sightline.data.checks.entry_checks import describe_grey
from sightline.data.checks.recording_checks import (
    describe_recording,
    examine_recording_frame,
    view_of_drive,
)
from sightline.data.datasets.newer_frames import changed_at
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import CalibrationMatrices, check_intrinsics
from sightline.data.formats.point_files import checked_cloud
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    recording_calibration_text,
)
from sightline.data.formats.rings import turned_in_order
from sightline.data.formats.velodyne import write_sweep
from sightline.data.importing.frames import Rigid
from sightline.data.layouts.frame_lists import TIMES_NAME
from sightline.data.layouts.kitti_trees import find_file, list_files
from sightline.data.layouts.recording_files import (
    CALIBRATION_SUFFIXES,
    CALIBRATIONS,
    IMAGES,
    LABELS,
    POINTS,
    check_times,
    list_recording,
)
from sightline.files.atomic import atomic_write_text
from sightline.files.problem import FileError, Problem, plain_line
from sightline.geometry.echoes import echoes
from sightline.geometry.intensity_checks import exceeds_scale, intensity_doubt
from sightline.geometry.tilt import Tilt
from sightline.jobs.output_dirs import check_outside_dataset

RESULTS = (f"{IMAGES}/*", f"{POINTS}/*", f"{LABELS}/*", f"{CALIBRATIONS}*", TIMES_NAME)
"""File patterns of an import."""
_ANNOTATIONS_REMEDY = (
    "correct the sample's annotations (sizes are width, length, height; each object has one row) "
    "and the rotations of calibrated_sensor (quaternions w, x, y, z), or extract nuScenes' "
    "metadata archive again"
)
_NUMBER: Final = re.compile(r"\d[\d.e+-]*")
MAX_BRIGHT_SHARE: Final = 0.1
"""Largest share of a sweep's points above the scale of intensities that may be retroreflectors."""
STRAIGHT_NOTE: Final = "--undistort has no effect: by the calibration images are not distorted"


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportReport:
    """Report of an import; `str` formats it in lines for the user."""

    out: Path
    written: int
    skipped: int
    """Number of existing frames."""
    notes: tuple[str, ...]
    """Notes on the topics, on pairs and dropped data, and on the fit of the calibration."""

    def __str__(self) -> str:
        """Format the notes, then the numbers."""
        skipped = f"{self.skipped} were there already"
        return "\n".join(
            map(plain_line, (*self.notes, f"{self.out}: {self.written} frames written, {skipped}"))
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class CloudTally:
    """Counts of dropped points; `+` adds the counts of several clouds."""

    clouds: int = 0
    points: int = 0
    not_finite: int = 0
    """Points with non-finite x, y or z."""
    no_echo: int = 0
    """Points at the LiDAR's origin."""
    no_intensity: int = 0
    """Kept points with a non-finite intensity."""
    empty: tuple[str, ...] = ()
    """Frames without a remaining point."""
    doubts: tuple[tuple[str, str, str], ...] = ()
    """Frames with doubtful intensities, each with the problem and its remedy."""
    bright: tuple[str, ...] = ()
    """Frames whose intensities were limited to the scale."""

    @classmethod
    def count(
        cls,
        name: str,
        sweep: Float32[np.ndarray, "num_points 4"],
        kept: Float32[np.ndarray, "num_echoes 4"],
        doubt: tuple[str, str] | None,
        *,
        is_bright: bool,
    ) -> "CloudTally":
        """Count a frame's points before and after the removal of points without an echo.

        Args:
            name: Name of the frame.
            sweep: Points as read.
            kept: Points with an echo.
            doubt: Doubt about their intensities.
            is_bright: Whether these were limited to the scale.
        """
        lost = len(sweep) - len(kept)
        not_finite = int((~np.isfinite(sweep[:, :3]).all(axis=1)).sum()) if lost else 0
        lacks_intensity = np.isfinite(sweep[:, :3]).all(axis=1) & ~np.isfinite(sweep[:, 3])
        return cls(
            clouds=1,
            points=len(sweep),
            not_finite=not_finite,
            no_echo=lost - not_finite,
            no_intensity=int(lacks_intensity.sum()),
            empty=() if len(kept) else (name,),
            doubts=() if doubt is None else ((name, *doubt),),
            bright=(name,) if is_bright else (),
        )

    def __add__(self, other: "CloudTally") -> "CloudTally":
        """Return the sums."""
        return CloudTally(
            clouds=self.clouds + other.clouds,
            points=self.points + other.points,
            not_finite=self.not_finite + other.not_finite,
            no_echo=self.no_echo + other.no_echo,
            no_intensity=self.no_intensity + other.no_intensity,
            empty=self.empty + other.empty,
            doubts=self.doubts + other.doubts,
            bright=self.bright + other.bright,
        )

    def lines(self, max_intensity: float) -> tuple[str, ...]:
        """Return lines for the user; empty if nothing was dropped or limited."""
        lines = []
        if self.not_finite or self.no_echo:
            lines.append(
                f"dropped {self.not_finite + self.no_echo} of {self.points} points: "
                f"{self.not_finite} not finite, {self.no_echo} at the LiDAR's origin"
            )
        if self.no_intensity:
            is_all = self.no_intensity == self.points - self.not_finite - self.no_echo
            lines.append(
                f"warning: all {self.no_intensity} points have a non-finite intensity: their "
                "reflectance is 0; let the driver write intensities"
                if is_all
                else f"{self.no_intensity} points have a non-finite intensity: 0 is used"
            )
        if self.empty:
            lines.append(
                f"warning: {len(self.empty)} of {self.clouds} sweeps have no point left, e.g. that "
                f"of frame {self.empty[0]}"
                + (": the recording has only images" if len(self.empty) == self.clouds else "")
            )
        if self.bright:
            lines.append(
                f"warning: {len(self.bright)} sweeps, e.g. that of frame {self.bright[0]}, have "
                f"more than one point in a hundred above {max_intensity:g}, the intensity of a "
                "reflectance of 1, which these points get; import again to another folder with "
                "--max-intensity, if the LiDAR's scale is larger"
            )
        return (*lines, *self._lines_of_doubts())

    def _lines_of_doubts(self) -> Iterator[str]:
        """Yield a line for each kind of doubtful intensities; numbers make no kind."""
        kinds: dict[str, list[tuple[str, str, str]]] = {}
        for each in self.doubts:
            kinds.setdefault(_NUMBER.sub("", each[1]), []).append(each)
        for found in kinds.values():
            name, problem, remedy = found[0]
            is_usual = 2 * len(found) > self.clouds - len(self.empty)
            yield (
                f"warning: in {len(found)} of {self.clouds} sweeps, e.g. that of frame {name}, "
                f"{problem}; "
                + (remedy if is_usual else "look at what the LiDAR delivered in these frames")
            )


def count_echoes(
    name: str,
    sweep: Float32[np.ndarray, "num_points 4"],
    max_intensity: float,
    source: Path | str,
    *,
    max_bright_share: float = MAX_BRIGHT_SHARE,
) -> tuple[Float32[np.ndarray, "num_echoes 4"], CloudTally]:
    """Select a frame's points with an echo, with reflectances in [0, 1]; also returns the counts.

    Args:
        name: Name of the frame.
        sweep: Points as read.
        max_intensity: Intensity of a reflectance of 1.
        source: File or topic of the sweep.
        max_bright_share: Largest share of brighter points, up to which they are limited to it.

    Raises:
        FileError: See `checked_cloud`.
    """
    kept = echoes(sweep)
    doubt = intensity_doubt(kept, max_intensity) if kept[:, 3].any() else None
    is_above = kept[:, 3] > max_intensity
    is_bright = exceeds_scale(is_above) and bool(is_above.mean() <= max_bright_share)
    if is_bright:
        kept[is_above, 3] = max_intensity
    points = checked_cloud(kept, max_intensity, source, warn_losses=False)
    return points, CloudTally.count(name, sweep, points, doubt, is_bright=is_bright)


def check_not_into_source(source: Path, out: Path) -> None:
    """Refuse an output folder inside the source or containing the source.

    Raises:
        ValueError: One folder is inside the other.
    """
    check_outside_dataset(source, [out])
    if source.resolve().is_relative_to(out.resolve()):
        raise ValueError(
            f"{out} contains the source {source}; name an output folder beside it, so that their "
            "files do not mix"
        )


@contextmanager
def collected_warnings(notes: list[str]) -> Iterator[None]:
    """Add each warning within the block to the notes once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        yield
    for each in caught:
        note = f"warning: {each.message}"
        if note not in notes:
            notes.append(note)


@contextmanager
def staging_folder() -> Iterator[Path]:
    """Temporary folder for a first frame, which is checked before the recording is written."""
    with TemporaryDirectory(prefix="sightline-import-") as folder:
        yield Path(folder)


def unusable_error(doubt: Problem) -> FileError:
    """Error for a doubt of `staged_doubt`."""
    problem = f"gives an unusable recording: it {doubt.problem}"
    return FileError(doubt.path, problem, doubt.remedy)


def staged_doubt(
    folder: Path,
    source: Path,
    *,
    points: Path | None = None,
    objects: Path | None = None,
    calibration_remedy: str | None = None,
) -> Problem | None:
    """Check the frame in a folder with the checks of the recording's reader.

    Args:
        folder: A recording of one frame.
        source: Source of the frame, named in the doubt instead of the frame's files.
        points: Source of its cloud. None: `source`.
        objects: nuScenes' table of its labels. None: `source`.
        calibration_remedy: Remedy for a faulty calibration. None: that of the check.

    Returns:
        The first doubt; None: the frame can be read and is plausible.
    """
    (frame,) = list_recording(folder).frames
    assert frame.calibration is not None, "it was written"
    try:
        calibration = read_recording_calibration(frame.calibration)
        size = calibration.image_size if frame.image is None else read_image_size(frame.image)
        intrinsics = calibration.matrices.image_from_camera[:, :3]
        doubts = check_intrinsics(intrinsics, size, frame.calibration, usual=False)
        found = examine_recording_frame(frame, reference=None)
        doubts = doubts or [
            each
            for each in found.all()
            # the calibration's fit is reported when all is written, intensities as read
            if each.path != frame.calibration and each not in found.doubtful_intensities
        ]
    except FileError as error:
        doubts = [error.problem]
    if not doubts:
        return None
    problem, remedy = doubts[0].problem, doubts[0].remedy
    if doubts[0].path == frame.objects and objects is not None:
        source, remedy = objects, _ANNOTATIONS_REMEDY
        problem = f"{problem} (frame {frame.sample_id})"
    elif doubts[0].path == frame.points and points is not None:
        source = points
    elif doubts[0].path == frame.calibration and calibration_remedy is not None:
        remedy = calibration_remedy
    return Problem(path=source, problem=problem, remedy=remedy)


def turned_calibration(
    calibration: RecordingCalibration, new_from_old: Rigid
) -> RecordingCalibration:
    """Transform a calibration for clouds transformed by `new_from_old`."""
    matrices = CalibrationMatrices(
        image_from_camera=calibration.matrices.image_from_camera,
        camera_from_lidar=calibration.matrices.camera_from_lidar @ np.linalg.inv(new_from_old),
    )
    tilt = calibration.lidar_tilt
    if tilt is not None:
        tilt = Tilt.from_up(new_from_old[:3, :3] @ tilt.up)
    return replace(calibration, matrices=matrices, lidar_tilt=tilt)


def source_calibration(calibration: RecordingCalibration) -> RecordingCalibration:
    """Transform a calibration that an import wrote to the clouds of its source; else unchanged."""
    if calibration.clouds_from_source is None:
        return calibration
    source_from_clouds = np.eye(4)
    source_from_clouds[:3, :3] = calibration.clouds_from_source.T
    turned = turned_calibration(calibration, source_from_clouds)
    return replace(turned, clouds_from_source=None)


def moved_cloud(
    points: Float32[np.ndarray, "num_points 4"], new_from_old: Rigid
) -> Float32[np.ndarray, "num_points 4"]:
    """Transform a cloud by `new_from_old`; restores KITTI's order if the cloud had it."""
    new_points = points.copy()
    positions = points[:, :3].astype(np.float64) @ new_from_old[:3, :3].T + new_from_old[:3, 3]
    new_points[:, :3] = positions
    is_turned = not np.allclose(new_from_old[:3, :3], np.eye(3))
    return turned_in_order(points, new_points) if is_turned else new_points


def write_cloud(out: Path, name: str, points: Float32[np.ndarray, "num_points 4"]) -> None:
    """Write a frame's cloud."""
    write_sweep(out / POINTS / f"{name}.bin", points)


def write_or_keep_calibration(
    out: Path, calibration: RecordingCalibration, names: Collection[str]
) -> tuple[str, ...]:
    """Write the calibration of all frames, unless the user changed that of an earlier run.

    Returns:
        A note if it is kept: it has other contents or another suffix, or each frame has its own.
    """
    path = list_files(out, CALIBRATION_SUFFIXES).get(CALIBRATIONS)
    texts = (calibration, replace(calibration, clouds_from_source=None))  # as of earlier versions
    if path is not None and path.read_bytes() not in (
        recording_calibration_text(each).encode() for each in texts
    ):
        return (f"{path.name} differs from that of the bag, and is kept",)
    if path is None and set(names) <= set(list_files(out / CALIBRATIONS, CALIBRATION_SUFFIXES)):
        return (f"each frame has its own calibration in {CALIBRATIONS}, which is kept",)
    if path is None:
        write_calibration(out, calibration)
    return ()


def write_calibration(
    out: Path, calibration: RecordingCalibration, name: str | None = None
) -> None:
    """Write the calibration of all frames, or of one."""
    path = f"{CALIBRATIONS}.yaml" if name is None else f"{CALIBRATIONS}/{name}.yaml"
    atomic_write_text(out / path, recording_calibration_text(calibration))


def write_or_keep_times(
    out: Path, times_s: Mapping[str, float | Decimal], *, left_out: Collection[str] = ()
) -> tuple[str, ...]:
    """Write the time of each frame, unless the user changed those of an earlier run.

    Args:
        out: Folder of the recording.
        times_s: Times of all frames of the source.
        left_out: Names of the frames without a line.

    Returns:
        A note if they are kept.
    """
    lines = {name: f"{name} {seconds:.9f}" for name, seconds in times_s.items()}
    path = find_file(out, TIMES_NAME)
    if path is not None and not set(path.read_bytes().splitlines()) <= {
        line.encode() for line in lines.values()
    }:
        return (f"{path.name} differs from the times of the source, and is kept",)
    kept = (f"{line}\n" for name, line in lines.items() if name not in left_out)
    atomic_write_text(path or out / TIMES_NAME, "".join(kept))
    return ()


def names_present(out: Path, *folders: str) -> set[str]:
    """Names of the frames with a file in each folder.

    An empty image, which copies on a full disk leave behind, does not count; clouds without a point
    and labels without an object are empty.
    """
    return set.intersection(
        *(
            {
                path.stem
                for path in (out / name).glob("*")
                if name != IMAGES or path.is_symlink() or path.stat().st_size
            }
            for name in folders
        )
    )


def describe_newer_sources(out: Path, changed_s: Mapping[str, float]) -> tuple[str, ...]:
    """Warn of kept frames whose source is newer than their cloud, by times of modification.

    Args:
        out: Folder of the recording.
        changed_s: Time of the last modification of each kept frame's source.
    """
    clouds = {path.stem: path for path in (out / POINTS).glob("*")}
    older = [name for name in sorted(changed_s) if changed_s[name] > changed_at(clouds[name])]
    if not older:
        return ()
    return (
        f"warning: of {len(changed_s)} frames that were there already, {len(older)} are older than "
        f"their source, the first is {older[0]}: the source was changed or copied since; to "
        f"import them anew, name another folder or remove {out}",
    )


def remove_incomplete(out: Path, names: Collection[str]) -> None:
    """Remove images without a readable cloud, and vice versa: each would count as a frame."""
    for folder in (IMAGES, POINTS):
        for path in sorted((out / folder).glob("*")) if names else ():
            if path.stem in names:
                path.unlink()


def describe_view(out: Path) -> tuple[str, ...]:
    """Lines on the fit of the written calibration, with warnings of it, times and images."""
    files = list_recording(out)
    frames = files.frames
    view = view_of_drive(frames)
    doubts = [] if view is None or view.doubt is None else [view.doubt]
    if files.times is not None:
        doubts += check_times(files.times, [frame.sample_id for frame in frames])
    described = describe_recording(frames)
    doubts += described.doubts
    remarks = (
        *doubts,
        *describe_grey(frame.image for frame in frames),
        *check_orientations(frames),
    )
    return (*described.clauses, *(f"warning: {remark}" for remark in remarks))
