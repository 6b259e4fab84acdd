"""`sightline check`: validate a data set, and compare its rig with the networks' training."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sightline.cli.output import gathered_warnings, say
from sightline.cli.report import check_places
from sightline.files.atomic import atomic_write_text
from sightline.tasks import find_task, task_names

if TYPE_CHECKING:
    from sightline.data.checks.tree_checks import TreeSummary
    from sightline.files.problem import Problem
    from sightline.inference.rig_distance import RigDistance


def check(data: Path, *, workers: int = 2, json: Path | None = None) -> int:
    """Validate a data set: missing, truncated, non-finite and inconsistent files.

    Prints one line per problem with the file and the remedy, and one line if the camera or the
    LiDAR differ from what the shipped networks were trained on. Exit status: 0 if there is no
    problem, 1 otherwise.

    Args:
        data: A recording, or a KITTI object tree, depth completion tree or raw drive.
        workers: Number of reading threads.
        json: File for the summaries, the problems and the distance of the rig.
    """
    from sightline.data.check import check_tree, summarize_tree
    from sightline.data.open import existing_folder
    from sightline.inference.rig_distance import rig_distance

    existing_folder(data)
    check_places({"--json": json}, data=[data])
    problems = []
    with gathered_warnings():
        summaries = summarize_tree(data)
        for summary in summaries:
            say(summary)
        for problem in check_tree(data, num_workers=workers):
            say(problem)
            problems.append(problem)
    defaults = (find_task(name).default_weights for name in task_names())
    distance = rig_distance(data, [name for name in defaults if name is not None])
    if distance is not None:
        say(distance)
    if json is not None:
        atomic_write_text(json, _report(summaries, problems, distance))
    say(f"{len(problems) or 'no'} problem{'' if len(problems) == 1 else 's'}")
    return int(bool(problems))


def _report(
    summaries: "Sequence[TreeSummary]",
    problems: "Sequence[Problem]",
    distance: "RigDistance | None",
) -> str:
    content = {
        "data": [
            {
                "folder": str(each.folder),
                "kind": each.kind,
                "frames": each.num_frames,
                "parts": {part.name: part.num_files for part in each.parts},
                "note": each.note,
            }
            for each in summaries
        ],
        "problems": [
            {"path": str(each.path), "problem": each.problem, "remedy": each.remedy}
            for each in problems
        ],
        "rig": None if distance is None else distance.to_json(),
    }
    return json.dumps(content, indent=2) + "\n"
