"""Tables of the results' pages, written from `benchmarks/results`: `python -m benchmarks.tables`.

A page holds `<!-- table: NAME -->`, the table with a line on its origin, and `<!-- end -->`. The
command rewrites everything between the two marks; `--check` only compares, and fails if a page and
its record differ.
"""

import argparse
import hashlib
import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from benchmarks import (
    table_accuracy,
    table_board,
    table_joined,
    table_papers,
    table_rigs,
    table_scale,
    table_sensors,
    table_speed,
)

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "benchmarks" / "results"
WEIGHTS: Final = ROOT / "src" / "sightline" / "weights"
_BLOCK: Final = re.compile(r"<!-- table: ([\w-]+) -->\n.*?<!-- end -->", re.DOTALL)

Record = dict[str, Any]
Rows = list[list[str]]


class Table(NamedTuple):
    """One generated table."""

    records: tuple[str, ...]
    """Names of its files in `benchmarks/results`."""
    rows: Callable[..., Rows]
    """Function from the files' contents to rows, headings first."""


TABLES: Final = {
    "scoreboard": Table(
        (
            "real_depth_truth", "detection3d", "detection_accuracy", "detection2d",
            "held_out_rings", "depth_completion", "sensor_health", "sensor_health_weather",
            "kitti_evaluation", "joined", "quoted",
        ),
        table_board.scoreboard,
    ),
    "detection2d-best": Table(("detection_accuracy",), table_accuracy.detection2d_best),
    "detection2d-fast-cpu": Table(("detection_accuracy",), table_accuracy.detection2d_fast_cpu),
    "detection3d-best": Table(("detection_accuracy",), table_accuracy.detection3d_best),
    "detection3d-fast-cpu": Table(("detection_accuracy",), table_accuracy.detection3d_fast_cpu),
    "real-truth": Table(("real_depth_truth",), table_accuracy.real_truth),
    "real-truth-fewer-beams": Table(("real_depth_truth",), table_accuracy.real_truth_fewer_beams),
    "held-out-rings": Table(("held_out_rings",), table_accuracy.held_out_rings),
    "valid-depth": Table(("valid_depth",), table_accuracy.valid_depth),
    "hidden-sweep": Table(("hidden_sweep",), table_sensors.hidden_sweep),
    "image-depth-rigs": Table(
        ("image_depth_rigs", "image_depth_nuscenes"), table_sensors.image_depth
    ),
    "depth-faults": Table(("depth_robustness",), table_sensors.depth_faults),
    "depth-faults-train": Table(("depth_robustness_sample_train",), table_sensors.depth_faults),
    "depth-faults-simulated": Table(("depth_robustness_simulated",), table_sensors.depth_faults),
    "sensor-health": Table(
        ("sensor_health", "sensor_health_weather"), table_sensors.sensor_health
    ),
    "yaw": Table(("yaw_error",), table_sensors.yaw),
    "lidar-height": Table(("lidar_height",), table_sensors.lidar_height),
    "own-sensor": Table(("own_sensor",), table_sensors.own_sensor),
    "sim-or-real": Table(("sim_or_real",), table_sensors.sim_or_real),
    "gated-fusion-table-1": Table(("gated_fusion_table_1",), table_papers.table_1),
    "gated-fusion-simulated": Table(("gated_fusion_simulated",), table_papers.fusion_differences),
    "gated-fusion-sample-train": Table(
        ("gated_fusion_sample_train",), table_papers.fusion_differences
    ),
    "gated-fusion-sample-val": Table(("gated_fusion_sample_val",), table_papers.fusion_differences),
    "gated-fusion-width-1": Table(("gated_fusion_full_width",), table_papers.fusion_differences),
    "gated-fusion-gates": Table(("gated_fusion_table_1",), table_papers.gate_means),
    "two-stage": Table(("two_stage",), table_papers.two_stage),
    "two-stage-differences": Table(("two_stage",), table_papers.two_stage_differences),
    "two-stage-small": Table(("two_stage_small",), table_papers.two_stage),
    "two-stage-small-differences": Table(
        ("two_stage_small",), table_papers.two_stage_differences
    ),
    "time-depth": Table(("depth_completion",), table_speed.depth),
    "time-detection2d": Table(("detection2d",), table_speed.detection2d),
    "time-detection3d": Table(("detection3d",), table_speed.detection3d),
    "time-all": Table(("joined_time",), table_speed.all_tasks),
    "kitti-evaluation": Table(("kitti_evaluation",), table_speed.kitti_evaluation),
    "rotated-iou": Table(("rotated_iou",), table_speed.rotated_iou),
    "corruptions": Table(("corruptions",), table_speed.corruptions),
    "point-ops": Table(("point_ops",), table_speed.point_ops),
    "raycast": Table(("raycast",), table_speed.raycast),
    "simulate": Table(("simulate",), table_speed.simulate),
    "joined": Table(("joined", "joined_sample_train"), table_joined.joined),
    "joined-rigs": Table(("joined_rigs", "joined_views"), table_joined.joined),
    "joined-pairs": Table(
        ("joined_best_fast", "joined_fast_best", "joined_fast"), table_joined.pairs
    ),
    "joined-faults": Table(("joined_faults",), table_joined.faults),
    "joined-faults-train": Table(("joined_sample_train_faults",), table_joined.faults),
    "joined-simulated": Table(("joined_simulated",), table_joined.faults),
    "core": Table(("joined_simulated",), table_sensors.core),
    "joined-calibration": Table(
        (
            "joined_calibration",
            "joined_calibration_sample_train",
            "joined_calibration_simulated",
        ),
        table_joined.calibration,
    ),
    "page": Table(("page_latency",), table_speed.page),
    "rigs-detection2d": Table(("rigs",), table_rigs.detection2d),
    "rigs-detection3d": Table(("rigs",), table_rigs.detection3d),
    "rigs-depth": Table(("rigs",), table_rigs.depth),
    "rigs-cost": Table(("rigs",), table_rigs.cost),
    "memory": Table(("flat_memory",), table_speed.flat_memory),
    "growth": Table(("growth",), table_scale.growth),
    "two-workers": Table(("two_workers",), table_scale.two_workers),
    "ray-overhead": Table(("ray_overhead",), table_scale.ray_overhead),
    "random-kills": Table(("random_kills",), table_scale.random_kills),
    "ten-million": Table(("growth",), table_scale.ten_million),
}  # fmt: skip


