"""Rows of the tables on broken and other sensors, and on simulated against real ones."""

from typing import Any

from benchmarks.own_sensor_rigs import RIGS
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M

Record = dict[str, Any]
Rows = list[list[str]]


_SOUND, _BLIND = "sound", "no returns"  # states of `hidden_sweep` without a part of their own


def depth_faults(record: Record) -> Rows:
    """Give the rows of depth completion with faults."""
    methods = record["results"]
    rows: Rows = [["fault", *(each["method"] for each in methods)]]
    for case in methods[0]["rmse_mae_mm"]:
        pairs = (each["rmse_mae_mm"][case] for each in methods)
        rows.append([case, *(f"{rmse:.0f} / {mae:.0f}" for rmse, mae in pairs)])
    return rows


def hidden_sweep(record: Record) -> Rows:
    """Give the rows of depth where the LiDAR saw nothing, last the error that is expected there."""
    states = list(dict.fromkeys(row["state"] for row in record["results"]))
    head = ["method"]
    for state in states:
        head += [state] if state in (_SOUND, _BLIND) else [state, "there alone"]
    by_method: dict[str, list[str]] = {}
    for row in record["results"]:
        cells = by_method.setdefault(row["method"], [row["method"]])
        cells.append(_pair(row, "all"))
        if row["state"] not in (_SOUND, _BLIND):
            cells.append(_pair(row, "hidden"))
        if row["state"] == _BLIND:
            expected = row.get("all_expected_mm")
            cells.append("" if expected is None else f"{expected:.0f}")
    return [[*head, "its expected MAE"], *by_method.values()]


def image_depth(*records: Record) -> Rows:
    """Give the rows of depth from the image alone on other rigs."""
    heads = ["method", "random rigs, simulated", "nuScenes, real"]
    rows: dict[str, list[str]] = {}
    for record in records:
        for row in record["results"]:
            three = (row[f"all_{name}_mm"] for name in ("rmse", "mae", "median"))
            text = " / ".join(f"{value:.0f}" for value in three)
            rows.setdefault(row["method"], [row["method"]]).append(text)
    return [heads, *rows.values()]


def _pair(row: Record, part: str) -> str:
    return f"{row[f'{part}_rmse_mm']:.0f} / {row[f'{part}_mae_mm']:.0f}"


def with_newer(record: Record, newer: Record) -> Record:
    """Replace the cases of a health record, and their delays, by a later run of some of them."""
    found = dict(record)
    for key in ("cases", "delays"):
        later = {each["case"]: each for each in newer[key]}
        found[key] = [later.get(each["case"], each) for each in record[key]]
    return found


def sensor_health(
    simulated: Record, real: Record, newer_simulated: Record, newer_real: Record
) -> Rows:
    """Give the rows of the health monitor: AUROC by severity, alarms and delays."""
    simulated, real = with_newer(simulated, newer_simulated), with_newer(real, newer_real)
    rows: Rows = [
        ["kind", "simulated, severity 1 to 5", "real, severity 1 to 5", "alarms", "delay, frames"]
    ]
    kinds = dict.fromkeys(case["case"].rpartition("-")[0] for case in simulated["cases"])
    for kind in kinds:
        cases = [
            [each for each in record["cases"] if each["case"].rpartition("-")[0] == kind]
            for record in (simulated, real)
        ]
        alarms = [
            next(f"{100 * each['alarms']:.0f} %" for each in side if each["severity"] == 3)
            for side in cases
        ]
        delays = [_delay(record, kind) for record in (simulated, real)]
        rows.append(
            [
                kind,
                *(" ".join(_share(each["own"]) for each in side) for side in cases),
                ", ".join(alarms),
                ", ".join(delays),
            ]
        )
        if cases[0][0]["together"] is not None:
            together = [" ".join(_share(each["together"]) for each in side) for side in cases]
            rows.append([f"{kind}, five frames together", *together, "", ""])
    return rows


def _share(value: float) -> str:
    return f"{value:.0f}" if value in (0.0, 1.0) else f"{value:.2f}"


def _delay(record: Record, kind: str) -> str:
    for row in record["delays"]:
        if row["case"].rpartition("-")[0] == kind:
            return "not raised" if row["delay_frames"] is None else f"{row['delay_frames']}"
    return "-"


def yaw(simulated: Record, real: Record) -> Rows:
    """Give the rows of the yaw estimate, with and without the data's own yaw."""
    errors = ["median error, degrees", "90 %", "less the data's own yaw: median", "90 %"]
    rows: Rows = [["frames", "together", "estimates", *errors]]
    for name, record in (("simulated", simulated), ("real", real)):
        for row in record["results"]:
            keys = ("median_deg", "p90_deg", "own_median_deg", "own_p90_deg")
            cells = [f"{row[key]:.3f}" for key in keys]
            rows.append([name, f"{row['frames']}", f"{row['estimates']}", *cells])
    return rows


