"""Archive for KITTI's object benchmark: a result file for each frame."""

import re
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from sightline.data.checks.result_boxes import SCORED_CLASSES
from sightline.data.checks.result_checks import doubts_about_results
from sightline.data.formats.kitti_labels import (
    CLASS_NAMES,
    MAX_LABEL_BYTES,
    KittiObjects,
    parse_objects,
    sequence_fault,
)
from sightline.data.layouts.frame_lists import (
    describe_left_out,
    read_sample_list,
    require_frame_files,
)
from sightline.data.layouts.kitti_trees import list_files
from sightline.files.atomic import atomic_path
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened, without_marks
from sightline.files.problem import FileError
from sightline.files.shard_path import data_path
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date of a zip file
_PLAIN_FILE = 0o100644 << 16
_UNIX = 3
_CLASSES = {name.lower() for name in (*CLASS_NAMES, "DontCare")}  # the benchmark ignores case
_REMEDY = "write an empty file for a frame without detections, or give a list of the frames"


@named_arguments
def write_submission(results: Path, out: Path, *, sample_list: str | Path | None = None) -> int:
    """Check all result files and pack them; return the number of frames.

    The archive has NNNNNN.txt of each frame at its root, in order, without dates, so that the same
    results give the same bytes; byte order marks are left out. It is written atomically. Warns of
    results that are probably of another convention than KITTI's: 2D boxes that the 3D boxes or
    KITTI's cameras contradict, order of sizes, centres for bottoms, frame, angles, units, scores.

    Args:
        results: Folder with one result file per frame, 16 fields per line; empty without
            detections. Other files and subfolders are left out; without
            `sample_list` with a warning, except hidden ones and .json.
        out: The archive, .zip.
        sample_list: List of the frames for `read_sample_list`; its root is the parent folder of
            `results`. None: all frames with a file.

    Raises:
        ValueError: `out` is no .zip, no file has a detection of a scored class, or a frame has no
            file, a name that is not six digits, or an invalid result file, such as with an unknown
            class or a box whose end is before its start; contains the position.
    """
    if out.suffix.lower() != ".zip":
        raise ValueError(f"{out} does not end in .zip, which the benchmark requires; rename it")
    results = data_path(results)
    names = _frame_names(results, sample_list)
    contents, frames = [], []
    for name in names:
        path = results / f"{name}.txt"
        content = read_bytes(path, max_bytes=MAX_LABEL_BYTES, remedy=_REMEDY)
        content = without_marks(content, path)  # the benchmark would read one as part of the class
        objects = parse_objects(content, path, with_scores=True)
        _check_objects(path, objects)
        contents.append(content)
        frames.append(objects)
    classes = {name.lower() for frame in frames for name in frame.class_names}
    if classes.isdisjoint(map(str.lower, SCORED_CLASSES)):
        found = f", only {', '.join(sorted(classes))}" if classes else ""
        raise ValueError(
            f"{results} has no detection of a class that the benchmark scores "
            f"({', '.join(SCORED_CLASSES)}) in any of its {len(frames):,} result files{found}: "
            "check whether the detector ran, its classes and its score threshold"
        )
    for doubt in doubts_about_results(frames):
        warn_user(f"{results}: {doubt}")
    with atomic_path(out) as temporary, ZipFile(temporary, "w") as archive:
        for name, content in zip(names, contents, strict=True):
            entry = ZipInfo(f"{name}.txt", date_time=_EPOCH)
            entry.create_system, entry.external_attr = _UNIX, _PLAIN_FILE
            archive.writestr(entry, content, compress_type=ZIP_DEFLATED, compresslevel=9)
    return len(contents)


def _frame_names(results: Path, sample_list: str | Path | None) -> list[str]:
    if sample_list is not None:
        names = sorted(read_sample_list(sample_list, results.absolute().parent))
        require_frame_files(results, names, "result", _REMEDY)
    else:
        require_frame_files(results, [], "result", _REMEDY)
        files = list_files(results, (".txt",)).values()
        names = [path.stem for path in files if path.suffix == ".txt"]
        left_out = describe_left_out(results)
        if not names:
            but = f" but {left_out}" if left_out else ""
            raise ValueError(
                f"{results} has no result files (*.txt){but}; give their folder, with "
                "names NNNNNN.txt in lower case"
            )
        if left_out:
            warn_user(
                f"{results}: left out of the archive: {left_out}; the benchmark expects only "
                "NNNNNN.txt in one folder",
            )
    for name in names:
        if not re.fullmatch("[0-9]{6}", name):
            raise _misnamed(results / f"{name}.txt")
    return names


def _misnamed(path: Path) -> FileError:
    """Error for a file without the name of a frame."""
    tracked = sequence_fault(path)
    if tracked is not None:
        return FileError(path, *tracked)
    return FileError(
        path,
        "is not named by six digits as in the benchmark",
        "rename it, or move it to another folder",
    )


def _check_objects(path: Path, objects: KittiObjects) -> None:
    """Refuse valid values that the benchmark would count as false or ignore."""
    for number, name in enumerate(objects.class_names, start=1):
        if name.lower() not in _CLASSES:
            raise FileError(
                path,
                f"object {number} is of class {shortened(repr(name))}, which is no class of KITTI",
                "write Car, Pedestrian or Cyclist",
            )
    left, top, right, bottom = objects.boxes2d.T
    is_inverted = (right < left) | (bottom < top)
    if is_inverted.any():
        number = int(is_inverted.argmax())
        box = " ".join(f"{value:g}" for value in objects.boxes2d[number])
        raise FileError(
            path,
            f"object {number + 1} has the box {box}, whose maximum is below its minimum",
            "write x_min, y_min, x_max and y_max",
        )