def main(*, check: bool = False) -> None:
    """Rewrite all tables of the results' pages.

    Args:
        check: Compare only; exit with status 1 where a page differs from its records.
    """
    stale = []
    for page in pages():
        text = page.read_text()
        fresh = rendered(text)
        if fresh != text:
            stale.append(page.relative_to(ROOT).as_posix())
            if not check:
                page.write_text(fresh)
    if check and stale:
        sys.exit(f"{', '.join(stale)} differ from benchmarks/results; run `make results`")
    print(f"{'stale' if check else 'written'}: {', '.join(stale) or 'none'}")


def pages() -> list[Path]:
    """List the pages that hold tables."""
    docs = ROOT / "docs"
    own = [docs / "results.md", docs / "guides" / "scale.md"]
    return [*own, *sorted((docs / "results").glob("*.md"))]


def rendered(text: str) -> str:
    """Rewrite the tables in a page's text.

    Raises:
        ValueError: The page names a table that is not in `TABLES`.
    """
    return _BLOCK.sub(lambda block: _block(block[1]), text)


def load(name: str) -> list[Record]:
    """Read the records of a result file; most files hold one."""
    content = json.loads((RESULTS / f"{name}.json").read_text())
    return content if isinstance(content, list) else [content]


def table(name: str) -> Rows:
    """Compute a table's rows, headings first."""
    records, rows = TABLES[name]
    return rows(*(record for each in records for record in load(each)))


def origin(name: str, record: Record) -> str:
    """Format the origin of a record in one line."""
    commit = record["commit"] if record.get("commit_kept", True) else "not kept"
    parts = [
        f"`benchmarks/results/{name}.json`: `{record['command']}`",
        f"commit {commit}{', with changes' if record['dirty'] else ''}",
        record["date"],
        "no seed" if record["seed"] is None else f"seed {record['seed']}",
        *weights_of(record),
        f"{record['machine']['processor']}, {record['machine']['cores']} cores",
    ]
    return "; ".join(parts) + "."


def weights_of(record: Record) -> Iterator[str]:
    """List which weights of a record ship, ship in a later version, or do not ship."""
    states: dict[str, list[str]] = {}
    for name, digest in record["weights"].items():
        path = WEIGHTS / f"{name}.safetensors"
        state = "weights that do not ship"
        if path.is_file():
            is_same = hashlib.sha256(path.read_bytes()).hexdigest() == digest
            state = "weights as shipped" if is_same else "**earlier weights**"
        states.setdefault(state, []).append(name)
    for state, names in states.items():
        yield f"{state}: {', '.join(names)}"


def _block(name: str) -> str:
    if name not in TABLES:
        raise ValueError(f"there is no table {name}; name one of {', '.join(TABLES)}")
    head, *body = table(name)
    lines = [_line(head), "|---" * len(head) + "|", *map(_line, body)]
    text = f"<!-- table: {name} -->\n\n" + "\n".join(lines) + "\n\n"
    if name != "scoreboard":
        origins = [origin(each, record) for each in TABLES[name].records for record in load(each)]
        text += "\n".join(origins) + "\n\n"
    return text + "<!-- end -->"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="compare only")
    main(check=parser.parse_args().check)
