"""How it is scored where sensors are broken."""

from sightline.detection2d.answers import read_answer
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import Panel
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.image import camera_picture
from tests.toy_task.registration import _write_results


def _panels(answered, width_px):
    return (Panel("image", scaled_to_width(camera_picture(answered.corrupted.sample), width_px)),)


SCORING = ObjectScoring(
    targets=(Target("Car", "bbox", 0.1),),
    write=_write_results,
    read_file=read_answer,
    panels=_panels,
)
