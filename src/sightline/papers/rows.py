"""Rows of the papers' tables: the networks behind our figures, and the tables' layout."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.frame_lists import read_sample_list
from sightline.data.layouts.kitti_trees import Part, Velodyne, part_folder
from sightline.data.open import open_dataset
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import (
    DIFFICULTIES,
    ClassName,
    Metric,
    MinimumOverlaps,
)
from sightline.evaluation.object_report import ObjectEntry, ObjectReport
from sightline.files.plain_text import shortened
from sightline.inference.network import LoadedNetwork
from sightline.simulation.generate import MANIFEST_NAME as SIMULATION_MANIFEST
from sightline.simulation.packaged import PACKAGED_FRAMES

if TYPE_CHECKING:
    from rich.table import Table

Levels = tuple[float, float, float]
"""Results for the difficulties easy, moderate and hard, percent."""

_PUBLISHED_SPLIT = "kitti-object-val"
_LONGEST_VALUE = 30  # characters of a setting
_NUM_NAMED = 4  # departures named in a table


@dataclass(frozen=True, kw_only=True, slots=True)
class GivenNetwork:
    """Network, or results of an unknown one, with figures in a table."""

    name: str
    """Name of its weights."""
    design: str
    """Design, such as DGFN."""
    size: str = ""
    """Width, or number of weights."""
    steps: str = ""
    """Training steps by the file of weights."""
    departures: tuple[str, ...] = ()
    """Settings other than the paper's; empty: the paper's network."""

    @property
    def is_papers(self) -> bool:
        """Whether the network has the paper's settings; its results then fill the paper's row."""
        return not self.departures

    @property
    def title(self) -> str:
        """Name, design, size and training steps."""
        return ", ".join(filter(None, (f"{self.name}: {self.design}", self.size, self.steps)))

    @property
    def difference(self) -> str:
        """Settings other than the paper's, the first few."""
        more = len(self.departures) - _NUM_NAMED
        named = ", ".join(self.departures[:_NUM_NAMED])
        return f"{named} and {more} more" if more > 0 else named


def describe(
    loaded: LoadedNetwork[Any], design: str, departures: tuple[str, ...], *, size: str = ""
) -> GivenNetwork:
    """Describe a loaded network; its default size is its number of weights."""
    steps = loaded.weights.provenance.get("steps", "unknown")
    count = sum(each.numel() for each in loaded.network.parameters())
    return GivenNetwork(
        name=loaded.name,
        design=design,
        size=size or f"{count / 1e6:.2f} M weights",
        steps=f"{int(steps):,} steps" if steps.isdecimal() else f"steps {shortened(steps, 40)}",
        departures=departures,
    )


def find_departures(
    settings: object, paper: object, *, besides: Collection[str] = (), within: str = ""
) -> tuple[str, ...]:
    """List a dataclass's settings that differ from the paper's, with their values.

    Args:
        settings: Settings of a network.
        paper: Settings of the paper's network, of the same class.
        besides: Names of settings that do not make another network.
        within: Beginning of the names.
    """
    found: list[str] = []
    assert is_dataclass(paper), "settings are dataclasses"
    for name in (each.name for each in fields(paper)):
        value, paper_value = getattr(settings, name), getattr(paper, name)
        if within + name in besides or value == paper_value:
            continue
        if is_dataclass(value) and is_dataclass(paper_value):
            found += find_departures(value, paper_value, besides=besides, within=f"{within}{name}.")
        elif value is None or paper_value is None:
            found.insert(0, f"{'without' if value is None else 'with'} {within}{name}")
        else:
            found.append(f"{within}{name} {shortened(str(value), _LONGEST_VALUE)}")
    return tuple(found)


def open_labelled(
    data: Path, sample_list: str | Path | Sequence[str] | None, velodyne: Velodyne | None
) -> KittiObjectDataset:
    """Open KITTI's object tree with its images, sweeps and labels.

    Raises:
        ValueError: It cannot be read, or is no object tree with labels.
    """
    parts: tuple[Part, ...] = ("image", "points", "objects")
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    if not isinstance(dataset, KittiObjectDataset) or "objects" not in dataset.parts:
        raise ValueError(
            f"{data} is no object tree of KITTI's with labels to score against; name a folder that "
            "holds training/{image_2,velodyne,calib,label_2}"
        )
    return dataset


def find_frame(dataset: SampleDataset, name: str | None) -> int:
    """Position of the frame to draw; None: the first.

    Raises:
        ValueError: The data set has no such frame.
    """
    if name is None:
        return 0
    if name not in dataset.sample_ids:
        raise ValueError(
            f"frame {name} to draw is not among the {len(dataset)} frames that are scored; name "
            "one of them"
        )
    return tuple(dataset.sample_ids).index(name)