def lidar_height(in_space: Record, in_image: Record) -> Rows:
    """Give the rows of a LiDAR at other heights, scored in 3D and in the image."""
    classes = ("Car", "Pedestrian", "Cyclist")
    head = ["LiDAR", "given height", "height used [m]"]
    rows: Rows = [[*head, *(f"{where}: {name}" for where in ("3D", "2D") for name in classes)]]
    for space, image in zip(in_space["results"], in_image["results"], strict=True):
        up_m = space["up_m"]
        title = f"{abs(up_m):g} m {'higher' if up_m > 0 else 'lower'}" if up_m else "as KITTI's"
        height_m = KITTI_LIDAR_HEIGHT_M if space["height_m"] is None else space["height_m"]
        scores = (f"{row[name]:.1f}" for row in (space, image) for name in classes)
        rows.append([title, space["source"], f"{height_m:.2f}", *scores])
    return rows


def own_sensor(record: Record) -> Rows:
    """Give the rows of other sensors than KITTI's."""
    columns = [("bbox", "Car"), ("bbox", "Pedestrian"), ("3d", "Car"), ("3d", "Pedestrian")]
    names = {"bbox": "2D", "3d": "3D"}
    head = ["sensors", "pixels", *(f"{names[metric]}: {name}" for metric, name in columns)]
    rows: Rows = [[*head, "depth: RMSE", "MAE", "median"]]
    for row in record["results"]:
        for pixels, key in (("own", "objects"), ("KITTI's", "objects_in_kitti_pixels")):
            if pixels != "own" and row[key] == row["objects"]:
                continue
            cells = [
                f"{each['ap_r40']:.1f} ({each['num_objects']}; {_range(each['ap_all_points_95'])})"
                for metric, name in columns
                for each in row[key]
                if (each["metric"], each["class_name"]) == (metric, name)
            ]
            depth = [f"{row['depth'][each]:.0f}" for each in ("rmse_mm", "mae_mm", "median_mm")]
            title = RIGS[row["rig"]].title if pixels == "own" else ""
            rows.append([title, pixels, *cells, *(depth if pixels == "own" else [""] * 3)])
    return rows


def _range(ends: list[float]) -> str:
    return f"[{ends[0]:.0f}, {ends[1]:.0f}]"


def sim_or_real(record: Record) -> Rows:
    """Give the rows of judges that separate simulated from real frames."""
    rows: Rows = [["judge", "balanced accuracy"]]
    for row in record["results"]:
        limits = f"[{row['low']:.2f}, {row['high']:.2f}]"
        rows.append([row["judge"], f"{row['balanced_accuracy']:.2f} {limits}"])
    return rows


_CORE_COLUMNS = {
    "detection2d-best, image": ("image", "bbox", 0.7),
    "detection3d-best, 3D": ("sweep", "3d", 0.7),
    "3D, IoU 0.5": ("sweep", "3d", 0.5),
    "joined, image": ("joined", "bbox", 0.7),
    "joined, 3D": ("joined", "3d", 0.7),
    "joined, 3D, 0.5": ("joined", "3d", 0.5),
}
_SOUND_BESIDE = {"camera_": ("camera_blank",), "lidar_": ("lidar_blank",), "sun_": ()}
"""States in which the image detector has the sound sensors of a kind alone; others have both."""


def core(record: Record) -> Rows:
    """Give a row for each fault: AP of cars, also less the better sound sensor's in the image."""
    image, *others = _CORE_COLUMNS
    rows: Rows = [["fault", image, "less the better sound sensor", *others]]
    found = {
        (row["case"], name, row["metric"], row["iou"]): row.get(name, 0.0)
        for row in record["results"]
        if row["class"] == "Car"
        for name in ("image", "sweep", "joined")
    }
    cases = dict.fromkeys(row["case"] for row in record["results"])
    for case in ("clean", *(case for case in cases if case.endswith("-3"))):
        first, *rest = (found[case, *column] for column in _CORE_COLUMNS.values())
        kind = next((kind for kind in _SOUND_BESIDE if case.startswith(kind)), None)
        alone = ("camera_blank", "lidar_blank") if kind is None else _SOUND_BESIDE[kind]
        sound = [found[state, *_CORE_COLUMNS[image]] for state in alone]
        less = f"{first - max(sound):+.0f}" if sound else ""
        title = case.removesuffix("-3").replace("_", " ")
        rows.append([title, f"{first:.0f}", less, *(f"{score:.0f}" for score in rest)])
    return rows
