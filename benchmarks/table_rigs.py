"""Rows of the tables on other rigs: rig by network, scores, differences, time and memory."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

Record = dict[str, Any]
Rows = list[list[str]]

_DEPTH: Final = "depth-completion"
_ERRORS: Final = ("rmse_mm", "mae_mm", "median_mm")
_CLASSES: Final = {"Car": "cars", "Pedestrian": "pedestrians"}


def detection2d(record: Record) -> Rows:
    """Give the rows of 2D detection."""
    return _objects(record, "detection2d")


def detection3d(record: Record) -> Rows:
    """Give the rows of 3D detection."""
    return _objects(record, "detection3d")


def depth(record: Record) -> Rows:
    """Give the rows of depth completion, and of its differences."""
    names = _networks(record, _DEPTH)
    pairs = _pairs(record, names)
    rows: Rows = [["rig", "frames", *names, *(_less(pair) for pair in pairs)]]
    for each in _sets(record, _DEPTH):
        found = [_row(record, each, name) for name in names]
        cells = [" / ".join(f"{row[error]:.0f}" for error in _ERRORS) for row in found]
        cells += [_depth_difference(record, each, pair) for pair in pairs]
        rows.append([_title(each), f"{found[0]['frames']}", *cells])
    return rows


def cost(record: Record) -> Rows:
    """Give the rows of processor time and peak memory."""
    names = list(dict.fromkeys(row["network"] for row in record["results"]))
    rows: Rows = [["rig", *names]]
    for each in _sets(record):
        found = {row["network"]: row for row in record["results"] if row["set"] == each}
        cells = [
            f"{found[name]['ms']:.0f}; {found[name]['peak_mib']:.0f}" if name in found else ""
            for name in names
        ]
        rows.append([_title(each), *cells])
    return rows


def _objects(record: Record, task: str) -> Rows:
    names = _networks(record, task)
    pairs = _pairs(record, names)
    kinds = [_kind(score) for score in _row(record, _sets(record, task)[0], names[0])["scores"]]
    head = ["rig", "frames", "objects"]
    for name in (*names, *(_less(pair) for pair in pairs)):
        head += [f"{name}: {_CLASSES[label]}, {iou}" for label, _, iou in kinds]
    rows: Rows = [head]
    for each in _sets(record, task):
        found = [_row(record, each, name) for name in names]
        counts = dict.fromkeys(_CLASSES, 0)
        for score in (score for row in found for score in row["scores"]):
            counts[score["class"]] = max(counts[score["class"]], score.get("objects", 0))
        cells = [_title(each), f"{found[0]['frames']}", "; ".join(map(str, counts.values()))]
        cells += [_average(score) for row in found for score in row["scores"]]
        cells += [_difference(record, each, pair, kind) for pair in pairs for kind in kinds]
        rows.append(cells)
    return rows


def _average(score: Record) -> str:
    """Format AP over all points with its interval, and R40."""
    if "ap" not in score:
        return "-"
    limits = _interval(score["ap_95"])
    return f"{score['ap']:.0f}{limits}; {score['ap_r40']:.0f}"


def _difference(record: Record, name: str, pair: Sequence[str], kind: Sequence[object]) -> str:
    for score in _scores(record, name, pair):
        if _kind(score) == kind:
            return f"{score['difference']:+.1f}{_interval(score['difference_95'], signed=True)}"
    return "-"


def _depth_difference(record: Record, name: str, pair: Sequence[str]) -> str:
    return " / ".join(
        f"{score['difference']:+.0f}{_interval(score['difference_95'], signed=True)}"
        for score in _scores(record, name, pair)
    )


def _scores(record: Record, name: str, pair: Sequence[str]) -> Iterator[Record]:
    for each in record["differences"]:
        if (each["set"], each["first"], each["second"]) == (name, *pair):
            yield from each["scores"]


def _interval(ends: Sequence[float] | None, *, signed: bool = False) -> str:
    if ends is None:
        return ""
    return " [" + ", ".join(f"{end:+.0f}" if signed else f"{end:.0f}" for end in ends) + "]"


def _kind(score: Record) -> tuple[str, str, float]:
    return score["class"], score["metric"], score["iou"]


def _networks(record: Record, task: str) -> list[str]:
    return list(dict.fromkeys(row["network"] for row in record["results"] if row["task"] == task))


def _pairs(record: Record, names: Sequence[str]) -> list[tuple[str, str]]:
    pairs = [(each["first"], each["second"]) for each in record["differences"]]
    return [pair for pair in dict.fromkeys(pairs) if pair[0] in names]


def _sets(record: Record, task: str | None = None) -> list[str]:
    rows = record["results"]
    return list(dict.fromkeys(row["set"] for row in rows if task in (None, row["task"])))


def _row(record: Record, name: str, network: str) -> Record:
    return next(row for row in record["results"] if (row["set"], row["network"]) == (name, network))


def _less(pair: Sequence[str]) -> str:
    return f"{pair[0]} less {pair[1]}"


def _title(name: str) -> str:
    return name if " " in name else f"`{name}`"
