"""Rows of the tables of time and memory."""

from typing import Any

Record = dict[str, Any]
Rows = list[list[str]]

_ENGINES = {"none": "-", "torch": "PyTorch", "onnxruntime": "ONNX Runtime", "openvino": "OpenVINO"}
_OPERATIONS = {
    "sample": "farthest points, 16,384 to 4,096",
    "ball query": "ball query, 4,096 centres, 0.5 m, 32 points",
    "three nearest": "three nearest of 4,096 for 16,384",
    "RoI pooling": "RoI pooling, 300 boxes, 512 points, 130 features",
    "recall": "recall of 300 proposals",
}
_STAGES = {
    "search tree": "a mesh handed over, and its search tree",
    "camera": "466k rays of a camera a street",
    "around": "rays in any direction",
    "shadow": "whether these places see the sun",
}
_TASKS = ("detection2d", "detection3d", "depth-completion", "joined")
_SENSORS = {"clean": "both", "camera_blank": "no camera", "lidar_blank": "no LiDAR"}
_PARTS = {
    "picture": "picture and points",
    "detection2d": "2D detection",
    "detection3d": "3D detection",
    "depth-completion": "depth",
    "joined": "joined objects",
    "whole": "whole answer",
    "browser": "browser",
}


def fastest(record: Record, key: str, name: str) -> float:
    """Find the least median time of a method over the engines [ms]."""
    return min(float(row["median_ms"]) for row in record["results"] if row[key] == name)


def depth(record: Record) -> Rows:
    """Give the rows of depth completion."""
    rows: Rows = [
        ["method", "engine", "median, ms", "95 %", "memory, MiB", "GFLOP a pass", "numbers"]
    ]
    for row in record["results"]:
        numbers = f"{row['parameters'] / 1e6:.3g} M" if "parameters" in row else ""
        gflop = f"{row['gflop']:.1f}" if "gflop" in row else ""
        cells = [f"{row['peak_memory_mib']:,.0f}", gflop, numbers]
        rows.append([row["method"], _ENGINES[row["engine"]], *_times(row), *cells])
    return rows


def detection2d(record: Record) -> Rows:
    """Give the rows of 2D detection."""
    head = ["network", "engine", "median, ms", "95 %", "network alone", "memory, MiB"]
    rows: Rows = [[*head, "GFLOP", "numbers"]]
    for row in record["results"]:
        engine = _ENGINES[row["engine"]]
        if row["engine"] == "torch":
            engine += f", {row['precision']}"
        cells = [f"{row['network_median_ms']:.0f}", f"{row['peak_memory_mib']:,.0f}"]
        cells += [f"{row['gflop']:.1f}", f"{row['parameters'] / 1e6:.2f} M"]
        rows.append([_network(row), engine, *_times(row), *cells])
    return rows


def detection3d(record: Record) -> Rows:
    """Give the rows of 3D detection."""
    head = ["network", "engine", "median, ms", "95 %", "first stage", "proposals", "memory, MiB"]
    rows: Rows = [[*head, "GFLOP by stage", "numbers"]]
    for row in record["results"]:
        cells = [f"{row['first_stage_median_ms']:.0f}", f"{row['proposals']}"]
        cells.append(f"{row['peak_memory_mib']:,.0f}")
        cells.append(" + ".join(f"{stage['gflop']:.1f}" for stage in row["stages"]))
        cells.append(f"{sum(stage['parameters'] for stage in row['stages']) / 1e6:.2f} M")
        rows.append([_network(row), _ENGINES[row["engine"]], *_times(row), *cells])
    return rows


def all_tasks(record: Record) -> Rows:
    """Give the rows of all answers of a frame."""
    parts = {name: _PARTS[name] for name in (*_TASKS, "whole")}
    rows: Rows = [["weights", "sensors", *(f"{each}, ms" for each in parts.values()), "95 %"]]
    for row in record["results"]:
        times = [f"{row[part]:.0f}" if part in row else "" for part in (*parts, "percentile_95")]
        rows.append([row["weights"], _SENSORS[row["case"]], *times])
    return rows


def _network(row: Record) -> str:
    return f"{row['network']}" if row["trained"] else f"{row['network']} (untrained)"


def _times(row: Record) -> tuple[str, str]:
    return _milliseconds(row["median_ms"]), _milliseconds(row["percentile_95_ms"])


def _milliseconds(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}"


