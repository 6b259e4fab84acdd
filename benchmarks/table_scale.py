"""Rows of the tables of growth, and the needs of ten million frames computed from them."""

from typing import Any, Final

Record = dict[str, Any]
Rows = list[list[str]]

_FRAMES: Final = 10_000_000
_CORES: Final = 16  # of a machine
_FRAMES_PER_SHARD: Final = 1000
_HOURS: Final = 24


def growth(record: Record) -> Rows:
    """Give the rows of commands by number of frames."""
    rows: Rows = [
        ["command", "workers", "frames", "processor ms a frame", "memory, MiB", "files open",
         "bytes written a frame"],
    ]  # fmt: skip
    for row in record["results"]:
        cells = [f"{row['mib']:,}", f"{row['open_files']}", f"{row['bytes']:,}"]
        time = f"{row['processor_ms']:.1f}"
        rows.append([row["work"], f"{row['workers']}", f"{row['frames']:,}", time, *cells])
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


def ten_million(record: Record) -> Rows:
    """Compute what ten million frames need, from the figures of frames of KITTI's size."""
    row = record["full_size"]
    frame_s = row["processor_ms"] / 1000
    total_s = frame_s * _FRAMES
    shards = _FRAMES // _FRAMES_PER_SHARD
    machines = total_s / (_HOURS * 3600 * _CORES)
    core_gb_s = row["frame_bytes"] / frame_s / 1e9
    lost_s = row["start_processor_s"] + _FRAMES_PER_SHARD * frame_s / 2
    return [
        ["need of 10,000,000 frames", "value"],
        ["processor time", f"{total_s / 3600:,.0f} hours of a core"],
        [f"machines of {_CORES} cores for {_HOURS} hours", f"{machines:,.1f}"],
        ["frames in shards", f"{_FRAMES * row['frame_bytes'] / 1e12:,.1f} TB"],
        ["results in shards", f"{_FRAMES * row['bytes'] / 1e12:,.2f} TB"],
        [f"files, with {_FRAMES_PER_SHARD:,} frames in a shard", f"{4 * shards:,}"],
        ["memory of a worker", f"{row['mib']:,} MiB"],
        ["read by each core", f"{1000 * core_gb_s:,.1f} MB/s"],
        [
            "read by all cores",
            f"{machines * _CORES * core_gb_s:,.2f} GB/s",
        ],
        ["lost with a killed worker, on average", f"{lost_s:,.0f} s of a core, half a shard"],
    ]
