"""Task for tests of the bench: an oracle that finds the labelled objects."""

from dataclasses import dataclass

import numpy as np

from sightline.files.atomic import atomic_write_text
from sightline.robustness.object_scoring import ObjectScoring, Target
from sightline.robustness.scoring import Panel
from sightline.simulation.packaged import PACKAGED_FRAMES

LABELS = PACKAGED_FRAMES / "training" / "label_2"


@dataclass(frozen=True)
class Oracle:
    """Predictor that returns all labels, or every second one if the image is black."""

    name: str = "oracle"
    parts = ("image", "points")
    needs = ("image",)
    gives = ("results",)
    made_by = {"version": "1"}  # noqa: RUF012 - as the protocol has it

    def __call__(self, sample):
        assert sample.objects is None, "methods never see labels"
        assert sample.depth is None, "nor true depth"
        lines = (LABELS / f"{sample.sample_id}.txt").read_text().splitlines()
        step = 1 if sample.image.any() else 2
        return "".join(f"{line} 0.9\n" for line in lines[::step] if not line.startswith("DontCare"))


def _write(path, sample, output):
    del sample
    atomic_write_text(path, output)


def _read(path, sample):
    del sample
    return path.read_text()


def _panels(prediction, width_px):
    del prediction
    return (Panel("detections", np.zeros((20, width_px, 3), np.uint8)),)


SCORING = ObjectScoring(
    targets=(Target("Car", "bbox", 0.7), Target("Car", "bbox", 0.5), Target("Cyclist", "3d", 0.5)),
    write=_write,
    read_file=_read,
    panels=_panels,
)


class OracleTask:
    name = "toy-oracle"
    methods = ("oracle", "other")

    def scoring(self):
        return SCORING

    def predictor(self, *, method=None, weights=None, engine="torch", device="cpu", threads=None):
        del weights, engine, device, threads
        return Oracle(method or "oracle")
