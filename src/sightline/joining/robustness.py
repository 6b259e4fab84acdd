"""Robustness of joined objects under sensor faults: scored in the image and in space."""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import UInt8

from sightline.data.formats.kitti_conversion import detections2d_from_kitti
from sightline.data.formats.kitti_labels import read_results
from sightline.detection3d.files import read_results as read_boxes3d
from sightline.detection3d.pictures import DRAWN_SCORE, labels_from_above
from sightline.export.names import EngineChoice
from sightline.joining.files import write_objects
from sightline.joining.models import JOINED
from sightline.joining.predictor import JoinedPredictor
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import BenchPrediction, Panel
from sightline.structures.level import level_view
from sightline.structures.predictions import Perception
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, put_boxes_from_above
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.image import camera_picture, draw_detections, sweep_picture
from sightline.visualization.objects import box_styles, draw_objects

_VIEW: Final = BirdsEyeView(x_max_m=60.0, y_min_m=-30.0, y_max_m=30.0)


def _write_in_image(path: Path, sample: CameraLidarSample, prediction: Perception) -> None:
    assert prediction.objects is not None, "the predictor joins"
    write_objects(path, sample, prediction.objects)


def _write_in_space(path: Path, sample: CameraLidarSample, prediction: Perception) -> None:
    assert prediction.objects is not None, "the predictor joins"
    write_objects(path, sample, prediction.objects, in_space=True)


def _read(path: Path, sample: CameraLidarSample) -> Perception:
    """Read both boxes of a result file of any method."""
    in_image = Perception(detections2d=detections2d_from_kitti(read_results(path)))
    return read_boxes3d(path, sample, in_image)


def _panels(prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
    """Draw boxes on the image, or the sweep without one, and from above; labels are white."""
    sample, found = level_view(
        prediction.corrupted.sample, prediction.output.filter_by_score(DRAWN_SCORE)
    )
    picture = camera_picture(sample) if sample.image is not None else sweep_picture(sample)
    above = labels_from_above(sample, _VIEW)
    if found.objects is None:
        picture = draw_detections(
            picture, found.detections2d, found.detections3d, sample.calibration
        )
        if found.detections3d is not None:
            boxes3d, names = found.detections3d.boxes, found.detections3d.class_names
            put_boxes_from_above(above, _VIEW, boxes3d, names)
    else:
        objects, styles = found.objects, box_styles(found.objects, sample)
        picture = draw_objects(picture, objects, sample)
        put_boxes_from_above(above, _VIEW, objects.boxes3d, objects.class_names, styles=styles)
    return (
        _panel("objects", picture, width_px),
        _panel("from above, labels white", above, width_px),
    )


def _panel(caption: str, picture: UInt8[np.ndarray, "height width 3"], width_px: int) -> Panel:
    return Panel(caption, scaled_to_width(picture, width_px))


SCORING: Final = ObjectScoring(
    targets=(
        *(Target("Car", metric, iou) for metric in ("bbox", "3d", "bev") for iou in (0.7, 0.5)),
        *(
            Target(name, metric, 0.5)
            for name in ("Pedestrian", "Cyclist")
            for metric in ("bbox", "3d", "bev")
        ),
    ),
    by_centre=("Car", "Pedestrian", "Cyclist"),
    write=_write_in_image,
    write_in_space=_write_in_space,
    read_file=_read,
    panels=_panels,
)


class JoinedTask:
    """Joined objects as a task of the robustness bench."""

    name: Final = JOINED
    methods: Final[tuple[str, ...]] = ()

    def scoring(self) -> ObjectScoring:
        """Scoring by KITTI's evaluation in the image and in space, and by centre distance."""
        return SCORING

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> JoinedPredictor:
        """Load the predictor with the weights for which the scores were fitted.

        Raises:
            ValueError: A method or other weights are given.
        """
        if method is not None or weights not in (None, JOINED):
            raise ValueError(
                f"joined objects come from the weights for which their scores were fitted, not by "
                f"{method or weights}; leave --method, --weights and a --baseline of weights out"
            )
        return JoinedPredictor.load(engine=engine, device=device, threads=threads)
