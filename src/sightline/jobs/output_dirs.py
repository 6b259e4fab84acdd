"""Output folders: claimed by one configuration, apart from inputs."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.files.atomic import atomic_create_text, atomic_write_text, check_links
from sightline.files.byte_source import check_no_address
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened, shortened_pair
from sightline.files.problem import escaped
from sightline.files.shard_index import MANIFEST, index_path, read_manifest
from sightline.geometry.arguments import json_number

KITTI_SPLITS: Final = ("training", "testing")
"""Folders of KITTI's object data set; an output in one lies inside the data set, too."""
SELECTIONS_FOLDER: Final = "depth_selection"
"""Folder of the selections in a KITTI depth completion tree."""
_SELECTIONS: Final = ("val_selection_cropped", "test_depth_completion_anonymous")
_DRIVE_SPLITS: Final = ("train", "val")
"""Folders of drives in a KITTI depth completion tree."""
_DRIVE_DEPTH: Final = "proj_depth"
"""Folder of depth maps in a drive of such a tree."""
_DRIVE_PARTS: Final = ("groundtruth", "velodyne_raw")
_SPLIT_PARTS: Final = ("calib", "image_2", "label_2", "velodyne", "velodyne_reduced")
"""Folders that tell a split of KITTI's object data set from other folders of its name."""
_PARTS: Final = (
    *("calib", "depth", "groundtruth_depth", "image", "image_2", "images"),
    *("label_2", "labels", "points", "velodyne", "velodyne_raw"),
)
"""Folders of one part of a data set without splits."""
_SENSORS: Final = ("image", "image_2", "images", "points", "velodyne", "velodyne_raw")
_CALIBRATIONS: Final = (
    *("calib", "calibration", "intrinsics"),
    *("calibration.yaml", "calibration.yml", "calibration.json"),
)
"""Folders and files that, beside a sensor's folder, tell a data set."""

MANIFEST_NAME: Final = "sightline.json"
"""Manifest in an output folder: describes the source of the other files."""

RESULT_SUFFIXES: Final = (".txt", ".png")
"""Suffixes of result files."""

_WRITTEN_SUFFIXES = (*RESULT_SUFFIXES, ".csv", ".html", ".json", ".jsonl", ".md", ".yaml", ".yml")
# of files that commands write to folders; others, such as weights, are never replaced
_EMPTY_SUFFIXES = (".txt", ".bin")
_MAX_MANIFEST_BYTES = 2**22
_DIGESTS: Final = {
    "frames_sha256": "another list of frames",
    "files_digest": (
        "files of the data set that had other names or sizes (images, point clouds, labels, "
        "calibrations)"
    ),
}
"""Descriptions of differing digests, which by themselves tell users nothing."""
_MAX_DIFFERENCES = 12  # settings in an error message
_MAX_VALUE_LENGTH = 60  # characters of a setting in an error message


def acquire_output_dir(
    folder: Path,
    settings: Mapping[str, object],
    *,
    results: Sequence[str],
    manifest_name: str = MANIFEST_NAME,
) -> None:
    """Write the settings of a job to its folder, or check that the same settings are there.

    Of several jobs that claim a folder concurrently, on one machine or on several, one writes the
    manifest; jobs with the same settings share the folder and write identical files. The claim of a
    stopped job remains, so that its results are completed and never mixed with others.

    Args:
        folder: Output folder; created if missing.
        settings: Everything that the files' bytes depend on, except for the selection of files;
            plain JSON values.
        results: Patterns (`Path.glob`) of the files and folders that jobs write there.
        manifest_name: Name of the file with the settings.

    Raises:
        ValueError: The folder contains other settings or results of unknown source; or it cannot be
            written to, or contains links that lead outside (`check_links`).
    """
    if _is_claimed(folder, settings, results=results, manifest_name=manifest_name):
        return
    is_created = atomic_create_text(folder / manifest_name, _manifest(settings))
    if not is_created:  # another job was faster
        _is_claimed(folder, settings, results=results, manifest_name=manifest_name)