def kitti_evaluation(record: Record) -> Rows:
    """Give the rows of KITTI's object evaluation."""
    titles = {"process": "whole process, from a cold interpreter", "call": "the call alone"}
    rows: Rows = [["what", "median, s", "interquartile range"]]
    for row in record["results"]:
        rows.append([titles[row["run"]], f"{row['median_s']:.2f}", f"{row['iqr_s']:.2f}"])
    return rows


def rotated_iou(record: Record) -> Rows:
    """Give the rows of rotated overlaps."""
    rows: Rows = [["method", "median, ms", "times ours", "largest error"]]
    for row in record["results"]:
        cells = [f"{row['median_ms']:.1f}", f"{row['times_sightline']:.1f}"]
        rows.append([row["method"], *cells, f"{row['max_error']:.0e}"])
    return rows


def corruptions(record: Record) -> Rows:
    """Give the rows of all kinds of corruption, slowest severity."""
    rows: Rows = [["kind", "median, ms", "slowest"]]
    for row in record["results"]:
        if row["suite"] == "all" and row["case"] != "clean":
            kind, _, severity = row["case"].rpartition("-")
            cells = [f"{row['median_ms']:.1f}", f"{row['max_ms']:.1f}"]
            rows.append([f"{kind}, severity {severity}", *cells])
    return rows


def point_ops(record: Record) -> Rows:
    """Give the rows of operations on points, a column for each method."""
    methods = list(dict.fromkeys(row["method"] for row in record["results"]))
    rows: Rows = [["operation, ms", *methods]]
    for operation, title in _OPERATIONS.items():
        found = {
            row["method"]: f"{row['median_ms']:.1f}" + ("" if row["same_answer"] else ", others")
            for row in record["results"]
            if row["operation"] == operation
        }
        rows.append([title, *(found.get(method, "") for method in methods)])
    return rows


def raycast(record: Record) -> Rows:
    """Give the rows of ray casting."""
    own_ms, peer_ms = (record["results_ms"][name] for name in ("sightline", "embreex"))
    rows: Rows = [["work", "sightline, ms", "embreex, ms", "times ours"]]
    for stage, title in _STAGES.items():
        cells = [f"{own_ms[stage]:.0f}", f"{peer_ms[stage]:,.0f}"]
        rows.append([title, *cells, f"{peer_ms[stage] / own_ms[stage]:.1f}"])
    return rows


def simulate(record: Record) -> Rows:
    """Give the rows of the simulator."""
    rows: Rows = [["stage", "median, s", "interquartile range"]]
    for stage, row in record["results"].items():
        rows.append([stage, f"{row['median_s']:.2f}", f"{row['iqr_s']:.2f}"])
    for workers, name in (("one worker", "one_worker_s"), ("two workers", "two_workers_s")):
        rows.append([f"wall time of a frame, {workers}", f"{record[name]:.2f}", ""])
    return rows


def page(record: Record) -> Rows:
    """Give the rows of the page of `sightline serve`."""
    head = ["part", "processor, median, ms", "95 %", "wall, median, ms", "95 %"]
    rows: Rows = [head]
    for row in record["results"]:
        found = [
            row.get(f"{kind}_{figure}_ms")
            for kind in ("processor", "wall")
            for figure in ("median", "percentile_95")
        ]
        cells = ["" if each is None else f"{each:,.0f}" for each in found]
        rows.append([_PARTS.get(row["part"], row["part"]), *cells])
    view = record["view"]
    before, after = record["load_average"]
    rows.append(["first paint of the page", "", "", f"{record['first_paint_ms']:,.0f}", ""])
    rows.append(["page without data", f"{record['page_bytes'] / 1000:.0f} kB", "", "", ""])
    points = f"3D view, {view['points']:,} points, {view['by']} (software)"
    rows.append([points, "", "", f"{view['frames_per_s']:.0f} frames/s", ""])
    rows.append(["load of the two cores by all jobs", "", "", f"{before:.0f} to {after:.0f}", ""])
    return rows


def flat_memory(record: Record) -> Rows:
    """Give the rows of resident memory."""
    counts = list(record["results"][0]["resident_mib"])
    rows: Rows = [["work", *(f"MiB after {count} samples" for count in counts)]]
    for row in record["results"]:
        rows.append([row["work"], *(f"{row['resident_mib'][count]:.0f}" for count in counts)])
    return rows
