"""Rows of the scoreboard at the top of the results."""

from typing import Any

from benchmarks.table_accuracy import Rows, difference, errors, interval, score, with_interval
from benchmarks.table_sensors import with_newer
from benchmarks.table_speed import fastest

Record = dict[str, Any]

_KIND_LIMIT = 0.95
_SEVERITY = 3
_DETECTORS = {"image": "2d", "sweep": "3d"}


def scoreboard(
    truth: Record,
    time3d: Record,
    detection: Record,
    time2d: Record,
    rings: Record,
    time_depth: Record,
    health_simulated: Record,
    health_real: Record,
    weather_simulated: Record,
    weather_real: Record,
    evaluation: Record,
    joined: Record,
    quoted: Record,
) -> Rows:
    """Give one row for each headline figure, real truth first."""
    head = ["task", "metric", "ours", "simplest baseline", "published", "time"]
    return [
        head,
        *_depth_by_truth(truth, time_depth, quoted),
        *_in_space(detection, time3d, quoted),
        *_in_the_image(detection, time2d, quoted),
        *_joined(joined),
        _rings(rings, time_depth),
        _faults(
            with_newer(health_simulated, weather_simulated), with_newer(health_real, weather_real)
        ),
        _evaluation(evaluation, quoted),
    ]


def _depth_by_truth(truth: Record, times: Record, quoted: Record) -> Rows:
    frames = f"{truth['frames']} frames"
    rows = {row["method"]: row for row in truth["results"] if row["beams"] == 64}
    found: Rows = []
    for key, title, first, second in (
        ("standing", "depth, what stands still", "depth-best", "adaptive"),
        ("with_cars", "depth, with moving cars", "depth-best", "adaptive"),
    ):
        text = {name: errors(row[key], "rmse_mm", "mae_mm") for name, row in rows.items()}
        against = difference(rows[first][key], first, truth["against"])
        ours = f"**{text[first]}** ({first}); RMSE less {truth['against']}'s: {against}"
        baseline = f"{text['classical']} classical filter, {text['linear']} linear; {second} "
        baseline += text[second]
        if first == "adaptive":  # the record of times is of its first edition
            milliseconds = f"{quoted['adaptive_ms']['milliseconds']} ms"
        else:
            milliseconds = f"{fastest(times, 'method', first):.0f} ms"
        metric = f"real truth, {frames}, RMSE / MAE, mm"
        found.append([title, metric, ours, baseline, "-", milliseconds])
    return found


def _in_space(detection: Record, times: Record, quoted: Record) -> Rows:
    def of(weights: str, name: str, iou: float) -> str:
        found = score(detection, weights, "clean", metric="3d", iou=iou, **{"class": name})
        return with_interval(found)

    milliseconds = f"{fastest(times, 'network', 'detection3d-best'):.0f} ms"
    published = (
        f"{quoted['cars_3d_from_simulation']['ap']} from simulation alone (1), "
        f"{quoted['cars_3d_from_other_real']['ap']} from another real data set (2)"
    )
    frames = f"{detection['frames']} frames"
    rows: Rows = []
    for title, name, iou, there in (
        ("cars, 3D", "Car", 0.7, published),
        ("cars, 3D", "Car", 0.5, "-"),
        ("pedestrians, 3D", "Pedestrian", 0.5, "-"),
    ):
        ours = f"**{of('detection3d-best', name, iou)}**"
        if name == "Pedestrian":
            others = quoted["pedestrians_3d_sample_train"]["pedestrian"]
            ours += f"; {others} on 25 others (`sample_train`)"
        smaller = f"{of('detection3d-fast-cpu', name, iou)} (detection3d-fast-cpu)"
        rows.append(
            [title, f"AP, 3D IoU {iou}, {frames}", ours, smaller, there, milliseconds]
        )  # fmt: skip
    return rows


def _in_the_image(detection: Record, times: Record, quoted: Record) -> Rows:
    milliseconds = f"{fastest(times, 'network', 'detection2d-best'):.0f} ms"
    frames = f"{detection['frames']} frames"
    alone = {
        name: {
            key: f"{values[0]} {interval(values[1:])}"
            for key, values in quoted[f"{name}_only_2d"].items()
            if key != "source"
        }
        for name in ("lidar", "camera")
    }
    both = {
        key: f"LiDAR only {alone['lidar'][key]}, camera only {alone['camera'][key]} (4)"
        for key in ("car", "pedestrian")
    }
    published = f"{quoted['cars_2d_from_simulation']['ap']} from simulation alone (3)"
    rows: Rows = []
    for title, case, name, iou, baseline, there in (
        ("cars, 2D, both sensors", "clean", "Car", 0.7, both["car"], published),
        (
            "cars, 2D, camera blank", "camera_blank", "Car", 0.7,
            f"LiDAR only {alone['lidar']['car']} (4)", "-",
        ),
        (
            "cars, 2D, LiDAR blank", "lidar_blank", "Car", 0.7,
            f"camera only {alone['camera']['car']} (4)", "-",
        ),
        ("pedestrians, 2D, both sensors", "clean", "Pedestrian", 0.5, both["pedestrian"], "-"),
    ):  # fmt: skip
        found = score(
            detection, "detection2d-best", case, metric="bbox", iou=iou, **{"class": name}
        )
        ours = f"**{with_interval(found)}**"
        rows.append([title, f"AP, IoU {iou}, {frames}", ours, baseline, there, milliseconds])
    return rows


