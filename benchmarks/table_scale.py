"""Rows of the table of killed jobs."""

from typing import Any

Record = dict[str, Any]
Rows = list[list[str]]


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