@dataclass(frozen=True, kw_only=True, slots=True)
class Claim:
    """Arguments of `acquire_output_dir`."""

    folder: Path
    settings: Mapping[str, object]
    results: Sequence[str]


def claim_folders(claims: Sequence[Claim]) -> None:
    """Claim all folders of a job, or none if one of them would be refused.

    Raises:
        ValueError: See `acquire_output_dir`.
    """
    for claim in claims:
        _is_claimed(claim.folder, claim.settings, results=claim.results)
    for claim in claims:
        acquire_output_dir(claim.folder, claim.settings, results=claim.results)


def renew_claims(claims: Sequence[Claim], entry: str) -> None:
    """Write another value of an entry into claims that exist, whose results are made anew."""
    for claim in claims:
        if (claim.folder / MANIFEST_NAME).exists() and differs_only_in(claim, entry):
            atomic_write_text(claim.folder / MANIFEST_NAME, _manifest(claim.settings))


def differs_only_in(claim: Claim, entry: str) -> bool:
    """Test if a folder has no claim, or the same but for the value of an entry."""
    held, now = read_claim(claim.folder), json.loads(_manifest(claim.settings))
    return held is None or {**held, entry: None} == {**now, entry: None}


def _is_claimed(
    folder: Path,
    settings: Mapping[str, object],
    *,
    results: Sequence[str],
    manifest_name: str = MANIFEST_NAME,
) -> bool:
    """Whether the folder has the same settings; raises for others, and for unclaimed results."""
    check_no_address(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder} is no folder; name another output folder")
    check_links(folder)
    if manifest_name != MANIFEST:
        check_no_shards(folder)
    elif (folder / MANIFEST_NAME).exists():  # readers of shards would not see its files
        raise ValueError(_refusal(folder, "files that are not in shards", MANIFEST_NAME))
    path = folder / manifest_name
    # In this order: a job writes its manifest before its first result.
    has_results = any(next(folder.glob(pattern), None) is not None for pattern in results)
    if not path.exists():
        if has_results:
            raise ValueError(_refusal(folder, f"data without a {manifest_name}", manifest_name))
        root = _data_root(folder.absolute())
        if folder.name in _PARTS and root != folder.absolute():
            raise ValueError(
                f"{folder} would be a part of the data set {root}, by its name; name another "
                "output folder"
            )
        if _holds_sensors(folder) or any(map(_has_part, (folder / s for s in KITTI_SPLITS))):
            raise ValueError(
                f"{folder} holds a data set, with which the files of this job would mix; name "
                "another output folder"
            )
        return False
    existing = _manifest_text(path)
    if existing != _manifest(settings):
        raise ValueError(_refusal(folder, _difference(existing, settings), manifest_name))
    return True


def check_no_shards(folder: Path) -> None:
    """Refuse files beside shards, whose readers would not see them.

    Raises:
        ValueError: The folder is one of shards.
    """
    if read_manifest(folder) is not None:
        raise ValueError(_refusal(folder, "shards", MANIFEST))


def _manifest_text(path: Path) -> str:
    remedy = "name another output folder, or remove the file"
    return read_bytes(path, max_bytes=_MAX_MANIFEST_BYTES, remedy=remedy).decode(errors="replace")


def _manifest(settings: Mapping[str, object]) -> str:
    return json.dumps(dict(settings), indent=2, default=json_number) + "\n"


def check_outputs(
    outputs: Mapping[str, Path | None],
    *,
    data: Iterable[Path | None],
    results: Iterable[Path | None] = (),
) -> None:
    """Refuse outputs that would change the inputs or each other, before any work.

    Args:
        outputs: Files and folders by their option; None: not requested.
        data: Inputs: data sets, folders in them or files; see `check_outside_dataset`.
        results: Folders of result files, or such a file: a report may be beside them, but must not
            replace one.

    Raises:
        ValueError: An output is in the data, is one of the results, is named twice, is an address,
            or is a folder with an input file that reports or results might replace.
    """
    taken: dict[Path, str] = {}
    places = {option: path for option, path in outputs.items() if path is not None}
    for option, path in places.items():
        check_no_address(path)
        other = taken.setdefault(path.resolve(), option)
        if other != option:
            raise ValueError(f"{other} and {option} are both {path}; give another path for one")
    for each in data:
        if each is not None:
            check_outside_dataset(each, places.values())
            _check_not_within(each, places)
    for folder in filter(None, results):
        for option, path in places.items():
            place = path.resolve()
            is_input = place == folder.resolve() or _is_result(place)
            if is_input and place.exists() and place.is_relative_to(folder.resolve()):
                raise ValueError(
                    f"{option} {path} is among the input results, which it would replace; "
                    "give another path"
                )


