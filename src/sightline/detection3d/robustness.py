"""Robustness scoring of 3D detection: KITTI's evaluation of 3D boxes under sensor faults."""

from typing import Final

from sightline.detection3d.answer_picture import DRAWN_SCORE, LABELLED
from sightline.detection3d.files import read_answer, write_results
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import BenchPrediction, Panel
from sightline.structures.level import level_detections, level_sample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.image import camera_picture, draw_boxes3d

_VIEW: Final = BirdsEyeView(x_max_m=60.0, y_min_m=-30.0, y_max_m=30.0)


def _panels(answered: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
    """Draw boxes on the image and from above; labels are thin and white."""
    given = answered.corrupted.sample
    found = level_detections(answered.answer.filter_by_score(DRAWN_SCORE), given)
    given = level_sample(given)
    boxes, names, labels = found.boxes, found.class_names, given.objects
    picture = draw_boxes3d(
        camera_picture(given), boxes, names, given.calibration, scores=found.scores
    )
    known = None if labels is None else labels.select(labels.has_box3d)
    above = draw_birds_eye(
        given.points,
        None if known is None else known.boxes3d,
        () if known is None else known.class_names,
        calibration=given.calibration,
        image_size=given.image_size,
        view=_VIEW,
        color=LABELLED,
    )
    put_boxes_from_above(above, _VIEW, boxes, names)
    panels = (Panel("detections", picture), Panel("from above, labels white", above))
    return tuple(Panel(name, scaled_to_width(each, width_px)) for name, each in panels)


SCORING: Final = ObjectScoring(
    targets=(
        Target("Car", "3d", 0.7),
        Target("Car", "3d", 0.5),
        Target("Car", "bev", 0.7),
        Target("Car", "bev", 0.5),
        Target("Pedestrian", "3d", 0.5),
        Target("Pedestrian", "bev", 0.5),
        Target("Cyclist", "3d", 0.5),
        Target("Cyclist", "bev", 0.5),
    ),
    write=write_results,
    read_file=read_answer,
    panels=_panels,
)