def is_published_split(dataset: KittiObjectDataset) -> bool:
    """Check that these are KITTI's val split, and not simulated frames of the same names."""
    if (dataset.root / SIMULATION_MANIFEST).exists():
        return False
    return set(dataset.sample_ids) == set(read_sample_list(_PUBLISHED_SPLIT, PACKAGED_FRAMES))


@dataclass(frozen=True, kw_only=True, slots=True)
class ClassScores:
    """Results for one class, percent."""

    ap_r11: Levels
    """AP at 11 recall positions, the published measure. It jumps by 9 where recall passes a
    position."""
    ap_r40: Levels
    max_recall: Levels
    """Recall at the lowest threshold."""
    ap_all_points: Levels | None = None
    """AP over all scores; None if not requested."""
    ap_all_points_95: tuple[tuple[float, float], ...] | None = None
    """95 % interval of that AP at each difficulty."""


def class_entries(
    folder: Path,
    dataset: KittiObjectDataset,
    class_name: ClassName,
    metric: Metric,
    overlaps: MinimumOverlaps,
    bootstrap: int = 0,
) -> dict[str, ObjectEntry]:
    """Score result files by KITTI's rules; entries by difficulty, none if nothing was found.

    Raises:
        ValueError: As `evaluate_objects`.
    """
    report = evaluate_objects(
        folder,
        dataset.root / dataset.split / part_folder("objects"),
        sample_list=dataset.sample_ids,
        overlaps=overlaps,
        bootstrap=bootstrap,
    )
    return select_entries(report, class_name, metric)


def select_entries(
    report: ObjectReport, class_name: ClassName, metric: Metric
) -> dict[str, ObjectEntry]:
    """Select the entries of a class and metric by difficulty; none if nothing was found."""
    return {
        entry.difficulty: entry
        for entry in report.entries
        if (entry.class_name, entry.metric) == (class_name, metric)
    }


def class_scores(
    entries: Mapping[str, ObjectEntry], *, with_all_points: bool = False
) -> ClassScores:
    """Summarise the entries of a class; all 0 if nothing was found."""

    def levels(measure: Callable[[ObjectEntry], float]) -> Levels:
        easy, moderate, hard = (
            measure(entries[each]) if each in entries else 0.0 for each in DIFFICULTIES
        )
        return easy, moderate, hard

    intervals = tuple(
        (points.low, points.high)
        for entry in entries.values()
        if (points := entry.all_points) and points.low is not None and points.high is not None
    )
    all_points = levels(lambda entry: entry.all_points.ap if entry.all_points else 0.0)
    return ClassScores(
        ap_r11=levels(lambda entry: entry.ap_r11),
        ap_r40=levels(lambda entry: entry.ap_r40),
        max_recall=levels(lambda entry: 100 * entry.max_recall),
        ap_all_points=all_points if with_all_points else None,
        ap_all_points_95=intervals or None,
    )


def levels_text(levels: Levels | None) -> str:
    """Format results in percent; None: a dash."""
    return "-" if levels is None else " ".join(f"{value:6.2f}" for value in levels)


def new_table(title: str, columns: Sequence[str], *, texts: int = 1) -> "Table":
    """Create a table whose first columns are texts at the left, the others figures."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, column in enumerate(columns):
        is_text = number < texts
        table.add_column(column, justify="left" if is_text else "right", no_wrap=not is_text)
    return table


def add_rows(
    table: "Table",
    names: tuple[str, ...],
    option: str,
    network: GivenNetwork | None,
    ours: tuple[str, ...],
    *,
    published: tuple[str, ...] = (),
) -> None:
    """Add a row of the paper, filled by its own network alone, and one of any other network.

    Args:
        table: Table with columns for the names, the network, the published and our figures.
        names: Texts of the first columns.
        option: Option of the command that gives the network.
        network: The network that is given, if any.
        ours: Our figures; none without a network.
        published: Published figures of the row.
    """
    if network is not None and network.is_papers:
        table.add_row(*names, network.title, *published, *ours)
        return
    table.add_row(*names, f"needs {option} WEIGHTS", *published)
    if network is not None:
        blank = ("",) * (len(names) - 1)
        description = f"not the paper's: {network.title}"
        table.add_row(*blank, names[-1], description, *("-" for _ in published), *ours)


def networks_note(networks: Sequence[GivenNetwork]) -> str:
    """List the networks other than the paper's, with their differences; empty: none."""
    others = [f"{each.name} ({each.difference})" for each in networks if not each.is_papers]
    return f"Not the paper's network: {'; '.join(others)}." if others else ""


def missing_note(missing: Sequence[str], done: str = "measured") -> str:
    """List what was not measured, or not drawn, in one line; empty: nothing."""
    return f"Not {done}: {'; '.join(missing)}." if missing else ""