def _is_result(file: Path) -> bool:
    is_in_shard = file.with_suffix(".tar").exists()  # the tar, or its index
    is_named_so = file.suffix in RESULT_SUFFIXES or file.name in (MANIFEST_NAME, MANIFEST)
    return is_named_so or is_in_shard


def _check_not_within(file: Path, places: Mapping[str, Path]) -> None:
    if file.suffix.lower() not in _WRITTEN_SUFFIXES or file.is_dir():
        return
    for option, place in places.items():
        if not place.is_file() and file.resolve().is_relative_to(place.resolve()):
            raise ValueError(
                f"the input {file} lies in the output {option} {place}; use a copy of it "
                "elsewhere, or give another output path"
            )


def check_outside_dataset(data: Path, outputs: Iterable[Path]) -> None:
    """Refuse outputs inside a data set, where they would replace or become parts of it.

    Links are followed, including those in the data set.

    Args:
        data: The data set, one of its splits or of their folders; or an input file.
        outputs: Files and folders to write.

    Raises:
        ValueError: An output is the data set or file, lies in the data set, or is an address.
    """
    roots = {_data_root(data.absolute()), _data_root(data.resolve())}
    folders = {folder for root in roots for folder in (root, *(root / s for s in KITTI_SPLITS))}
    sources = roots | {path for folder in folders for path in _targets(folder)}
    for output in outputs:
        check_no_address(output)
        written = Path(os.path.normpath(output.absolute())), output.resolve()
        if any(path.is_relative_to(source) for path in written for source in sources):
            raise data_change_error(_data_root(data.absolute()), output)
        if output.is_file() and any(_links_to(root, output.resolve()) for root in roots):
            raise data_change_error(data, output)


def _data_root(data: Path) -> Path:
    """Root of a data set, from an object tree's split, or the folder of one part of any layout."""
    for split in (data, data.parent):
        if is_split(split):
            return split.parent
    for maps in data.parents:
        if maps.name == _DRIVE_DEPTH and any((maps / each).is_dir() for each in _DRIVE_PARTS):
            drive = maps.parent
            return drive.parent if drive.parent.name in _DRIVE_SPLITS else drive
    is_part = data.name in _PARTS and _is_data_set(data.parent)
    is_shard = data.suffix == ".tar" and index_path(data).is_file()
    return data.parent if is_part or is_shard else data


def is_split(folder: Path) -> bool:
    """Check if a folder is a split of an object tree, which may be packed into shards."""
    if folder.name not in KITTI_SPLITS:
        return False
    return _has_part(folder) or (folder.parent / MANIFEST).is_file()


def _has_part(split: Path) -> bool:
    return any((split / each).is_dir() for each in _SPLIT_PARTS)


def _is_data_set(folder: Path) -> bool:
    """Check if a folder is a data set: has shards, or images or clouds with a calibration."""
    return (folder / MANIFEST).is_file() or _holds_sensors(folder)


def _holds_sensors(folder: Path) -> bool:
    """Check if a folder has images or clouds with a calibration."""
    has_sensor = any((folder / each).is_dir() for each in _SENSORS)
    return has_sensor and any((folder / each).exists() for each in _CALIBRATIONS)


def _targets(folder: Path) -> Iterator[Path]:
    """Yield the targets of a folder and of the links in it."""
    yield folder.resolve()
    with suppress(OSError), os.scandir(folder) as entries:
        yield from (Path(entry.path).resolve() for entry in entries if entry.is_symlink())


