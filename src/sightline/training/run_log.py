"""Curves and pictures that a training has left in its run folder."""

import csv
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float64, Int64

from sightline.data.formats.image_file import decode_rgb, read_rgb
from sightline.files.extras import import_library
from sightline.files.problem import FileError

_EVENTS: Final = "events.out.tfevents.*"
_METRICS: Final = "metrics.csv"
_PICTURES: Final = "pictures"
_STEP: Final = "step"
_Entry = TypeVar("_Entry")
_REMEDY: Final = "remove it, or name the folder of another run"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LoggedSeries:
    """Values of one name over a training."""

    steps: Int64[np.ndarray, " num_values"]
    """Training steps, ascending."""
    values: Float64[np.ndarray, " num_values"]


@dataclass(frozen=True, kw_only=True, slots=True)
class LoggedPicture:
    """One picture of a series."""

    step: int
    """Training step."""
    content: bytes | Path
    """Contents of a PNG file, or its path."""
    source: Path
    """File that holds the picture."""

    def read(self) -> np.ndarray:
        """Decode the picture: RGB, uint8, height x width x 3.

        Raises:
            FileError: It is damaged.
        """
        if isinstance(self.content, Path):
            return read_rgb(self.content)
        return decode_rgb(self.content, self.source)


@dataclass(frozen=True, kw_only=True, slots=True)
class RunLog:
    """Logged values and pictures of a run by name, such as training/total and validation/0."""

    series: Mapping[str, LoggedSeries]
    pictures: Mapping[str, tuple[LoggedPicture, ...]]
    """Series of pictures by ascending step."""


def read_run_log(folder: Path) -> RunLog:
    """Read what a training has logged: TensorBoard's event files, or metrics.csv and pictures.

    A resumed run repeats the steps since its last checkpoint, and checkpoints may be scored later
    (`sightline validate`): of several entries for one step the one that was written last counts.

    Args:
        folder: Run folder, or a folder of its loggers.

    Raises:
        ValueError: The folder has no such files, or one is damaged.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; name the run folder of a training")
    events = sorted(folder.rglob(_EVENTS))
    tables = sorted(folder.rglob(_METRICS))
    if not events and not tables:
        raise ValueError(
            f"{folder} holds no {_EVENTS} and no {_METRICS}, which a training logs; name the run "
            "folder of `sightline fit`"
        )
    values: dict[str, list[tuple[int, float]]] = {}
    pictures: dict[str, list[tuple[int, LoggedPicture]]] = {}
    for parent in sorted({path.parent for path in events}):
        _read_events(parent, values, pictures)
    for path in tables:
        _read_table(path, values)
    for path in sorted(folder.rglob(f"{_PICTURES}/**/*.png")):
        if path.stem.isdecimal():
            name = path.parent.as_posix().rpartition(f"{_PICTURES}/")[2]
            step = int(path.stem)
            picture = LoggedPicture(step=step, content=path, source=path)
            pictures.setdefault(name, []).append((step, picture))
    return RunLog(
        series={name: _series(each) for name, each in values.items()},
        pictures={
            name: tuple(picture for _, picture in _without_repeated(each))
            for name, each in pictures.items()
        },
    )


def _read_events(
    folder: Path,
    values: dict[str, list[tuple[int, float]]],
    pictures: dict[str, list[tuple[int, LoggedPicture]]],
) -> None:
    """Add the scalars and pictures of a folder of event files, in the order of writing."""
    module = import_library("tensorboard.backend.event_processing.event_accumulator", "train")
    events = module.EventAccumulator(str(folder), size_guidance={"scalars": 0, "images": 0})
    try:
        events.Reload()
        tags = events.Tags()
        for name in tags["scalars"]:
            entries = sorted(events.Scalars(name), key=lambda each: each.wall_time)
            values.setdefault(name, []).extend((each.step, each.value) for each in entries)
        for name in tags["images"]:
            for each in sorted(events.Images(name), key=lambda each: each.wall_time):
                picture = LoggedPicture(
                    step=each.step, content=each.encoded_image_string, source=folder
                )
                pictures.setdefault(name, []).append((each.step, picture))
    except Exception as error:  # protobuf and TensorBoard raise nearly any exception
        raise FileError(folder, "holds event files that cannot be read", _REMEDY) from error


def _read_table(path: Path, values: dict[str, list[tuple[int, float]]]) -> None:
    """Add the columns of Lightning's CSV logger; empty cells are left out."""
    try:
        with path.open(newline="") as file:
            for row in csv.DictReader(file):
                step = int(np.int64(int(row[_STEP])))
                for name, cell in row.items():
                    if name != _STEP and cell:
                        values.setdefault(name, []).append((step, float(cell)))
    except (OSError, KeyError, TypeError, ValueError, OverflowError, csv.Error) as error:
        raise FileError(path, "is no table of a CSV logger with a column step", _REMEDY) from error


def _series(entries: Iterable[tuple[int, float]]) -> LoggedSeries:
    kept = [(step, value) for step, value in _without_repeated(entries) if math.isfinite(value)]
    return LoggedSeries(
        steps=np.array([step for step, _ in kept], dtype=np.int64),
        values=np.array([value for _, value in kept], dtype=np.float64),
    )


def _without_repeated(entries: Iterable[tuple[int, _Entry]]) -> list[tuple[int, _Entry]]:
    """Sort entries by step; of several of one step the last one stays."""
    return sorted(dict(entries).items())
