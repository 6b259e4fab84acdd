import json
from importlib.metadata import version

import numpy as np
import pytest
import torch

from sightline.data.formats.kitti_files import write_points
from sightline.data.formats.map_png import read_depth_png
from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import DepthPredictor
from sightline.depth_completion.registration import TASK
from sightline.inference.predict import predict
from sightline.jobs.run import JobResult
from tests.depth_completion.networks import write_tiny_weights
from tests.inference.trees import contents_of, write_object_tree

WITH_UNCERTAINTY = {"filled_input": True, "residual": True, "uncertainty": True}


def predict_depth(data, out, *, method=None, weights=None, uncertainty=None, **job):
    """Predict as the command does."""
    predictor = TASK.predictor(method=method, weights=weights)
    also = {} if uncertainty is None else {"uncertainty": uncertainty}
    return predict(TASK, predictor, data, out, also=also, **job)


@pytest.fixture
def data(tmp_path):
    return write_object_tree(tmp_path / "data", 6)


@pytest.fixture
def weights(tmp_path):
    return write_tiny_weights(tmp_path / "tiny.safetensors", **WITH_UNCERTAINTY)


def test_a_network_writes_depth_and_its_expected_error(data, tmp_path, weights):
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    result = predict_depth(
        data, out, weights=weights, uncertainty=uncertainty, workers=1, sample_list=["000002"]
    )
    assert result == JobResult(written=1, skipped=0)
    sample = open_dataset(data, sample_list=["000002"], parts={"image", "points"})[0]
    expected = DepthPredictor.load(weights)(sample)
    for folder, values in ((out, expected.depth_m), (uncertainty, expected.uncertainty_m)):
        written_m = read_depth_png(folder / "000002.png")
        assert np.abs(written_m - values.numpy()).max() <= 1 / 256


def test_the_manifest_names_the_weights_by_name_and_content_and_the_engine(data, tmp_path, weights):
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    job = {"uncertainty": uncertainty, "workers": 1, "sample_list": ["000001"]}
    predict_depth(data, out, weights=weights, **job)
    made_by = {
        "task": "depth-completion",
        "output": "depth",
        "method": "tiny",
        "data": f"{data.parent.name}/{data.name}",
        "velodyne": "velodyne",
        "sightline": version("sightline"),
        "weights_sha256": DepthPredictor.load(weights).sha256,
        "image_weights_sha256": DepthPredictor.load("depth-image").sha256,
        "engine": "torch",
    }
    assert json.loads((out / "sightline.json").read_text()) == made_by
    made_by["output"] = "uncertainty"
    assert json.loads((uncertainty / "sightline.json").read_text()) == made_by


def test_results_of_other_weights_of_the_same_name_do_not_mix(data, tmp_path, weights):
    out = tmp_path / "out"
    job = {"workers": 1, "sample_list": ["000001"]}
    predict_depth(data, out, weights=weights, **job)
    write_tiny_weights(weights, seed=1, **WITH_UNCERTAINTY)
    with pytest.raises(ValueError, match=r"weights_sha256 \w+\.* instead of \w+"):
        predict_depth(data, out, weights=weights, **job)
    with pytest.raises(ValueError, match=r"made with method tiny instead of adaptive"):
        predict_depth(data, out, method="adaptive", **job)


@pytest.fixture
def one_thread():
    """One thread of PyTorch, as workers have: with more, sums are rounded in another order."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
@pytest.mark.usefixtures("one_thread")
def test_the_number_of_workers_changes_nothing_for_a_network(data, tmp_path, weights):
    one, two = tmp_path / "one", tmp_path / "two"
    predict_depth(data, one, weights=weights, workers=1)
    predict_depth(data, two, weights=weights, workers=2)
    assert contents_of(one) == contents_of(two)


def test_a_sample_is_done_again_where_its_expected_error_is_missing(data, tmp_path, weights):
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    job = {"weights": weights, "uncertainty": uncertainty, "workers": 1}
    predict_depth(data, out, **job)
    before = contents_of(uncertainty)
    (uncertainty / "000003.png").unlink()
    assert predict_depth(data, out, **job) == JobResult(written=1, skipped=5)
    assert contents_of(uncertainty) == before


def test_the_depth_of_an_empty_sweep_is_guessed_from_the_image(data, tmp_path, weights):
    write_points(data / "training" / "velodyne" / "000000.bin", torch.zeros(0, 4))
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    job = {"uncertainty": uncertainty, "workers": 1, "sample_list": ["000000"]}
    with (
        pytest.warns(UserWarning, match="all 1 sweeps are empty"),
        pytest.warns(UserWarning, match="the point clouds of 1 of 1 frames hold no point"),
    ):
        result = predict_depth(data, out, weights=weights, **job)
    assert "1 written, 0 there already; 1 hold depth guessed from the image" in str(result)
    guess = DepthPredictor.load("depth-image")(open_dataset(data)[0])
    for folder, expected in ((out, guess.depth_m), (uncertainty, guess.uncertainty_m)):
        np.testing.assert_allclose(read_depth_png(folder / "000000.png"), expected, atol=1 / 256)


def test_without_image_an_empty_sweep_has_neither_depth_nor_expected_error(data, tmp_path, weights):
    write_points(data / "training" / "velodyne" / "000000.bin", torch.zeros(0, 4))
    (data / "training" / "image_2" / "000000.png").unlink()
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    job = {"uncertainty": uncertainty, "workers": 1, "sample_list": ["000000"]}
    with (
        pytest.warns(UserWarning, match="all 1 sweeps are empty"),
        pytest.warns(UserWarning, match="there are no images for 1 of 1 frames"),
        pytest.warns(UserWarning, match="the point clouds of 1 of 1 frames hold no point"),
    ):
        predict_depth(data, out, weights=weights, **job)
    assert not read_depth_png(out / "000000.png").any()
    assert not read_depth_png(uncertainty / "000000.png").any()


def test_an_expected_error_that_nobody_estimates_is_refused_before_anything_is_written(
    data, tmp_path, weights
):
    out, uncertainty = tmp_path / "out", tmp_path / "uncertainty"
    with pytest.raises(ValueError, match="adaptive gives no uncertainty to write to"):
        predict_depth(data, out, method="adaptive", uncertainty=uncertainty)
    with pytest.raises(ValueError, match="cannot hold both depth and uncertainty"):
        predict_depth(data, out, weights=weights, uncertainty=out)
    assert not out.exists()
    assert not uncertainty.exists()
