"""Fit of joined scores to two detectors, from frames to models."""

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor, DetectionResult
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.joining.fit_pair import FIT_CASES, any_fault, fit_pair, thin_sweep
from sightline.joining.models import CLASSES, read_models
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.joining.scenes import detections2d, detections3d, make_sample

BOXES = [(name, 0.9, 12.0 + 5 * i, 6.0 * i - 6, -0.95, 4.0, 1.8, 1.5, 0.0)
         for i, name in enumerate(CLASSES)]  # fmt: skip
SEEN = [(name, 0.8, (100.0 + 200 * i, 180.0, 160.0 + 200 * i, 240.0))
        for i, name in enumerate(CLASSES)]  # fmt: skip


class ImageDetector(DetectionPredictor):
    """Detector in the image with fixed boxes."""

    def __init__(self):
        self.name, self.sha256, self.engine = "image", "a", "torch"
        self.number = 0

    def predict(self, sample):
        del sample
        self.number += 1
        return DetectionResult(detections=detections2d(*SEEN))


class SweepDetector(Detection3DPredictor):
    """Detector in the sweep with fixed boxes."""

    def __init__(self):
        self.name, self.sha256, self.engine = "sweep", "b", "torch"
        self.number = 0

    def predict(self, sample):
        assert sample.points is not None
        self.number += 1
        return detections3d(*BOXES)

    def refine_boxes(self, sample, boxes):
        del sample, boxes
        return detections3d()


def test_models_fit_the_detectors_and_name_their_frames():
    dataset, in_image, in_sweep = open_dataset(PACKAGED_FRAMES), ImageDetector(), SweepDetector()
    models = fit_pair(dataset, in_image, in_sweep, data="street", frames=40)
    assert models.fits("a", "b")
    assert models.provenance["frames"] == "000000,000001"
    assert models.provenance["data"] == "street"
    assert models.provenance["states"] == list(FIT_CASES)
    assert in_image.number == 2 * len(FIT_CASES)
    assert in_sweep.number < 2 * (len(FIT_CASES) - 1)  # not again where the camera is blank
    again = fit_pair(dataset, ImageDetector(), SweepDetector(), data="street", frames=40)
    assert again == models
    one = fit_pair(dataset, ImageDetector(), SweepDetector(), data="street", frames=1)
    assert one.provenance["frames"] == "000000"
    with pytest.raises(ValueError, match="frames must be at least 1, got 0"):
        fit_pair(dataset, in_image, in_sweep, data="street", frames=0)


def test_a_lidar_without_rings_is_thinned_by_points_and_loses_no_rings():
    rng = np.random.default_rng(0)
    points = rng.uniform([5, -8, -1.7, 0], [60, 8, 3, 1], (4_000, 4)).astype(np.float32)
    sample = make_sample(points)
    shares = [len(thin_sweep(sample, place).points) / 4_000 for place in range(6)]
    assert shares == [0.25, 0.125, 0.5, 0.25, 0.125, 0.25]
    for place in range(60):
        assert torch.isfinite(any_fault(sample, place).points).all()


def test_the_command_writes_models_for_given_weights(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(DetectionPredictor, "load", lambda *_, **__: ImageDetector())
    monkeypatch.setattr(Detection3DPredictor, "load", lambda *_, **__: SweepDetector())
    out = tmp_path / "joined.json"
    assert main(["fit-joined", str(PACKAGED_FRAMES), str(out), "--frames", "1"]) == 0
    assert str(out) in capsys.readouterr().out
    assert read_models(out).fits("a", "b")
    assert main(["fit-joined", str(PACKAGED_FRAMES), str(PACKAGED_FRAMES / "a.json")]) == 2
    assert not (PACKAGED_FRAMES / "a.json").exists()
