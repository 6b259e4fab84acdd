"""The course's two-stage table: first stage alone, baseline, improved; paired intervals.

`python -m benchmarks.two_stage_ablation RESULTS LABELS --sample_list LIST`. RESULTS has a folder of
result files for each row, as `sightline reproduce two-stage --out RESULTS` writes them: first,
baseline, improved; further ones, such as baseline_with_AdamW, are named by `--rows`. Cars in 3D at
the course's IoU of 0.5 and at 0.7. The frames are resampled, the same for all rows, which gives the
interval of each difference. Its last line is kept in benchmarks/results: two_stage.json, and
two_stage_small.json of a smaller training.
"""

import itertools
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import jsonargparse

from benchmarks.record import print_record
from benchmarks.table_papers import stage_name
from sightline.evaluation.kitti_object import compare_objects, evaluate_objects, frame_names
from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Metric
from sightline.papers.rows import class_scores, levels_text, select_entries
from sightline.papers.two_stage import car_overlaps
from sightline.papers.two_stage_rows import IOUS, NAMES, PUBLISHED

_CLASS: Final[ClassName] = "Car"
_METRIC: Final[Metric] = "3d"


def main(
    results: Path,
    labels: Path,
    sample_list: Path | None = None,
    rows: Sequence[str] = tuple(NAMES),
    resamples: int = 1000,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        results: Folder of the rows' result files.
        labels: Folder of KITTI's label files.
        sample_list: Text file with one frame's name a line. None: all with labels.
        rows: The rows, by their folders; each is compared with all before it.
        resamples: Number of resamples of the frames.

    Raises:
        ValueError: A row has no folder, or as `evaluate_objects`.
    """
    missing = [row for row in rows if not (results / row).is_dir()]
    if missing:
        raise ValueError(
            f"{results} has no folder {', '.join(missing)}; write it by `sightline reproduce "
            f"two-stage --out {results}` with the row's weights, or leave it out of --rows"
        )
    frames = frame_names(labels, sample_list)
    scores = {row: _scores(results / row, labels, frames, resamples) for row in rows}
    differences = [
        difference
        for other, row in itertools.combinations(rows, 2)
        for difference in _differences(results, row, other, labels, frames, resamples)
    ]
    print(f"{len(frames)} frames, cars in 3D: R11, R40, all points, easy / moderate / hard")
    print(f"{'the course':<22} IoU 0.5  {levels_text(PUBLISHED)}")
    for row, by_iou in scores.items():
        for iou, each in by_iou.items():
            texts = (levels_text(each[key]) for key in ("ap_r11", "ap_r40", "ap_all_points"))
            print(f"{stage_name(row):<22} IoU {iou}  {'   '.join(texts)}")
    for each in differences:
        low, high = each["r40"]["difference_95"] or (float("nan"),) * 2
        print(
            f"{each['row']} less {each['less']}, IoU {each['iou']}, {each['difficulty']}: "
            f"R40 {each['r40']['difference']:+.1f} [{low:+.1f}, {high:+.1f}]"
        )
    content = {
        "frames": len(frames),
        "resamples": resamples,
        "class": _CLASS,
        "metric": _METRIC,
        "difficulties": list(DIFFICULTIES),
        "published": {"iou": IOUS[0], "ap_r11": list(PUBLISHED)},
        "rows": scores,
        "differences": differences,
    }
    print_record(content, seed=0)


def _scores(
    folder: Path, labels: Path, frames: Sequence[str], resamples: int
) -> dict[str, dict[str, Any]]:
    """Score a row: AP by difficulty and the number of objects, by IoU."""
    scores = {}
    for iou in IOUS:
        report = evaluate_objects(
            folder, labels, sample_list=frames, overlaps=car_overlaps(iou), bootstrap=resamples
        )
        entries = select_entries(report, _CLASS, _METRIC)
        num_objects = [entries[each].n_gt if each in entries else 0 for each in DIFFICULTIES]
        scores[f"{iou:g}"] = {
            **asdict(class_scores(entries, with_all_points=True)),
            "num_objects": num_objects,
        }
    return scores


def _differences(
    results: Path,
    row: str,
    other: str,
    labels: Path,
    frames: Sequence[str],
    resamples: int,
) -> list[dict[str, Any]]:
    """Compare a row with another, by IoU and difficulty."""
    found = []
    for iou in IOUS:
        compared = compare_objects(
            results / row,
            labels,
            results / other,
            sample_list=frames,
            overlaps=car_overlaps(iou),
            bootstrap=resamples,
        )
        found += [
            {
                "row": row,
                "less": other,
                "iou": iou,
                "difficulty": entry.difficulty,
                "r40": entry.r40.to_json(),
                "all_points": entry.all_points.to_json(),
            }
            for entry in compared.entries
            if (entry.class_name, entry.metric) == (_CLASS, _METRIC)
            and entry.r40 is not None
            and entry.all_points is not None
        ]
    return found


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=True)
