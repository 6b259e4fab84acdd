"""Rows of the tables of the papers' own networks, trained on simulated streets."""

import statistics
from typing import Any

from sightline.corruptions.suites import CLEAN, find_suite
from sightline.papers.gated_fusion import FULL, NAMES

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
    low, high = difference["interval"]
    return f"{statistics.fmean(difference['by_seed']):+.1f} [{low:+.1f}, {high:+.1f}]"


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
