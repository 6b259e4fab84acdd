import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.kitti_labels import read_results
from sightline.data.open import open_dataset
from sightline.detection2d import predictor as module
from sightline.detection2d.config import InputConfig, PostprocessConfig
from sightline.detection2d.placement import camera_image, lidar_image
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.registration import TASK
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.detection2d.frames import TINY, painted_frame, write_network

SURE = PostprocessConfig(min_score=0.2, max_detections=20)  # of random weights: 0.25 each


def config(fusion="gated"):
    return replace(TINY, fusion=fusion, postprocess=SURE)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    write_network(path, config())
    return path


@pytest.fixture(scope="module")
def predictor(weights):
    return DetectionPredictor.load(weights)


def same(a, b):
    return (
        a.detections.class_names == b.detections.class_names
        and torch.equal(a.detections.boxes.tensor, b.detections.boxes.tensor)
        and torch.equal(a.detections.scores, b.detections.scores)
    )


def test_it_answers_as_the_network_does(predictor, tmp_path):
    sample = painted_frame(0)
    network = write_network(tmp_path / "again.safetensors", config())
    with torch.inference_mode():
        output = network(camera_image(sample)[None], lidar_image(sample, InputConfig())[None])
    result = predictor(sample)
    assert float(result.detections.scores[0]) == pytest.approx(float(output.scores.max()))
    torch.testing.assert_close(result.camera_gate, output.camera_gate[0, 0])
    torch.testing.assert_close(result.lidar_gate, output.lidar_gate[0, 0])


@pytest.mark.parametrize("size", [(100, 700), (300, 280)])
def test_images_of_any_size_get_boxes_in_their_own_pixels(predictor, size):
    result = predictor(painted_frame(1, size, rows=[("Car", 20, 20, 90, 70)]))
    boxes = result.detections.boxes.tensor
    assert len(boxes) == 20
    assert (boxes >= 0).all()
    assert (boxes[:, 2] <= size[1] - 1).all()
    assert (boxes[:, 3] <= size[0] - 1).all()
    scores = result.detections.scores
    assert torch.equal(scores, scores.sort(descending=True).values)


def test_a_sensor_that_is_missing_is_one_that_delivers_nothing(predictor):
    sample = painted_frame(2)
    black, empty = torch.zeros_like(sample.image), sample.points[:0]
    assert same(predictor(replace(sample, image=None)), predictor(replace(sample, image=black)))
    assert same(predictor(replace(sample, points=None)), predictor(replace(sample, points=empty)))
    predictor(replace(sample, image=black, points=empty))  # a result, too
    with pytest.raises(ValueError, match="000002 has no image nor sweep, so nothing can be"):
        predictor(replace(sample, image=None, points=None))


@pytest.mark.parametrize("column", [0, 3])  # a place; the reflectance, which was let through
def test_a_point_that_is_not_finite_is_refused_and_does_not_blind_the_network(predictor, column):
    sample = painted_frame(2)
    points = sample.points.clone()
    points[7, column] = torch.nan
    with pytest.raises(ValueError, match=r"000002 holds 1 points with NaN .* is point 7 of"):
        predictor(replace(sample, points=points))


@pytest.mark.parametrize(("fusion", "part", "other"), [("camera", "image", "points"),
                                                       ("lidar", "points", "image")])  # fmt: skip
def test_a_network_of_one_sensor_asks_for_that_one_only(tmp_path, fusion, part, other):
    write_network(tmp_path / "w.safetensors", config(fusion))
    alone = DetectionPredictor.load(tmp_path / "w.safetensors")
    assert alone.parts == (part,)
    assert alone.gives == ("results",)
    sample = painted_frame(3)
    assert same(alone(sample), alone(replace(sample, **{other: None})))
    with pytest.raises(ValueError, match="so nothing can be detected"):
        alone(replace(sample, **{part: None}))


def test_a_sweep_of_few_beams_is_a_sweep(predictor):
    sample = painted_frame(4)
    thin = predictor(replace(sample, points=sample.points[::16]))
    assert len(thin.detections.scores) == 20


def test_it_may_be_pickled(predictor):
    sample = painted_frame(5)
    again = pickle.loads(pickle.dumps(predictor))
    assert same(again(sample), predictor(sample))


def test_the_command_writes_result_files_and_gates(weights, predictor, tmp_path):
    out, gates = tmp_path / "results", tmp_path / "gates"
    command = ["predict", "detection2d", str(PACKAGED_FRAMES), str(out), "--gates", str(gates)]
    assert main([*command, "--weights", str(weights), "--workers", "1"]) == 0
    sample = open_dataset(PACKAGED_FRAMES)[0]
    result = predictor(sample)
    written = read_results(out / "000000.txt")
    assert written.class_names == result.detections.class_names
    np.testing.assert_allclose(written.boxes2d, result.detections.boxes.tensor, atol=0.01)
    np.testing.assert_allclose(written.scores, result.detections.scores, atol=1e-4)
    assert (written.dimensions_hwl == -1).all()
    picture = read_rgb(gates / "000000.png")
    assert picture.shape == (375, 1242, 3)
    levels = [float(gate.mean()) * 255 for gate in (result.camera_gate, result.lidar_gate)]
    np.testing.assert_allclose(picture[..., :2].mean(axis=(0, 1)), levels, atol=2)


def test_gates_of_a_network_without_any_are_refused(tmp_path, capsys):
    write_network(tmp_path / "w.safetensors", config("ones"))
    command = ["predict", "detection2d", str(PACKAGED_FRAMES), str(tmp_path / "out")]
    command += ["--gates", str(tmp_path / "gates"), "--weights", str(tmp_path / "w.safetensors")]
    assert main(command) == 2
    assert "gives no gates" in capsys.readouterr().err


def test_a_frame_is_drawn_with_what_was_found(weights, tmp_path):
    out = tmp_path / "frame.png"
    assert main(["show", str(PACKAGED_FRAMES), "000000", "--weights", str(weights), "--out",
                 str(out)]) == 0  # fmt: skip
    assert read_rgb(out).size


def test_a_method_is_refused_though_weights_are_named(weights):
    with pytest.raises(ValueError, match="detection2d has no method 'linear': it predicts by a"):
        TASK.predictor(method="linear", weights=weights)


def test_the_old_name_of_results_warns():
    with pytest.warns(DeprecationWarning, match="now DetectionResult"):
        assert module.DetectorAnswer is module.DetectionResult
    with pytest.raises(AttributeError, match="has no attribute 'Other'"):
        module.Other  # noqa: B018
