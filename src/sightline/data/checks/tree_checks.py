"""Data set trees in a folder, with their missing files and their checks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from sightline.data.checks.between_frames import (
    check_depth_frames,
    check_drive_frames,
    check_object_frames,
    check_recording_frames,
    describe_flat_labels,
)
from sightline.data.checks.drive_calibration import drive_matrices_doubts, unread_calibration
from sightline.data.checks.entry_checks import describe_grey
from sightline.data.checks.frame_checks import (
    Findings,
    examine_depth_frame,
    examine_drive_frame,
    examine_object_frame,
)
from sightline.data.checks.guessed_size import describe_guessed_size
from sightline.data.checks.lidar_mount import (
    describe_lost_points,
    describe_pose,
    drive_pose_doubts,
    stated_mount_doubts,
)
from sightline.data.checks.other_layouts import misnamed_split, refuse_other_layouts
from sightline.data.checks.recording_checks import (
    check_recording_calibration,
    describe_recording,
    examine_recording_frame,
    is_without_camera,
    reference_images,
)
from sightline.data.checks.unread_files import (
    PartFolder,
    depth_folders,
    describe_other_sensors,
    drive_folders,
    find_name_clashes,
    find_unread,
    object_folders,
    recording_folders,
)
from sightline.data.formats.kitti_calibration import (
    read_drive_pose,
    read_object_matrices,
    read_raw_matrices,
)
from sightline.data.layouts.depth_trees import (
    DRIVE_SPLITS,
    OTHER_CAMERA,
    SELECTIONS,
    raw_gaps,
    split_by_drives,
)
from sightline.data.layouts.drive_poses import check_oxts
from sightline.data.layouts.drive_times import check_drive_times
from sightline.data.layouts.kitti_trees import (
    CORRUPTED,
    NO_LABELS_REMEDY,
    RAW_CALIBRATION,
    DepthFrame,
    DriveFiles,
    DriveFrame,
    DriveSplit,
    ObjectFrame,
    Part,
    SelectedSplit,
    describe_absent,
    describe_raw_drives,
    find_velodyne,
    list_drive,
    list_drive_frames,
    list_object_frames,
    list_selected_frames,
    named_in_two_ways,
    part_folder,
    selection_folder,
    shared_calibration_remedy,
)
from sightline.data.layouts.recording_files import (
    CALIBRATIONS,
    DEPTH,
    IMAGES,
    LABELS,
    POINTS,
    RecordingFiles,
    check_times,
    is_recording,
    lacks_calibration,
    list_recording,
    order_doubt,
    unpaired,
    unused_files,
)
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, Problem, plain_line, read_or_note
from sightline.files.safe_names import unusable_names

TRACKLETS = "tracklet_labels.xml"
"""File with labels of a raw drive, in their own format."""
_MAX_GAPS = 5  # missing files of a part that are told one by one
_REMEDY = "extract the archive again"
_DRIVE_REMEDY = f"{_REMEDY}, or name a list of the other frames if it lacks the file"
_RECORDING_REMEDY = "add the missing files in a format of docs/recordings.md"

Frame = TypeVar("Frame", ObjectFrame, DepthFrame, DriveFrame)


@dataclass(frozen=True, kw_only=True, slots=True)
class Check:
    """Check of one frame, or of data shared by all frames."""

    subject: str
    """Subject of the check, e.g. "frame 000042"."""
    run: Callable[[], list[Problem]]


@dataclass(frozen=True, kw_only=True, slots=True)
class PartCount:
    """Number of frames with a part."""

    name: str
    """KITTI's name of the part, e.g. "velodyne"."""
    num_files: int


