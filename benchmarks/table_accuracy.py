"""Rows of the tables of accuracy: detection on real frames, depth completion."""

from collections.abc import Sequence
from typing import Any

Record = dict[str, Any]
Rows = list[list[str]]

_CASES = {
    "clean": "both sensors",
    "camera_blank": "camera blank",
    "lidar_blank": "LiDAR blank",
    "camera_occlusion": "camera partly hidden",
    "lidar_occlusion": "LiDAR partly hidden",
    "camera_noise": "noise",
    "camera_illumination": "glare",
}
_BEAMS = {"clean": "64", "lidar_beams-2": "32", "lidar_beams-3": "16"}
_METRICS = {"3d": "3D", "bev": "from above", "bbox": "in the image"}


def score(record: Record, weights: str, case: str, **expected: object) -> Record:
    """Find one row of `detection_accuracy`: by class, metric and IoU."""
    for row in record["results"]:
        if (row["weights"], row["case"]) == (weights, case):
            for each in row["scores"]:
                if all(each[name] == value for name, value in expected.items()):
                    found: Record = each
                    return found
    raise ValueError(f"no score of {weights}, {case}, {expected}; run the benchmark again")


def with_interval(row: Record) -> str:
    """Format moderate AP with its interval, whole percents."""
    return f"{row['ap'][1]:.0f} {interval(row['ap_95'])}"


def interval(ends: Sequence[float]) -> str:
    """Format an interval without decimals."""
    return f"[{ends[0]:.0f}, {ends[1]:.0f}]"


def levels(values: Sequence[float]) -> str:
    """Format easy, moderate and hard."""
    return " / ".join(f"{value:.0f}" for value in values)


def errors(row: Record, *names: str) -> str:
    """Format errors in whole millimetres."""
    return " / ".join(f"{row[name]:.0f}" for name in names)


def detection2d_best(record: Record) -> Rows:
    """Give the rows of `detection2d-best`."""
    return _detection2d(record, "detection2d-best")


def detection2d_fast_cpu(record: Record) -> Rows:
    """Give the rows of `detection2d-fast-cpu`."""
    return _detection2d(record, "detection2d-fast-cpu")


def _detection2d(record: Record, weights: str) -> Rows:
    def of(case: str, name: str, iou: float) -> Record:
        return score(record, weights, case, metric="bbox", iou=iou, **{"class": name})

    head = ["case", "cars, IoU 0.7", "R40", "R11", "greatest recall", "cars, 0.5"]
    rows: Rows = [[*head, "pedestrians, 0.5", "cyclists, 0.5"]]
    for case, title in _CASES.items():
        car = of(case, "Car", 0.7)
        cells = [f"{levels(car['ap'])} {interval(car['ap_95'])}"]
        cells += [levels(car[name]) for name in ("ap_r40", "ap_r11", "max_recall")]
        cells.append(f"{of(case, 'Car', 0.5)['ap'][1]:.0f}")
        cells += [with_interval(of(case, name, 0.5)) for name in ("Pedestrian", "Cyclist")]
        rows.append([title, *cells])
    means = [
        sum(of(case, name, iou)["ap"][1] for case in _CASES) / len(_CASES)
        for name, iou in (("Car", 0.7), ("Car", 0.5), ("Pedestrian", 0.5), ("Cyclist", 0.5))
    ]
    cells = [f"{mean:.0f}" for mean in means]
    return [*rows, ["mean, moderate", cells[0], "", "", "", *cells[1:]]]


def detection3d_best(record: Record) -> Rows:
    """Give the rows of `detection3d-best`."""
    return _detection3d(record, "detection3d-best")


def detection3d_fast_cpu(record: Record) -> Rows:
    """Give the rows of `detection3d-fast-cpu`."""
    return _detection3d(record, "detection3d-fast-cpu")


