"""Fit of joined scores to two detectors, from frames to models."""

import dataclasses

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor, DetectionResult
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.joining.fit_pair import FIT_CASES, any_fault, fit_pair, thin_sweep
from sightline.joining.models import CALIBRATED, CLASSES, COLUMNS, read_models
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.joining.scenes import detections2d, detections3d, make_sample

WRONG = ("Car", 0.2, 30.0, 14.0, -0.95, 4.0, 1.8, 1.5, 0.0)
WRONG_SEEN = ("Car", 0.2, (500.0, 10.0, 560.0, 60.0))
SOME_UNFIT = pytest.mark.filterwarnings("ignore:no box of .* fits a label")


def labelled(sample, boxes):
    """Class, score and numbers of the labels of the classes."""
    names = sample.objects.class_names
    rows = zip(names, boxes.tensor.tolist(), strict=True)
    return [(name, 0.9, numbers) for name, numbers in rows if name in CLASSES]


class ImageDetector(DetectionPredictor):
    """Detector in the image that finds the labels, and one box more."""

    def __init__(self):
        self.name, self.sha256, self.engine = "image", "a", "torch"
        self.number = 0

    def predict(self, sample):
        self.number += 1
        found = labelled(sample, sample.objects.boxes2d)
        return DetectionResult(detections=detections2d(*found, WRONG_SEEN))


class SweepDetector(Detection3DPredictor):
    """Detector in the sweep that finds the labels, and one box more."""

    def __init__(self):
        self.name, self.sha256, self.engine = "sweep", "b", "torch"
        self.number = 0

    def predict(self, sample):
        assert sample.points is not None
        self.number += 1
        found = [
            (name, score, *box) for name, score, box in labelled(sample, sample.objects.boxes3d)
        ]
        return detections3d(*found, WRONG)

    def refine_boxes(self, sample, boxes):
        del sample, boxes
        return detections3d()


def changed(change):
    """Packaged frames whose labels are changed."""
    samples = list(open_dataset(PACKAGED_FRAMES))
    return [dataclasses.replace(each, objects=change(each.objects)) for each in samples]


def only_cars(objects):
    kept = torch.tensor([name == "Car" for name in objects.class_names])
    return objects.select(kept)


@SOME_UNFIT
def test_models_fit_the_detectors_and_name_their_frames():
    dataset, in_image, in_sweep = open_dataset(PACKAGED_FRAMES), ImageDetector(), SweepDetector()
    models = fit_pair(dataset, in_image, in_sweep, data="street", frames=40)
    assert models.fits("a", "b")
    assert models.provenance["frames"] == "000000,000001"
    assert models.provenance["data"] == "street"
    assert models.provenance["states"] == list(FIT_CASES)
    assert in_image.number == 2 * len(FIT_CASES)
    assert in_sweep.number < 2 * (len(FIT_CASES) - 1)  # not again where the camera is blank
    assert fit_pair(dataset, ImageDetector(), SweepDetector(), data="street", frames=40) == models
    one = fit_pair(dataset, ImageDetector(), SweepDetector(), data="street", frames=1)
    assert one.provenance["frames"] == "000000"
    assert one.identity["numbers_sha256"] != models.identity["numbers_sha256"]
    with pytest.raises(ValueError, match="frames must be at least 1, got 0"):
        fit_pair(dataset, in_image, in_sweep, data="street", frames=0)


def test_classes_without_a_label_keep_the_shipped_models_with_a_warning():
    shipped = read_models()
    with pytest.warns(UserWarning, match="no box of .*Pedestrian, Cyclist fits a label, so scores"):
        models = fit_pair(
            changed(only_cars), ImageDetector(), SweepDetector(), data="street", frames=2
        )
    for kind in COLUMNS:
        assert getattr(models, kind)["Cyclist"] == getattr(shipped, kind)["Cyclist"]
    for kind in CALIBRATED:
        assert models.calibrators[kind]["Cyclist"] == shipped.calibrators[kind]["Cyclist"]
    for kind in ("sweep", "image"):
        assert getattr(models, kind)["Car"] != getattr(shipped, kind)["Car"]


def test_frames_whose_labels_no_box_fits_are_refused():
    empty = changed(lambda objects: objects.select(torch.zeros(len(objects), dtype=torch.bool)))
    with pytest.raises(ValueError, match="no box of Car, Pedestrian, Cyclist fits a label, so no"):
        fit_pair(empty, ImageDetector(), SweepDetector(), data="street", frames=2)


@pytest.mark.filterwarnings("ignore:a sweep shows no rings")
def test_a_lidar_without_rings_is_thinned_by_points_and_loses_no_rings():
    rng = np.random.default_rng(0)
    points = rng.uniform([5, -8, -1.7, 0], [60, 8, 3, 1], (4_000, 4)).astype(np.float32)
    sample = make_sample(points)
    shares = [len(thin_sweep(sample, place).points) / 4_000 for place in range(6)]
    assert shares == [0.25, 0.125, 0.5, 0.25, 0.125, 0.25]
    for place in range(60):
        assert torch.isfinite(any_fault(sample, place).points).all()


@SOME_UNFIT
def test_the_command_writes_models_for_given_weights(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(DetectionPredictor, "load", lambda *_, **__: ImageDetector())
    monkeypatch.setattr(Detection3DPredictor, "load", lambda *_, **__: SweepDetector())
    out = tmp_path / "joined.json"
    assert main(["fit-joined", str(PACKAGED_FRAMES), str(out), "--frames", "1"]) == 0
    assert str(out) in capsys.readouterr().out
    assert read_models(out).fits("a", "b")
    assert main(["fit-joined", str(PACKAGED_FRAMES), str(tmp_path / "joined.txt")]) == 2
    assert "a file of models ends in .json" in capsys.readouterr().err
    assert main(["fit-joined", str(PACKAGED_FRAMES), str(PACKAGED_FRAMES / "a.json")]) == 2
    assert not (PACKAGED_FRAMES / "a.json").exists()
