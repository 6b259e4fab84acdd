"""Pictures of `evaluate objects --plots`."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sightline.evaluation.object_report import ObjectReport
    from sightline.structures.score_curves import PrecisionRecall


def write_object_plots(report: "ObjectReport", folder: Path) -> int:
    """Draw precision over recall for each class and metric, over all distances and in each band.

    The files are CLASS_METRIC.png, and for a band CLASS_METRIC_FROM-TOm.png; those of an earlier
    run are replaced.

    Args:
        report: Report of the evaluation.
        folder: Output folder; created if missing.

    Returns:
        Number of pictures; 0 without detections.
    """
    from sightline.data.formats.image_file import write_rgb
    from sightline.visualization.precision_recall import draw_precision_recall

    parts = [("", report.entries), *((band.title, band.entries) for band in report.bands)]
    pictures = 0
    for band, entries in parts:
        keys = dict.fromkeys((entry.class_name, entry.metric) for entry in entries)
        for class_name, metric in keys:
            curves: dict[str, PrecisionRecall] = {
                entry.difficulty: entry.curve()
                for entry in entries
                if (entry.class_name, entry.metric) == (class_name, metric)
            }
            words = [class_name, metric, *([band] if band else [])]
            name = "_".join(words).replace(" ", "_")
            write_rgb(folder / f"{name}.png", draw_precision_recall(", ".join(words), curves))
            pictures += 1
    return pictures