def _links_to(root: Path, file: Path) -> bool:
    """Whether a file of a data set is a link to this file."""
    paths = (Path(folder, name) for folder, _, names in os.walk(root) for name in names)
    return any(path.is_symlink() and path.resolve() == file for path in paths)


def data_change_error(data: Path, output: Path) -> ValueError:
    """Error for an output that would change the input."""
    kind = "file" if data.is_file() else "data set"
    return ValueError(
        f"{output} cannot be written to, as that would change the {kind} {data}, which is an "
        "input; name a place beside it"
    )


def finished_names(folder: Path, suffix: str) -> frozenset[str]:
    """List the names of an output folder's finished files, without the suffix."""
    return frozenset(path.stem for path in folder.glob(f"*{suffix}") if is_finished(path))


def is_finished(path: Path) -> bool:
    """Whether an output file exists; files are written atomically, so an existing one is complete.

    Folders do not count, nor empty files, such as those that a copy on a full disk leaves behind;
    only texts without an object and sweeps without a point are empty.
    """
    return path.is_file() and (path.suffix in _EMPTY_SUFFIXES or path.stat().st_size > 0)


def read_claim(folder: Path, manifest_name: str = MANIFEST_NAME) -> dict[str, object] | None:
    """Read the manifest of a folder; None: there is none, or it is unreadable."""
    try:
        content = json.loads(_manifest_text(folder / manifest_name))
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def data_name(data: Path) -> str:
    """Name of the source data in a claim: the folder's name and its parent's.

    This distinguishes trees with equal names, such as a case of two corrupted data sets, and allows
    the same data at different paths on other machines. Shards have the name of the data that were
    packed into them, a selection of a depth completion tree that of the tree before its own.
    """
    manifest = read_manifest(Path(str(data)))  # also of a path in shards, which hold none
    if manifest is not None:
        return escaped(str(manifest["data"]))
    return escaped(_folder_name(data.resolve()))


def _folder_name(folder: Path) -> str:
    if folder.name in _SELECTIONS:
        return f"{_folder_name(folder.parent)}/{folder.name}"
    tree = folder.parent if folder.name == SELECTIONS_FOLDER else folder
    return "/".join(tree.parts[-2:])


def _refusal(folder: Path, held: str, manifest_name: str) -> str:
    return (
        f"{folder} holds {held}, which would mix with this job; name another output folder or "
        f"empty this one, its {manifest_name} too"
    )


def _difference(existing: str, settings: Mapping[str, object]) -> str:
    """Describe the differences between the folder's settings and this job's."""
    before = None
    with suppress(ValueError, RecursionError):
        before = json.loads(existing)
    if not isinstance(before, dict):
        return "a damaged manifest"
    described = list(_differences(before, json.loads(_manifest(settings))))
    if not described:
        return "files made with the same settings, written otherwise"
    more = len(described) - _MAX_DIFFERENCES
    beyond = [f"{more} more that differ"] if more > 0 else []
    return f"files made with {', '.join(described[:_MAX_DIFFERENCES] + beyond)}"


def _differences(before: Mapping[str, object], now: Mapping[str, object]) -> Iterator[str]:
    """Yield the differences by name, recursively in nested settings such as a task's."""
    for name in {**before, **now}:
        held, requested = before.get(name), now.get(name)
        if isinstance(held, dict) and isinstance(requested, dict):
            yield from (f"{name} {inner}" for inner in _differences(held, requested))
        elif held != requested and name in _DIGESTS and None not in (held, requested):
            yield _DIGESTS[name]
        elif held != requested:
            held_text, requested_text = shortened_pair(
                _text(held), _text(requested), _MAX_VALUE_LENGTH
            )
            yield f"{shortened(name)} {held_text} instead of {requested_text}"


def _text(value: object) -> str:
    if isinstance(value, dict):
        value = ", ".join(f"{name} {inner}" for name, inner in value.items())
    return "none" if value is None else str(value)
