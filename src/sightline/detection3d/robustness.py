"""Robustness scoring of 3D detection: KITTI's evaluation of 3D boxes under sensor faults."""

from typing import Final, Literal

from sightline.detection3d.files import read_detections, write_results
from sightline.detection3d.pictures import DRAWN_SCORE, labels_from_above
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import BenchPrediction, Panel
from sightline.structures.level import level_detections, level_sample
from sightline.visualization.birds_eye import BirdsEyeView, put_boxes_from_above
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.image import camera_picture, draw_boxes3d

_VIEWS: Final[tuple[Literal["3d", "bev"], ...]] = ("3d", "bev")
_VIEW: Final = BirdsEyeView(x_max_m=60.0, y_min_m=-30.0, y_max_m=30.0)


def _panels(prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
    """Draw boxes on the image and from above; labels are thin and white."""
    given = prediction.corrupted.sample
    found = level_detections(prediction.output.filter_by_score(DRAWN_SCORE), given)
    given = level_sample(given)
    boxes, names = found.boxes, found.class_names
    picture = draw_boxes3d(
        camera_picture(given), boxes, names, given.calibration, scores=found.scores
    )
    above = labels_from_above(given, _VIEW)
    put_boxes_from_above(above, _VIEW, boxes, names)
    panels = (Panel("detections", picture), Panel("from above, labels white", above))
    return tuple(Panel(name, scaled_to_width(each, width_px)) for name, each in panels)


SCORING: Final = ObjectScoring(
    targets=(
        *(Target("Car", view, iou) for view in _VIEWS for iou in (0.7, 0.5)),
        *(Target(name, view, 0.5) for name in ("Pedestrian", "Cyclist") for view in _VIEWS),
    ),
    write=write_results,
    read_file=read_detections,
    panels=_panels,
)
