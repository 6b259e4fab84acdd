"""3D detection part of the demo: frames with boxes in the image and from above."""

import html
from pathlib import Path

import numpy as np

from sightline.data.formats.image_file import write_rgb
from sightline.data.open import open_dataset
from sightline.detection3d.pictures import DRAWN_SCORE, prediction_picture
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.inference.demo import DemoPart
from sightline.inference.demo_page import picture_html
from sightline.inference.predict import predict
from sightline.inference.predictor import PredictingTask

_HTML = """<p>Cars, pedestrians and cyclists in the LiDAR sweep by <b>{name}</b>, in
<code>detections3d/</code> as KITTI's result files.</p>
{picture}"""


_CAPTION = (
    "What the first stage proposes, what the second makes of that, and all of it from above, for "
    "each frame. Labels are white."
)


def run_detection3d_demo(
    task: PredictingTask, predictor: Detection3DPredictor, frames: Path, out: Path
) -> DemoPart:
    """Detect objects in frames and draw each frame.

    Args:
        task: The 3D detection task, which writes the result files.
        predictor: The detector.
        frames: An object tree.
        out: Folder for all outputs; a second run makes only missing result files.

    Raises:
        ValueError: `out` cannot be written to.
    """
    detections, picture = out / "detections3d", out / "detections3d.png"
    remedy = f"to make them anew, remove {detections}"
    predict(task, predictor, frames, detections, workers=1, remedy=remedy)
    dataset = open_dataset(frames)
    pages, counts = [], []
    for sample in (dataset[index] for index in range(len(dataset))):
        proposed, found = predictor.both_stages(sample)
        pages.append(prediction_picture(f"Frame {sample.sample_id}", sample, proposed, found))
        counts.append(f"{len(found.filter_by_score(DRAWN_SCORE).scores)} in {sample.sample_id}")
    write_rgb(picture, np.concatenate(pages))
    return DemoPart(
        title="3D detection",
        result=f"3D objects by {predictor.name}: {', '.join(counts)}",
        files=(("3D boxes", detections), ("picture", picture)),
        html=_HTML.format(
            name=html.escape(predictor.name), picture=picture_html(picture, _CAPTION, is_wide=True)
        ),
    )