def _joined(joined: Record) -> Rows:
    """Give the rows of joined objects, and their lead over the better of both detectors."""
    frames = f"{joined['frames']} frames"
    rows: Rows = []
    for title, case, name, metric, iou in (
        ("cars, joined, both sensors", "clean", "Car", "bbox", 0.7),
        ("cars, joined, camera blank", "camera_blank", "Car", "bbox", 0.7),
        ("cars, joined, both sensors", "clean", "Car", "3d", 0.5),
        ("cars, joined, LiDAR blank", "lidar_blank", "Car", "3d", 0.5),
        ("pedestrians, joined, both sensors", "clean", "Pedestrian", "3d", 0.5),
    ):
        found = next(
            row
            for row in joined["results"]
            if (row["case"], row["class"], row["metric"], row["iou"]) == (case, name, metric, iou)
        )
        parts = ("image", "sweep") if metric == "bbox" else ("sweep",)
        better = max(parts, key=lambda part: float(found[part]))
        low, high = found[f"less_{better}_95"]
        alone = ", ".join(f"{found[part]:.0f} detection{_DETECTORS[part]}-best" for part in parts)
        where = "IoU" if metric == "bbox" else "3D IoU"
        ours = f"**{found['joined']:.0f}**; less {_DETECTORS[better].upper()} detection's: "
        ours += f"{found['joined'] - found[better]:+.0f} [{low:+.0f}, {high:+.0f}]"
        rows.append([title, f"AP, {where} {iou}, {frames}", ours, alone, "-", ""])
    return rows


def _rings(rings: Record, times: Record) -> list[str]:
    rows = {row["method"]: row["scores"][0] for row in rings["results"]}
    text = {name: errors(row, "rmse_mm", "mae_mm") for name, row in rows.items()}
    classical = next(text[name] for name in text if name.startswith("classical, Gaussian"))
    return [
        "depth, held-out rings",
        f"{rings['frames']} frames, RMSE / MAE, mm",
        f"**{text['depth-best']}** (depth-best); depth-fast-cpu {text['depth-fast-cpu']}",
        f"{text['linear']} linear, {classical} classical filter; adaptive {text['adaptive']}",
        "-",
        f"{fastest(times, 'method', 'depth-best'):.0f} ms",
    ]


def _faults(simulated: Record, real: Record) -> list[str]:
    """Give the row of the health monitor: the worse of simulated and real frames counts."""
    worst: dict[str, float] = {}
    for record in (simulated, real):
        for case in record["cases"]:
            kind = case["case"].rpartition("-")[0]
            if case["severity"] == _SEVERITY:
                worst[kind] = min(case["own"], worst.get(kind, 1.0))
    good = sum(round(area, 2) >= _KIND_LIMIT for area in worst.values())
    others = sorted(
        f"{kind} {area:.2f}" for kind, area in worst.items() if round(area, 2) < _KIND_LIMIT
    )
    ours = f"**{_KIND_LIMIT} or more for {good} of {len(worst)} kinds**; {', '.join(others)}"
    frames = f"{simulated['frames']} simulated and {real['frames']} real frames"
    times = sorted(record["median_ms"] for record in (simulated, real))
    milliseconds = f"{times[0]:.0f} to {times[1]:.0f} ms"
    return [
        "sensor faults noticed",
        f"AUROC, severity {_SEVERITY}, {frames}",
        ours,
        "-",
        "-",
        milliseconds,
    ]


def _evaluation(evaluation: Record, quoted: Record) -> list[str]:
    seconds = next(row["median_s"] for row in evaluation["results"] if row["run"] == "process")
    peer = f"{quoted['official_evaluation_s']['seconds']} s, official C++ program (5)"
    metric = f"{evaluation['frames']:,} frames, whole process"
    return ["KITTI's object evaluation", metric, f"**{seconds:.1f} s**", peer, "-", ""]
