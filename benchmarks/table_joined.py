"""Rows of the tables of joined objects beside each detector's."""

from pathlib import Path
from statistics import mean
from typing import Any

Record = dict[str, Any]
Rows = list[list[str]]

_STATES = {"clean": "both sensors", "camera_blank": "camera blank", "lidar_blank": "LiDAR blank"}
_COLUMNS = {
    "cars in the image, IoU 0.7": ("Car", "bbox", 0.7),
    "cars in 3D, 0.7": ("Car", "3d", 0.7),
    "cars in 3D, 0.5": ("Car", "3d", 0.5),
    "pedestrians in the image, 0.5": ("Pedestrian", "bbox", 0.5),
    "pedestrians in 3D, 0.5": ("Pedestrian", "3d", 0.5),
}
_FAULT_COLUMNS = {
    "cars in the image, IoU 0.7": ("Car", "bbox", 0.7),
    "cars in 3D, 0.7": ("Car", "3d", 0.7),
    "cars in 3D, 0.5": ("Car", "3d", 0.5),
    "cars, centres within 2 m": ("Car", "centre_2m", None),
    "pedestrians in the image, 0.5": ("Pedestrian", "bbox", 0.5),
    "pedestrians in 3D, 0.5": ("Pedestrian", "3d", 0.5),
}


def joined(*records: Record) -> Rows:
    """Give a row for each list of frames and state of the sensors."""
    rows: Rows = [["frames", "sensors", *_COLUMNS]]
    for record in records:
        cases = _cases(record)
        states = {title: [case] for case, title in _STATES.items() if case in cases}
        for num_beams in (32, 16, 8):
            beams = [case for case in cases if case.startswith(f"beams_{num_beams}_from_")]
            if len(beams) == 1:
                states[_title(beams[0])] = beams
            elif beams:
                states[f"{num_beams} beams, mean of {len(beams)} choices of rings"] = beams
        for title, chosen in states.items():
            cells = [_cell(record, chosen, *column) for column in _COLUMNS.values()]
            listed = Path(record["sample_list"]).stem
            rows.append([f"{listed}, {record['frames']}", title, *cells])
    return rows


def pairs(*records: Record) -> Rows:
    """Give the rows of `joined` for each pair of detectors."""
    rows: Rows = [["detectors", "sensors", *_COLUMNS]]
    for record in records:
        names = ", ".join(record["weights"])
        rows += [[names, *cells] for _, *cells in joined(record)[1:]]
    return rows


def faults(record: Record) -> Rows:
    """Give a row for each fault, and what was undone."""
    rows: Rows = [["fault", "undone", *_FAULT_COLUMNS]]
    for case in _cases(record):
        told = next(row for row in record["results"] if row["case"] == case)
        angles = (
            f"{name.removesuffix('_deg')} {angle:.2f} deg"
            for name, angle in told["undone"].items()
            if angle
        )
        state = "frame by frame" if told["by_boxes"] else "late" if told.get("late") else "-"
        undone = ", ".join(angles) or state
        cells = [_cell(record, [case], *column) for column in _FAULT_COLUMNS.values()]
        rows.append([_title(case), undone, *cells])
    return rows


def calibration(*records: Record) -> Rows:
    """Give a row of D-ECE for each list of frames and state of the sensors."""
    titles = _STATES | {"beams_16_from_0": "16 beams"}
    rows: Rows = [["frames", "sensors", *_COLUMNS]]
    for record in records:
        found = {
            (row["case"], row["class_name"], row["metric"], row["iou"]): row
            for row in record["results"]
        }
        for case in dict.fromkeys(row["case"] for row in record["results"]):
            cells = [_error_cell(found[case, *column]) for column in _COLUMNS.values()]
            rows.append([f"{record['sample_list']}, {record['frames']}", titles[case], *cells])
    return rows


def _error_cell(row: Record) -> str:
    """Format D-ECE alone and joined, the interval of the difference, and the joined's number."""
    alone = " / ".join(_number(row[name]) for name in ("image", "sweep") if name in row)
    interval = row.get("less_image_95" if "image" in row else "less_sweep_95")
    differs = "" if interval is None else f" [{interval[0]:+.0f}, {interval[1]:+.0f}]"
    return f"{alone} -> **{_number(row['joined'])}**{differs}, {row['n_joined']}"


def _number(error: float | None) -> str:
    return "-" if error is None else f"{error:.0f}"


def _cases(record: Record) -> list[str]:
    return list(dict.fromkeys(row["case"] for row in record["results"]))


def _title(case: str) -> str:
    """Name a case in words."""
    kind, _, severity = case.partition("-")
    if severity:
        return f"`{kind}`, severity {severity}"
    if case.startswith("yaw_"):
        return f"LiDAR turned by {case.removeprefix('yaw_')} deg"
    if case.startswith("beams_"):
        num_beams, first = case.removeprefix("beams_").split("_from_")
        return f"{num_beams} beams, from ring {first} on"
    return {"half_hidden": "half a sweep hidden", **_STATES}[case]


def _cell(record: Record, cases: list[str], class_name: str, metric: str, iou: float | None) -> str:
    """Format AP alone and joined; for a single case the difference's interval, to the better."""
    rows = [
        row
        for row in record["results"]
        if row["case"] in cases
        and (row["class"], row["metric"], row["iou"]) == (class_name, metric, iou)
    ]
    names = [name for name in ("image", "sweep") if all(name in row for row in rows)]
    alone = {name: mean(row[name] for row in rows) for name in names}
    scores = " / ".join(f"{score:.1f}" for score in alone.values())
    cell = f"{scores} -> **{mean(row.get('joined', 0.0) for row in rows):.1f}**"
    better = max(alone, key=alone.__getitem__, default=None)
    interval = rows[0].get(f"less_{better}_95")
    if len(rows) > 1 or interval is None:
        return cell
    return f"{cell} [{interval[0]:+.1f}, {interval[1]:+.1f}]"