@dataclass(frozen=True, kw_only=True, slots=True)
class TreeSummary:
    """Summary of one tree of a data set; `str` formats it as one line."""

    folder: Path
    kind: str
    """Kind of the frames, e.g. "object frames"."""
    num_frames: int
    parts: tuple[PartCount, ...]
    note: str = ""
    """Further remark, in one clause."""

    def __str__(self) -> str:
        """Format the folder, its number of frames and of the files of each part."""
        parts = ", ".join(f"{part.name} {part.num_files}" for part in self.parts)
        note = f"; {self.note}" if self.note else ""
        return plain_line(f"{self.folder}: {self.num_frames} {self.kind} ({parts}){note}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Tree:
    """Tree of a data set: frames, missing files, and a check for each frame."""

    summary: TreeSummary
    gaps: tuple[Problem, ...]
    checks: tuple[Check, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _ExpectedPart:
    """Part that every frame should have."""

    attribute: str
    """Attribute of a frame with the part."""
    folder: Path
    suffix: str = ""
    """Suffix of files named like the frame; empty: the files have other names."""
    optional: bool = False
    """Whether a tree may lack the part, such as a tree without a folder of labels."""


def find_trees(root: Path) -> list[Tree]:
    """Find all recordings and KITTI's trees in a folder, in a fixed order."""
    try:
        refuse_other_layouts(root)
    except FileError:
        return []
    object_trees = [_object_tree(root / split) for split in ("training", "testing")]
    by_drives = split_by_drives(root)
    splits = [(root, split) for split in DRIVE_SPLITS] if by_drives is None else [by_drives]
    # Both are the same folder if `root` is itself a selection.
    by_folder = {selection_folder(root, split): split for split in SELECTIONS}
    others = [
        *(_drives_tree(place, split) for place, split in splits),
        *(_selection_tree(root, folder, split) for folder, split in by_folder.items()),
        _raw_drive_tree(root),
        _recording_tree(root),
    ]
    if not any(object_trees):
        object_trees = [_object_tree_of_one_split(root, is_other=any(others))]
    return [tree for tree in (*object_trees, *others) if tree is not None]


def _object_tree_of_one_split(root: Path, *, is_other: bool) -> Tree | None:
    """Tree of a folder that is a split; none of another data set with folders of such names."""
    is_other = is_other or lacks_calibration(root)
    if is_other and not any((root / name).is_dir() for name in ("image_2", "velodyne")):
        return None
    if not (root / "calib").is_dir() and list_drive(root).calibration is not None:
        return None
    tree, misnamed = _object_tree(root), misnamed_split(root)
    return tree if tree is None or misnamed is None else replace(tree, gaps=(misnamed, *tree.gaps))


def _object_tree(folder: Path) -> Tree | None:
    if not any((folder / name).is_dir() for name in ("image_2", "calib", "label_2")):
        return None
    suffixes: dict[Part, str] = {"image": ".png", "points": ".bin", "calibration": ".txt"}
    if folder.name != "testing":
        suffixes["objects"] = ".txt"
    if (folder / "depth").is_dir():  # a simulation, possibly without a camera
        suffixes["depth"] = ".png"
        if not (folder / "image_2").is_dir():
            del suffixes["image"]
    # Some trees have only sweeps cropped to the image's view; if both exist, both are checked.
    reduced = (folder / "velodyne_reduced").is_dir()
    velodyne = find_velodyne(folder)
    frames = list(list_object_frames(folder, suffixes, velodyne).values())
    checks = _frame_checks(examine_object_frame, frames)
    if reduced and velodyne == "velodyne":
        points: tuple[Part, ...] = ("points",)
        others = list_object_frames(folder, points, "velodyne_reduced").values()
        checks += _frame_checks(examine_object_frame, list(others))
    checks.append(_between_frames(partial(check_object_frames, frames, folder)))
    expected = [
        _ExpectedPart(
            attribute=part,
            folder=folder / part_folder(part, velodyne),
            suffix=suffix,
            optional=part != "calibration",
        )
        for part, suffix in suffixes.items()
    ]
    tree = _tree(folder, "object frames", frames, expected, checks)
    calibration_file = next(
        (each.calibration for each in frames if each.points and each.calibration), None
    )
    if tree is not None:
        doubts = (
            Problem(path=folder / "calib", problem=each.problem, remedy=each.remedy)
            for each in stated_mount_doubts(frames)
        )
        renamed = named_in_two_ways(folder, frames, velodyne)  # instead of all missing files
        tree = replace(tree, gaps=(*(tree.gaps if renamed is None else (renamed,)), *doubts))
    matrices = read_or_note(read_object_matrices, calibration_file, [])
    try:
        tree = _with_notes(tree, *describe_lost_points(frames), *describe_pose(frames, matrices))
    except FileError as error:
        tree = tree and replace(tree, gaps=(*tree.gaps, error.problem))
    tree = _with_notes(tree, *describe_guessed_size(frames, matrices))
    return _with_unread(tree, object_folders(folder, velodyne))


def _drives_tree(root: Path, split: DriveSplit) -> Tree | None:
    expected = [
        _ExpectedPart(attribute=attribute, folder=root / split / "*" / "proj_depth" / name)
        for attribute, name in (("sparse", "velodyne_raw"), ("truth", "groundtruth"))
    ]
    frames = list_drive_frames(root, split, root, ("image_02", "image_03"))
    checks = _frame_checks(examine_depth_frame, frames)
    checks.append(_between_frames(partial(check_depth_frames, frames)))
    tree = _tree(root / split, "depth frames", frames, expected, checks)
    if tree is None:
        return None
    tree = replace(tree, gaps=(*tree.gaps, *raw_gaps(root, split, frames)))
    notes = describe_raw_drives(root)
    others = sum(frame.camera == OTHER_CAMERA for frame in frames)
    if others:
        notes = (f"other commands leave out the {others:,} of {OTHER_CAMERA}", *notes)
    return _with_unread(_with_notes(tree, *notes), depth_folders(root, split))


def _selection_tree(root: Path, folder: Path, split: SelectedSplit) -> Tree | None:
    names = {"image": "image", "sparse": "velodyne_raw", "intrinsics": "intrinsics"}
    if folder.name.startswith("val") or (folder / "groundtruth_depth").is_dir():
        names["truth"] = "groundtruth_depth"
    expected = [
        _ExpectedPart(attribute=attribute, folder=folder / name)
        for attribute, name in names.items()
    ]
    frames = list_selected_frames(root, split)
    checks = _frame_checks(examine_depth_frame, frames)
    checks.append(_between_frames(partial(check_depth_frames, frames)))
    tree = _tree(folder, "depth frames", frames, expected, checks)
    return _with_unread(tree, depth_folders(root, split))


def _raw_drive_tree(folder: Path) -> Tree | None:
    files = list_drive(folder)
    if not (files.image_folder.is_dir() or files.calibration is not None):
        return None
    expected = [
        _ExpectedPart(attribute=attribute, folder=place, suffix=suffix, optional=True)
        for attribute, place, suffix in (
            ("image", files.image_folder, ".png"),
            ("points", files.points_folder, ".bin"),
        )
    ]
    read_calibration = partial(_check_raw_calibration, folder, files)
    checks = [Check(subject="the calibration", run=read_calibration)]
    if files.timestamps is not None and files.frames:
        checks.append(Check(subject=files.timestamps.name, run=partial(check_drive_times, files)))
    if files.oxts is not None and files.frames:
        checks.append(Check(subject="the readings of oxts", run=partial(check_oxts, files)))
    matrices = read_or_note(read_raw_matrices, files.calibration, [])
    checks += _frame_checks(partial(examine_drive_frame, matrices=matrices), files.frames)
    checks.append(_between_frames(partial(check_drive_frames, files.frames)))
    tree = _tree(folder, "raw frames", files.frames, expected, checks, remedy=_DRIVE_REMEDY)
    stated = read_or_note(read_drive_pose, files.calibration, [])
    pose = () if stated is not None else describe_pose(files.frames, matrices)
    tree = _with_notes(tree, *describe_lost_points(files.frames), *pose)
    tree = _with_notes(tree, *describe_guessed_size(files.frames, matrices))
    if (folder / TRACKLETS).is_file():
        tree = _with_notes(tree, f"{TRACKLETS} is not read: a raw drive has no labels")
    return _with_unread(tree, drive_folders(folder))


def _recording_tree(folder: Path) -> Tree | None:
    if not is_recording(folder):
        return None
    files = list_recording(folder)
    frames = files.frames
    expected = [
        _ExpectedPart(
            attribute=attribute, folder=folder / name, optional=attribute != "calibration"
        )
        for attribute, name in (
            ("image", IMAGES),
            ("points", POINTS),
            ("calibration", CALIBRATIONS),
            ("objects", LABELS),
            ("depth", DEPTH),
        )
        if attribute != "image" or not is_without_camera(frames)
    ]
    checks = _recording_checks(files)
    checks.append(_between_frames(partial(check_recording_frames, frames)))
    tree = _tree(folder, "frames", frames, expected, checks, remedy=_RECORDING_REMEDY)
    if tree is None:
        return None
    misnamed = unpaired(folder, frames)
    if misnamed is not None:  # instead of all missing files
        tree = replace(tree, gaps=(misnamed,))
    unused = (problem for _, problem in unused_files(folder, frames))
    order = order_doubt(folder, frames)
    tree = replace(tree, gaps=(*tree.gaps, *unused, *([] if order is None else [order])))
    described = describe_recording(frames)
    tree = replace(tree, gaps=(*tree.gaps, *described.doubts))
    tree = _with_notes(tree, *described.clauses)
    return _with_unread(tree, recording_folders(folder))


def _with_notes(tree: Tree | None, *notes: str) -> Tree | None:
    """Add clauses to the tree's summary."""
    if tree is None:
        return None
    note = "; ".join(filter(None, (tree.summary.note, *notes)))
    return replace(tree, summary=replace(tree.summary, note=note))


def _with_unread(tree: Tree | None, folders: Sequence[PartFolder]) -> Tree | None:
    """Add a problem for each folder with ignored files, instead of its gaps.

    Files that are hidden by another one come after them; further sensors are told in the summary.
    """
    tree = _with_notes(tree, *describe_other_sensors(folders))
    if tree is None:
        return None
    unread = find_unread(folders)
    unread_folders = {each.problem.path for each in unread if each.all_unread}
    gaps = [gap for gap in tree.gaps if not {gap.path, gap.path.parent} & unread_folders]
    clashes = find_name_clashes(folders)
    return replace(tree, gaps=(*(each.problem for each in unread), *gaps, *clashes))


def _recording_checks(files: RecordingFiles) -> list[Check]:
    references = reference_images(files.frames)
    checks = [
        Check(
            subject=f"calibration {path.name}",
            run=partial(check_recording_calibration, path, image),
        )
        for path, image in references.items()
    ]
    if files.times is not None:
        names = [frame.sample_id for frame in files.frames]
        run_times = partial(check_times, files.times, names)
        checks.append(Check(subject=files.times.name, run=run_times))
    for frame in files.frames:
        reference = None if frame.calibration is None else references.get(frame.calibration)
        run = partial(examine_recording_frame, frame, reference=reference)
        checks.append(_frame_check(frame, run))
    return checks


def _frame_checks(examine: Callable[[Frame], Findings], frames: Sequence[Frame]) -> list[Check]:
    return [_frame_check(frame, partial(examine, frame)) for frame in frames]


def _between_frames(run: Callable[[], list[Problem]]) -> Check:
    return Check(subject="agreement of frames", run=run)


def _frame_check(frame: Frame, examine: Callable[[], Findings]) -> Check:
    run = partial(_run_frame_check, examine, frame.image)
    return Check(subject=f"frame {shortened(frame.sample_id)}", run=run)


def _run_frame_check(examine: Callable[[], Findings], image: Path | None) -> list[Problem]:
    """Find all faults of a frame, and a blank image unless it was corrupted on purpose."""
    found = examine()
    if image is None or not found.has_blank_image or (image.parent.parent / CORRUPTED).is_dir():
        return found.all()
    problem = "has a single colour"
    remedy = "check whether the camera delivered pictures, or remove the file"
    return [Problem(path=image, problem=problem, remedy=remedy), *found.all()]


def _check_raw_calibration(drive: Path, files: DriveFiles) -> list[Problem]:
    folder = files.calibration
    if folder is None:
        path = drive / "calib_cam_to_cam.txt"
        remedy = f"{_REMEDY}, or make data that is not KITTI's a recording (docs/recordings.md)"
        return [Problem(path=path, problem="is missing, here and one folder up", remedy=remedy)]
    try:
        problems = drive_matrices_doubts(read_raw_matrices(folder), folder, files.first_image)
        problems += [
            Problem(path=folder / RAW_CALIBRATION[1], problem=each.problem, remedy=each.remedy)
            for each in drive_pose_doubts(files.frames, read_drive_pose(folder))
        ]
    except FileError as error:
        problems = [error.problem]
    return problems + unread_calibration(drive, folder)


def _gaps_of_part(
    part: _ExpectedPart, absent: Sequence[str], total: int, remedy: str
) -> list[Problem]:
    """Problems of missing files of a part: one for each frame, or one if there are many."""
    if len(absent) > _MAX_GAPS:
        problem = f"lacks files of {len(absent):,} of {total:,} frames: {describe_absent(absent)}"
        return [Problem(path=part.folder, problem=problem, remedy=remedy)]
    if part.suffix:
        paths = [part.folder / f"{sample_id}{part.suffix}" for sample_id in absent]
        return [Problem(path=path, problem="is missing", remedy=remedy) for path in paths]
    problems = [f"lacks a file of {sample_id}" for sample_id in absent]
    return [Problem(path=part.folder, problem=each, remedy=remedy) for each in problems]


def _tree(
    folder: Path,
    kind: str,
    frames: Sequence[ObjectFrame | DepthFrame | DriveFrame],
    expected: Sequence[_ExpectedPart],
    checks: Sequence[Check],
    *,
    remedy: str = _REMEDY,
) -> Tree | None:
    if not frames:
        return None
    misnamed = unusable_names(folder, (frame.sample_id for frame in frames))
    parts: list[PartCount] = []
    gaps = [] if misnamed is None else [misnamed]
    for part in expected:
        absent = [frame.sample_id for frame in frames if getattr(frame, part.attribute) is None]
        name = part.folder.parent.name if part.folder.name == "data" else part.folder.name
        parts.append(PartCount(name=name, num_files=len(frames) - len(absent)))
        if len(absent) == len(frames):
            if part.optional and not part.folder.exists():
                continue  # reported in the summary
            copying = shared_calibration_remedy(folder) if part.attribute == "calibration" else None
            problem = "holds no files of the frames"
            gaps.append(Problem(path=part.folder, problem=problem, remedy=copying or remedy))
        else:
            further = f", or {NO_LABELS_REMEDY}" if part.attribute == "objects" else ""
            gaps += _gaps_of_part(part, absent, len(frames), remedy + further)
    flat = describe_flat_labels([each for each in frames if isinstance(each, ObjectFrame)])
    return Tree(
        summary=TreeSummary(
            folder=folder,
            kind=kind,
            num_frames=len(frames),
            parts=tuple(parts),
            note="; ".join((*describe_grey(frame.image for frame in frames), *flat)),
        ),
        gaps=tuple(gaps),
        checks=tuple(checks),
    )
