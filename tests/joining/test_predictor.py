import dataclasses
import json
import math

import pytest

from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.data.open import open_dataset
from sightline.detection2d.predictor import DetectionPredictor, DetectionResult
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.models import read_models
from sightline.joining.predictor import JoinedPredictor
from sightline.joining.scene import make_scene
from sightline.perception.perceive import perceive
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.perception.results import open_results, read_perception
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.joining.scenes import detections2d, detections3d, own_score_models
from tests.perception.predictors import FunctionPredictor

CAR = ("Car", 0.5, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
SEEN = ("Car", 0.25, (100.0, 180.0, 200.0, 240.0))


@pytest.fixture(autouse=True)
def repeated_frames(monkeypatch):
    """Let frames that are repeated count as if each showed another scene."""
    monkeypatch.setattr("sightline.joining.recording.distinct_scenes", list)


class ImageDetector(DetectionPredictor):
    """Detector in the image with a fixed prediction."""

    def __init__(self, sha256):
        self.name, self.sha256, self.engine = "image", sha256, "torch"

    def predict(self, sample):
        del sample
        return DetectionResult(detections=detections2d(SEEN))


class SweepDetector(Detection3DPredictor):
    """Detector in the sweep with a fixed prediction."""

    def __init__(self, sha256):
        self.name, self.sha256, self.engine = "sweep", sha256, "torch"

    def predict(self, sample):
        assert sample.points is not None
        return detections3d(CAR)

    def refine_boxes(self, sample, boxes):
        assert len(sample.points)
        assert len(boxes.scores)
        return detections3d()


def joined(*, digests=("a", "b")):
    models = own_score_models({"sha256": {"detection2d": "a", "detection3d": "b"}})
    return JoinedPredictor(ImageDetector(digests[0]), SweepDetector(digests[1]), models)


@pytest.fixture
def packaged():
    return open_dataset(PACKAGED_FRAMES)[0]


def test_its_perception_holds_the_objects_and_what_was_joined(packaged):
    found = joined()(packaged)
    assert found.objects.origins == ("measured", "lifted")
    assert found.detections2d.scores.tolist() == [0.25]
    assert found.detections3d.scores.tolist() == [0.5]


def test_without_a_sweep_its_detector_does_not_run(packaged):
    found = joined()(dataclasses.replace(packaged, points=None))
    assert found.detections3d is None
    assert found.objects.origins == ("lifted",)


def test_models_of_other_weights_are_refused():
    with pytest.raises(ValueError, match="were not fitted for image and sweep; give the weights"):
        joined(digests=("b", "a"))


def test_the_rotation_of_its_recording_is_undone_and_told(packaged):
    turned = [rotate_extrinsics(packaged, 1.0)] * 6
    given = joined().aligned(turned, AlignmentConfig(yaw_bias_deg=0.0))
    found = given(turned[0])
    assert found.undone_turn.yaw_deg == pytest.approx(1.0, abs=0.1)
    assert found.to_json()["undone_turn"] == found.undone_turn.to_json()
    as_calibrated = joined()(turned[0]).objects
    shift_px = (found.objects.boxes2d.tensor - as_calibrated.boxes2d.tensor)[0, 0]
    assert shift_px == pytest.approx(721 * math.tan(math.radians(1.0)), abs=2)


def test_a_sound_recording_changes_nothing(packaged):
    given = joined().aligned([packaged] * 6, AlignmentConfig(yaw_bias_deg=0.0))
    assert given.alignment == Alignment()
    assert given(packaged).to_json() == joined()(packaged).to_json()
    assert "undone_turn" not in joined()(packaged).to_json()


def test_frames_that_do_not_agree_are_aligned_by_their_boxes(packaged):
    turned = [rotate_extrinsics(packaged, yaw_deg) for yaw_deg in (-1.5, -1.0, 0.0, 1.0, 1.5)]
    given = joined().aligned(turned)
    assert given.alignment.by_boxes
    left, *others = make_scene(packaged, None, detections3d(CAR)).sweep.in_image[0].tolist()
    shifted = (left + 12, others[0], others[1] + 12, others[2])
    found2d = DetectionResult(detections=detections2d(("Car", 0.9, shifted)))
    given.detector2d.predict = lambda _: found2d
    sure = detections3d((CAR[0], 0.9, *CAR[2:]))
    given.detector3d.predict = lambda _: sure
    found = given(packaged)
    assert found.undone_turn.yaw_deg == pytest.approx(0.9, abs=0.15)
    assert len(found.objects) == 1


def perceiver(digests):
    made_by = [{"weights_sha256": digest} for digest in digests]
    image = DetectionResult(detections=detections2d(SEEN))
    sweep = detections3d(CAR)
    return MultiTaskPredictor(
        {
            "detection2d": FunctionPredictor(
                lambda _: image, "image", ("image", "points"), (), ("results",), made_by[0]
            ),
            "detection3d": FunctionPredictor(
                lambda _: sweep, "sweep", ("points",), ("points",), ("results",), made_by[1]
            ),
        }
    )


def test_perceive_writes_objects_first_and_as_result_files(tmp_path):
    digests = list(read_models().provenance["sha256"].values())
    perceive(PACKAGED_FRAMES, tmp_path, perceiver=perceiver(digests))
    line = json.loads((tmp_path / "perception.jsonl").read_text().splitlines()[0])
    predictions = [key for key in line if key in ("objects", "detections2d", "detections3d")]
    assert predictions == ["objects", "detections2d", "detections3d"]
    assert sorted(each["box_3d"]["origin"] for each in line["objects"]) == ["lifted", "measured"]
    files = sorted(path.name for path in (tmp_path / "joined").iterdir())
    assert files == ["000000.txt", "000001.txt", "sightline.json"]
    assert len((tmp_path / "joined" / "000000.txt").read_text().splitlines()) == 2
    timing = json.loads((tmp_path / "timings.jsonl").read_text().splitlines()[0])
    assert timing["milliseconds"].keys() == {"detection2d", "detection3d", "joined"}
    (tmp_path / "joined" / "000001.txt").unlink()
    again = perceive(PACKAGED_FRAMES, tmp_path, perceiver=perceiver(digests))
    assert (again.written, again.skipped) == (1, 1)


def test_objects_of_perceive_are_read_back_for_pictures(tmp_path, packaged):
    digests = list(read_models().provenance["sha256"].values())
    perceive(PACKAGED_FRAMES, tmp_path, perceiver=perceiver(digests))
    found = read_perception(open_results([tmp_path]), packaged)
    line = json.loads((tmp_path / "lines" / "000000.json").read_text())
    assert found.objects.to_json() == line["objects"]
    assert found.detections2d is not None
    alone = read_perception(open_results([tmp_path / "joined"]), packaged)
    assert alone.objects is None
    assert len(alone.detections3d.scores) == 2
    (tmp_path / "lines" / "000000.json").write_text("{}")
    with pytest.raises(ValueError, match=r"000000\.json: does not hold the line of frame 000000"):
        read_perception(open_results([tmp_path]), packaged)


def test_perceive_with_other_weights_joins_nothing_and_says_so(tmp_path):
    with pytest.warns(UserWarning, match="objects are not joined: there are no models") as told:
        perceive(PACKAGED_FRAMES, tmp_path, perceiver=perceiver(["a", "b"]))
    assert len(told) == 1
    line = json.loads((tmp_path / "perception.jsonl").read_text().splitlines()[0])
    assert line["objects"] is None
    assert not (tmp_path / "joined").exists()


def test_perceive_joins_by_models_for_weights_of_one_s_own(tmp_path):
    own = perceiver(["a", "b"])
    models = own_score_models({"sha256": {"detection2d": "a", "detection3d": "b"}})
    with_models = MultiTaskPredictor(own.predictors, join_models=models)
    assert with_models.with_alignment(Alignment()).join_models is models
    perceive(PACKAGED_FRAMES, tmp_path, perceiver=with_models)
    assert len((tmp_path / "joined" / "000000.txt").read_text().splitlines()) == 2


def test_models_fitted_anew_do_not_mix_with_earlier_ones(tmp_path):
    own = perceiver(["a", "b"])
    models = own_score_models({"sha256": {"detection2d": "a", "detection3d": "b"}})
    perceive(PACKAGED_FRAMES, tmp_path, perceiver=MultiTaskPredictor(own.predictors, None, models))
    car = dataclasses.replace(models.sweep["Car"], bias=1.0)
    others = dataclasses.replace(models, sweep={**models.sweep, "Car": car})
    with pytest.raises(ValueError, match="joined"):
        perceive(
            PACKAGED_FRAMES, tmp_path, perceiver=MultiTaskPredictor(own.predictors, None, others)
        )


@pytest.mark.filterwarnings("ignore:objects are not joined")
@pytest.mark.parametrize("is_first_joined", [True, False])
def test_runs_with_and_without_models_do_not_mix(tmp_path, is_first_joined):
    own = perceiver(["a", "b"])
    models = own_score_models({"sha256": {"detection2d": "a", "detection3d": "b"}})
    both = [MultiTaskPredictor(own.predictors, join_models=models), own]
    first, second = both if is_first_joined else both[::-1]
    perceive(PACKAGED_FRAMES, tmp_path, perceiver=first)
    with pytest.raises(ValueError, match=r"joined .*which would mix with this job; name another"):
        perceive(PACKAGED_FRAMES, tmp_path, perceiver=second)


def test_models_of_other_weights_and_for_one_detector_are_refused():
    own = perceiver(["a", "c"])
    models = own_score_models({"sha256": {"detection2d": "a", "detection3d": "b"}})
    with pytest.raises(ValueError, match=r"were not fitted for image and sweep; give the weights"):
        MultiTaskPredictor(own.predictors, join_models=models)
    alone = {"detection2d": own.predictors["detection2d"]}
    with pytest.raises(ValueError, match="models of joined scores need both detectors"):
        MultiTaskPredictor(alone, join_models=models)


def test_files_of_models_are_read_for_given_weights(tmp_path):
    models = read_models()
    models.write(tmp_path / "joined.json")
    assert JoinedPredictor.load(models=tmp_path / "joined.json").models == models
    with pytest.raises(ValueError, match="not fitted for detection2d-fast-cpu and detection3d"):
        JoinedPredictor.load(detection2d="detection2d-fast-cpu", models=tmp_path / "joined.json")
