"""Rows of the tables of many frames, and the needs of ten million computed from them."""

from typing import Any, Final

Record = dict[str, Any]
Rows = list[list[str]]

_FULL_SIZE: Final = "perceive-full-size"
_FRAMES: Final = 10_000_000
_CORES: Final = 16  # of a machine
_FRAMES_PER_SHARD: Final = 1000
_HOURS: Final = 24
_STORAGE_GB_S: Final = 1.25  # 10 Gbit/s
_LOCAL: Final = "local"


def growth(*records: Record) -> Rows:
    """Give the rows of commands by number of frames."""
    rows: Rows = [
        ["command", "start, processor s", "frames", "processor ms a frame", "memory, MiB",
         "files open", "bytes written a frame"],
    ]  # fmt: skip
    earlier = None
    for row in (row for record in records for row in record["results"]):
        if row["work"] == _FULL_SIZE:
            continue
        is_first, earlier = row["work"] != earlier, row["work"]
        has_bytes = row["work"] != "evaluate"
        rows.append(
            [
                row["work"] if is_first else "",
                f"{row['start_processor_s']:.1f}" if is_first else "",
                f"{row['frames']:,}",
                f"{row['processor_ms']:.2f}",
                f"{row['mib']:,}",
                f"{row['open_files']}",
                f"{row['bytes']:,}" if has_bytes else "-",
            ]
        )
    return rows


def two_workers(record: Record) -> Rows:
    """Give the times of two workers beside those of one."""
    rows: Rows = [
        ["command", "wall ms a frame, one worker", "two", "times as fast",
         "processor ms a frame, one worker", "two", "cores used by other programs"],
    ]  # fmt: skip
    pairs = zip(record["results"][::2], record["results"][1::2], strict=True)
    for one, two in pairs:
        rows.append(
            [
                one["work"],
                f"{one['wall_ms']:.2f}",
                f"{two['wall_ms']:.2f}",
                f"{one['wall_ms'] / two['wall_ms']:.2f}",
                f"{one['processor_ms']:.2f}",
                f"{two['processor_ms']:.2f}",
                f"{one['others']:.2f}, {two['others']:.2f}",
            ]
        )
    return rows


def ray_overhead(record: Record) -> Rows:
    """Give the processor times of an actor of Ray beside those of a process."""
    local, ray = (
        next(row for row in record["results"] if row["driver"] == driver)
        for driver in (_LOCAL, "ray")
    )
    rows: Rows = [["driver", "processor ms a frame", "times local", "fixed, processor s"]]
    for row in (local, ray):
        ratio = row["processor_ms"] / local["processor_ms"]
        cells = [f"{row['processor_ms']:.2f}", f"{ratio:.2f}", f"{row['fixed_processor_s']:.1f}"]
        rows.append([row["driver"], *cells])
    return rows


def random_kills(record: Record) -> Rows:
    """Give the row of a job whose workers and programs were killed."""
    killed = record["killed"]
    return [
        ["frames", "workers killed", "times the whole job was killed", "exit status", "bytes"],
        [
            f"{record['frames']:,}",
            f"{killed['workers']}",
            f"{killed['programs']}",
            f"{record['status']}",
            "equal" if record["equal"] else "**different**",
        ],
    ]


def ten_million(*records: Record) -> Rows:
    """Compute what ten million frames need, from the figures of frames of KITTI's size."""
    row = [row for record in records for row in record["results"] if row["work"] == _FULL_SIZE][-1]
    frame_s = row["processor_ms"] / 1000
    total_s = frame_s * _FRAMES
    machines = total_s / (_HOURS * 3600 * _CORES)
    core_gb_s = row["frame_bytes"] / frame_s / 1e9
    all_gb_s = machines * _CORES * core_gb_s
    bottleneck = "processors" if all_gb_s < _STORAGE_GB_S else "storage"
    lost_s = row["start_processor_s"] + _FRAMES_PER_SHARD * frame_s / 2
    return [
        ["need of 10,000,000 frames", "value"],
        ["processor time of a frame", f"{frame_s:.2f} s of a core"],
        ["processor time of all", f"{total_s / 3600:,.0f} hours of a core"],
        [f"machines of {_CORES} cores for {_HOURS} hours", f"{machines:,.1f}"],
        ["frames in shards", f"{_FRAMES * row['frame_bytes'] / 1e12:,.1f} TB"],
        ["results in shards", f"{_FRAMES * row['bytes'] / 1e12:,.2f} TB"],
        [
            f"files, with {_FRAMES_PER_SHARD:,} frames in a shard",
            f"{4 * _FRAMES // _FRAMES_PER_SHARD:,}",
        ],
        ["memory of a worker", f"{row['mib']:,} MiB"],
        ["read by a core", f"{1000 * core_gb_s:,.1f} MB/s"],
        ["read by all cores", f"{all_gb_s:,.2f} GB/s"],
        [f"bottleneck, beside storage of {_STORAGE_GB_S:g} GB/s", bottleneck],
        ["lost with a killed worker, on average", f"{lost_s:,.0f} s of a core: half a shard"],
        [
            "lost with a whole job that is killed and started again, on average",
            f"the same for each worker, {machines * _CORES * lost_s / 3600:,.1f} hours of a core "
            "in all; the results are read once for their checksums",
        ],
    ]