def _detection3d(record: Record, weights: str) -> Rows:
    head = ["beams", "class, overlap, IoU", "AP, all points", "R40", "R11", "greatest recall"]
    rows: Rows = [[*head, "flipped", "objects"]]
    for case, beams in _BEAMS.items():
        for name, metric, iou in (
            ("Car", "3d", 0.7), ("Car", "3d", 0.5), ("Car", "bev", 0.7), ("Car", "bbox", 0.7),
            ("Pedestrian", "3d", 0.5), ("Cyclist", "3d", 0.5),
        ):  # fmt: skip
            row = score(record, weights, case, metric=metric, iou=iou, **{"class": name})
            flipped = "-" if row["flipped"] is None else f"{row['flipped']:.1f} %"
            cells = [levels(row[each]) for each in ("ap_r40", "ap_r11", "max_recall", "objects")]
            ap = f"{levels(row['ap'])} {interval(row['ap_95'])}"
            title = f"{name}, {_METRICS[metric]}, {iou}"
            rows.append([beams, title, ap, *cells[:3], flipped, cells[3]])
    return rows


def real_truth(record: Record) -> Rows:
    """Give the rows of depth by real truth, all beams."""
    bands = ["0-10 m", "10-20 m", "20-40 m", "40-90 m"]
    head = ["method", "standing", "with moving cars", *bands, "lost returns", "beyond 40 m"]
    rows: Rows = [[*head, f"RMSE less that of {record['against']}, standing", "with cars"]]
    for row in record["results"]:
        if row["beams"] != max(each["beams"] for each in record["results"]):
            continue
        standing, cars = row["standing"], row["with_cars"]
        lost = standing["lost"]
        by_band = {band["name"]: errors(band, "rmse_mm", "mae_mm") for band in standing["bands"]}
        rows.append(
            [
                row["method"],
                errors(standing, "rmse_mm", "mae_mm"),
                errors(cars, "rmse_mm", "mae_mm"),
                *(by_band[band] for band in bands),
                *(f"{100 * lost[key]:.1f} %" for key in ("lost_share", "lost_share_beyond_40m")),
                *(difference(each, row["method"], record["against"]) for each in (standing, cars)),
            ]
        )
    return rows


def difference(scores: Record, method: str, against: str) -> str:
    """Format the paired difference of RMSE with its interval."""
    if method == against:
        return ""
    paired = next(each for each in scores["difference"] if each["score"] == "RMSE")
    return f"{paired['mean']:.0f} {interval([paired['low'], paired['high']])}"


def real_truth_fewer_beams(record: Record) -> Rows:
    """Give the rows of depth by real truth with fewer beams."""
    numbers = sorted({row["beams"] for row in record["results"]}, reverse=True)[1:]
    by_method: dict[str, dict[int, str]] = {}
    for row in record["results"]:
        cells = [errors(row[truth], "rmse_mm", "mae_mm") for truth in ("standing", "with_cars")]
        by_method.setdefault(row["method"], {})[row["beams"]] = ", ".join(cells)
    head = ["standing, with moving cars", *(f"{number} beams" for number in numbers)]
    rows = [[name, *(cells[each] for each in numbers)] for name, cells in by_method.items()]
    return [head, *rows]


def held_out_rings(record: Record) -> Rows:
    """Give the rows of depth by held-out rings."""
    names = ("rmse_mm", "mae_mm", "median_error_mm")
    beams = [f"{each['beams']} beams" for each in record["results"][0]["scores"]]
    rows: Rows = [["method", *beams]]
    for row in record["results"]:
        rows.append([row["method"], *(errors(each, *names) for each in row["scores"])])
    return rows


def valid_depth(real: Record, simulated: Record) -> Rows:
    """Give the rows of depth that methods mark as valid."""
    head = ["method", "beams"]
    for side in ("real", "simulated"):
        head += [f"{side}: of the image", "of the truth", "kept", "others"]
    rows: Rows = [head]
    for row in _own_rule(real):
        cells = [row["method"], f"{row['beams']}"]
        for record in (real, simulated):
            same = next(
                each
                for each in _own_rule(record)
                if (each["method"], each["beams"]) == (row["method"], row["beams"])
            )
            cells += [f"{100 * same['image_share']:.0f} %", f"{100 * same['kept_share']:.1f} %"]
            for name in ("kept_mm", "others_mm"):
                cells.append(levels(same[name]) if same[name] else "none")
        rows.append(cells)
    return rows


def _own_rule(record: Record) -> list[Record]:
    """Select the rows without another limit of the expected error."""
    return [row for row in record["results"] if row["limit"] is None]
