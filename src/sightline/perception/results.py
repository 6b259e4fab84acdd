"""Reader of result files for pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, shown_place
from sightline.files.safe_names import checked_name
from sightline.files.shard_path import data_path
from sightline.geometry.user_warning import warn_user
from sightline.inference.predictor import Output
from sightline.jobs.output_dirs import MANIFEST_NAME, read_claim
from sightline.joining.models import JOINED
from sightline.perception.kept_lines import LINES_FOLDER, read_line
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.objects import Objects
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import REGISTRY, find_task, task_names

JOB_NAME: Final = "perceive"
"""Name of the job in the manifest of a folder with results of several tasks."""

ALIGNMENT: Final = "alignment"
"""Entry of a manifest: state of the LiDAR's mount, if there was something to undo."""

_FIRST: Final = -1  # position of the lines: other files are read with the calibration they tell
_MAX_NAME_LENGTH: Final = 500  # characters: a folder and its parent, 255 bytes each


@dataclass(frozen=True, kw_only=True, slots=True)
class ResultFolder:
    """Folder with one kind of result files."""

    folder: Path
    name: str
    """Kind of result, e.g. depth."""
    suffix: str
    """Suffix of the files, with its dot."""
    read: Callable[[Path, CameraLidarSample, Perception], Perception]
    """See `Output.read`."""
    made_by: str = ""
    """Name of the weights or the method; empty: unknown."""
    data: str = ""
    """Name of the source data by `dataset_title`; empty: unknown."""
    further: str = ""
    """See `Output.further`."""
    position: int = 0
    """Index among the outputs of its task: further ones add to the first."""

    def path(self, name: str) -> Path:
        """File of a frame."""
        return self.folder / f"{name}{self.suffix}"


def open_results(folders: Sequence[Path]) -> tuple[ResultFolder, ...]:
    """Find drawable results in folders from `perceive`, `predict` or other programs.

    A folder's sightline.json describes its files. Without it, all tasks that write the same suffix
    read them: .txt as KITTI's results in 2D and 3D, .png as depth maps. Outputs that are not drawn,
    such as gates, are ignored. Packed results are read from their shards.

    Raises:
        ValueError: A folder is missing or contains nothing to draw, or two contain the same kind of
            results.
    """
    opened: list[ResultFolder] = []
    for folder in map(data_path, folders):
        if not folder.is_dir():
            raise ValueError(f"{shown_place(folder)} is no folder; give one of result files")
        claim = read_claim(folder)
        found = _claimed_results(folder, claim) if claim else _results_by_suffix(folder)
        if not found and claim is None and (folder / MANIFEST_NAME).is_file():
            raise FileError(
                folder / MANIFEST_NAME,
                "is damaged, so that the results beside it are unknown",
                "write them again, or give the folder of each task",
            )
        if not found and any((folder / "data").glob("*.txt")):
            raise ValueError(
                f"{folder} holds no results that can be drawn: they are in {folder / 'data'}, as "
                "KITTI's own program writes them; name that folder"
            )
        if not found:
            raise ValueError(
                f"{folder} holds no results that can be drawn; give a folder that perceive or "
                "predict has written, of result files (.txt) or of depth maps (.png)"
            )
        _check_once(opened, found)
        opened += found
    return tuple(sorted(opened, key=lambda each: each.position))


def _check_once(opened: Sequence[ResultFolder], found: Sequence[ResultFolder]) -> None:
    """Refuse duplicate kinds of results in folders with manifests."""
    for new in found:
        for old in opened:
            if new.read is old.read and new.made_by and old.made_by:
                raise ValueError(
                    f"{old.folder} and {new.folder} both hold {new.name} of one task, but "
                    "a picture shows only one; leave one out"
                )


def read_perception(results: Sequence[ResultFolder], sample: CameraLidarSample) -> Perception:
    """Read the results of a sample; empty if they have no file of it.

    If they tell of an `undone_turn`, draw them on the sample without it (`undo_turn`).

    Raises:
        ValueError: A file is damaged or has another image size.
    """
    perception = Perception()
    for each in results:
        path = each.path(sample.sample_id)
        if path.is_file():
            turn = perception.undone_turn or LidarTurn()
            perception = each.read(path, undo_turn(sample, turn), perception)
    return perception


def _read_objects(path: Path, sample: CameraLidarSample, perception: Perception) -> Perception:
    """Add the joined objects of a frame's line, and the rotation undone before.

    Raises:
        FileError: The file does not hold a line of the frame.
    """
    line = read_line(path)
    if line is None:
        raise FileError(
            path,
            f"does not hold the line of frame {sample.sample_id} as perceive wrote it",
            "remove it, and run perceive again",
        )
    rows, turn = line["objects"], line.get("undone_turn")
    return replace(
        perception,
        objects=None if rows is None else Objects.from_json(rows),
        undone_turn=None if turn is None else LidarTurn(**turn),
    )


def _claimed_results(folder: Path, claim: dict[str, object]) -> list[ResultFolder]:
    """Results described by the folder's manifest."""
    folders = claim.get("folders")
    if claim.get("job") == JOB_NAME and isinstance(folders, list):
        source = folder / MANIFEST_NAME
        names = [checked_name(name, source, "folders:") for name in folders]
        parts = [(folder / name, read_claim(folder / name)) for name in dict.fromkeys(names)]
        found = [each for part, inner in parts if inner for each in _task_results(part, inner)]
        lost = [part.name for part, inner in parts if inner is None]
        if lost:
            warn_user(
                f"{source} lists {', '.join(lost)}, without a readable {MANIFEST_NAME} there: not "
                "drawn; run perceive again, or give the folder of each task",
            )
        if found and ((folder / JOINED).is_dir() or ALIGNMENT in claim):
            found.append(
                ResultFolder(
                    folder=folder / LINES_FOLDER,
                    name="objects",
                    suffix=".json",
                    read=_read_objects,
                    position=_FIRST,
                )
            )
        return found
    if claim.get("job") == JOB_NAME and folders is None:  # joined objects, as detectors write
        data = shortened(str(claim.get("data", "")), _MAX_NAME_LENGTH)
        return [replace(each, data=data) for each in _results_by_suffix(folder)]
    return _task_results(folder, claim)


def _task_results(folder: Path, claim: dict[str, object]) -> list[ResultFolder]:
    """Results of one task, described by their manifest."""
    task_name, output_name = claim.get("task"), claim.get("output")
    if not isinstance(task_name, str) or task_name not in REGISTRY:
        return []
    outputs = find_task(task_name).outputs
    made_by = shortened(str(claim.get("method", "")), _MAX_NAME_LENGTH)
    data = shortened(str(claim.get("data", "")), _MAX_NAME_LENGTH)
    return [
        replace(each, made_by=made_by, data=data, position=position)
        for position, output in enumerate(outputs)
        if output.name == output_name
        for each in _readable(folder, output)
    ]


def _results_by_suffix(folder: Path) -> list[ResultFolder]:
    """Results identified by file suffix, without a manifest."""
    outputs = [find_task(name).outputs[0] for name in task_names()]
    return [
        each
        for output in outputs
        if next(folder.glob(f"*{output.suffix}"), None) is not None
        for each in _readable(folder, output)
    ]


def _readable(folder: Path, output: Output) -> list[ResultFolder]:
    """List the folder of an output, if its files can be drawn."""
    if output.read is None:
        return []
    return [
        ResultFolder(
            folder=folder,
            name=output.name,
            suffix=output.suffix,
            read=output.read,
            further=output.further,
        )
    ]
