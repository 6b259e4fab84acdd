"""2D detection part of the demo: a frame with both sensors, and with either of them dead."""

import html
from pathlib import Path

import numpy as np

from sightline.corruptions.suites import CLEAN, find_suite
from sightline.data.formats.image_file import write_rgb
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.results import DRAWN_SCORE, prediction_row
from sightline.inference.demo import DemoPart, Headline
from sightline.inference.predict import predict
from sightline.inference.predictor import PredictingTask
from sightline.robustness.page import plain_table
from sightline.robustness.texts import TextTable

_CASE_NAMES = {  # cases of the suite, with their names in the report
    CLEAN: "both sensors",
    "camera_blank": "the camera dead",
    "lidar_blank": "the LiDAR dead",
}
_HTML = """<p>Cars, pedestrians and cyclists by <b>{name}</b>, in <code>detections/</code> as
KITTI's result files. The picture on top is frame {frame} with both sensors, without the camera and
without the LiDAR; its gates (from 0, closed, to 1, open) let through what the sensors still
deliver.</p>
{table}"""


def run_detection_demo(
    task: PredictingTask, predictor: DetectionPredictor, frames: Path, out: Path
) -> DemoPart:
    """Detect in frames, and in the first one also with a dead camera and with a dead LiDAR.

    Args:
        task: The 2D detection task, which writes the result files.
        predictor: The detector.
        frames: An object tree.
        out: Folder for all outputs; a second run makes only missing result files.

    Raises:
        ValueError: `out` cannot be written to.
    """
    detections, picture = out / "detections", out / "detections.png"
    remedy = f"to make them anew, remove {detections}"
    predict(task, predictor, frames, detections, workers=1, remedy=remedy)
    sample = open_dataset(frames)[0]
    rows, counts = [], {}
    for case in find_suite("dgfn7").select(_CASE_NAMES):
        corrupted = case.corrupt(sample).sample
        result = predictor(corrupted)
        name = _CASE_NAMES[case.name]
        rows.append(prediction_row(name, corrupted, result))
        counts[name] = len(result.detections.filter_by_score(DRAWN_SCORE).scores)
    write_rgb(picture, np.concatenate(rows))
    found = ", ".join(f"{count} with {name}" for name, count in counts.items())
    table = TextTable(
        title="",
        header=(f"frame {sample.sample_id}", "objects found"),
        rows=tuple((f"with {name}", str(count)) for name, count in counts.items()),
    )
    return DemoPart(
        title="2D detection",
        result=f"objects by {predictor.name}: {found}",
        files=(("objects", detections), ("picture", picture)),
        html=_HTML.format(
            name=html.escape(predictor.name),
            frame=html.escape(sample.sample_id),
            table=plain_table(table),
        ),
        headline=Headline(
            text=f"A sensor fails, the detector goes on. Objects found: {found}",
            picture=picture,
            caption=(
                "Detections of one frame with both sensors, the camera dead, the LiDAR dead; "
                "beside them the gates of both sensors. Labels are white."
            ),
        ),
    )
