import torch

from sightline.corruptions.suites import find_suite
from sightline.data.open import open_dataset
from sightline.detection3d.robustness import SCORING
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections3D


def prediction(case_name):
    sample = open_dataset(PACKAGED_FRAMES)[0]
    (case,) = find_suite("dgfn7").select([case_name])
    labels = sample.objects.select(sample.objects.has_box3d)
    result = Detections3D(
        class_names=labels.class_names,
        boxes=labels.boxes3d,
        scores=torch.full((len(labels),), 0.9),
    )
    return BenchPrediction(BenchFrame(sample, None), case.corrupt(sample), result)


def test_an_answer_is_drawn_on_the_image_and_from_above():
    clean, dead = (SCORING.draw(prediction(name), 200) for name in ("clean", "lidar_blank"))
    assert [panel.caption for panel in clean] == ["detections", "from above, labels white"]
    assert all(panel.picture.shape[1] == 200 for panel in (*clean, *dead))
    assert clean[1].picture.mean() > dead[1].picture.mean()  # no points, but boxes


def test_what_is_kept_is_scored_as_found(tmp_path):
    dataset = open_dataset(PACKAGED_FRAMES, sample_list=("000000",))
    SCORING.store(tmp_path / "000000.txt", prediction("clean"))
    scores = SCORING.score(tmp_path, dataset)
    assert list(scores) == [metric.name for metric in SCORING.metrics]
    assert scores["Car_3d_0.7_hard_all_points"] == 100
