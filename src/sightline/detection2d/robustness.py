"""Robustness scoring of 2D detection: KITTI's evaluation of 2D boxes under sensor faults."""

from typing import Final

from sightline.detection2d.results import prediction_panels, read_detections, write_results
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import BenchPrediction, Panel


def _panels(prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
    corrupted = prediction.corrupted
    masks = (corrupted.camera_mask, corrupted.lidar_mask)
    panels = prediction_panels(corrupted.sample, prediction.output, masks=masks, width_px=width_px)
    return tuple(Panel(f"{each.name} {each.note}".strip(), each.picture) for each in panels)


SCORING: Final = ObjectScoring(
    targets=(
        Target("Car", "bbox", 0.7),
        Target("Car", "bbox", 0.5),
        Target("Pedestrian", "bbox", 0.5),
        Target("Cyclist", "bbox", 0.5),
    ),
    write=write_results,
    read_file=read_detections,
    panels=_panels,
)
