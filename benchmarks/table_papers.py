"""Rows of the tables of the papers' own networks, trained on simulated streets."""

import statistics
from collections.abc import Sequence
from typing import Any

from sightline.corruptions.suites import CLEAN, find_suite
from sightline.papers.gated_fusion import FULL, NAMES
from sightline.papers.two_stage_rows import NAMES as STAGES

Record = dict[str, Any]
Rows = list[list[str]]


def table_1(record: Record) -> Rows:
    """Give the rows of Kim et al. 2018's Tables I and II: a row for each trained network."""
    cases = [FULL, *(case.name for case in find_suite("dgfn7").cases)]
    rows: Rows = [
        ["network", "width", "steps", "seed", *(case.replace("_", " ") for case in cases)]
    ]
    for network in record["networks"]:
        levels = (network["cases"].get(case) for case in cases)
        cells = ("" if each is None else f"{each['ap_r40'][1]:.1f}" for each in levels)
        rows.append(
            [
                NAMES[network["fusion"]],
                f"{network['width']:g}",
                f"{network['steps']:,}",
                f"{network['seed']}",
                *cells,
            ]
        )
    return rows


def fusion_differences(record: Record) -> Rows:
    """Give the rows of cars in each case: AP of the networks, and differences with intervals."""
    first, *others = record["seeds"]
    rows: Rows = [["case"]]
    for iou in (0.7, 0.5):
        rows[0] += [f"{' / '.join(record['seeds'])}, IoU {iou}"]
        rows[0] += [f"{first} less {other}" for other in others]
    by_case: dict[str, list[str]] = {}
    for row in record["rows"]:
        if row["class"] == "Car":
            cells = by_case.setdefault(row["case"], [])
            cells.append(" / ".join(f"{each:.1f}" for each in row["r40"]["scores"].values()))
            cells += [_interval(row["r40"]["differences"][other]) for other in others]
    rows += [[case.replace("_", " "), *cells] for case, cells in by_case.items()]
    return rows


def _interval(difference: Record) -> str:
    return _with_interval(statistics.fmean(difference["by_seed"]), difference["interval"])


def _with_interval(difference: float, ends: Sequence[float] | None) -> str:
    return f"{difference:+.1f}" + (f" [{ends[0]:+.1f}, {ends[1]:+.1f}]" if ends else "")


def gate_means(record: Record) -> Rows:
    """Give the rows of the mean gates at the finest map in each case, of the gated networks."""
    networks = [each for each in record["networks"] if each["gates"]]
    rows: Rows = [["case"]]
    for network in networks:
        name = f"width {network['width']:g}, seed {network['seed']}"
        rows[0] += [f"camera: {name}", f"LiDAR: {name}"]
    for place, case in enumerate(networks[0]["gates"]):
        cells = [
            f"{network['gates'][place][sensor]['mean']:.2f}"
            for network in networks
            for sensor in ("camera", "lidar")
        ]
        rows.append([case["case"].replace("_", " "), *cells])
    assert rows[1][0] == CLEAN, "the first case"
    return rows


def stage_name(row: str) -> str:
    """Name a row of the course's table: its own by their text, others by their folder."""
    own = {str(key): name for key, name in STAGES.items()}
    return own.get(row, row.replace("_", " "))


def two_stage(record: Record) -> Rows:
    """Give the rows of the course's table: AP of cars at both IoUs, easy / moderate / hard."""
    scores = record["rows"]
    ious = list(next(iter(scores.values())))
    rows: Rows = [["detector"]]
    published = ["the course's, on its own frames"]
    for iou in ious:
        rows[0] += [f"R11, IoU {iou}", f"R40, IoU {iou}", f"all points, IoU {iou}, moderate"]
        is_published = float(iou) == record["published"]["iou"]
        published += [_levels(record["published"]["ap_r11"], 2) if is_published else "", "", ""]
    rows.append(published)
    for row, by_iou in scores.items():
        cells = [stage_name(row)]
        for iou in ious:
            each = by_iou[iou]
            ends = each["ap_all_points_95"]
            interval = f" [{ends[1][0]:.1f}, {ends[1][1]:.1f}]" if ends else ""
            cells += [_levels(each["ap_r11"]), _levels(each["ap_r40"])]
            cells.append(f"{each['ap_all_points'][1]:.1f}{interval}")
        rows.append(cells)
    return rows


def two_stage_differences(record: Record) -> Rows:
    """Give the rows of the differences between the course's rows, with paired intervals."""
    measures = {"r40": "R40", "all_points": "all points"}
    ious = list(next(iter(record["rows"].values())))
    rows: Rows = [["difference", "cars"]]
    rows[0] += [f"{name}, IoU {iou}" for iou in ious for name in measures.values()]
    cells: dict[tuple[str, str], list[str]] = {}
    for each in record["differences"]:  # by IoU within each pair of rows
        name = f"{stage_name(each['row'])} less {stage_name(each['less'])}"
        cells.setdefault((name, each["difficulty"]), []).extend(
            _with_interval(each[key]["difference"], each[key]["difference_95"]) for key in measures
        )
    return rows + [[name, difficulty, *each] for (name, difficulty), each in cells.items()]


def _levels(levels: Sequence[float], digits: int = 1) -> str:
    return " / ".join(f"{level:.{digits}f}" for level in levels)
