"""Depth guessed from the image where the LiDAR saw nothing."""

import pickle
from dataclasses import replace

import pytest
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.postprocess import FARTHEST_M, NEAREST_M, only_valid
from sightline.depth_completion.predictor import DepthPredictor
from sightline.depth_completion.registration import TASK
from sightline.depth_completion.street_depth import street_depth
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.depth_completion.networks import write_tiny_weights
from tests.depth_completion.test_holes import without_columns

STREET = {
    "filled_input": True,
    "filling": "street",
    "residual": True,
    "correction": "log",
    "uncertainty": True,
    "validity_channel": True,
    "shift_conv": None,
}
FILLED = {"filled_input": True, "residual": True, "uncertainty": True}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weights")
    return {
        "own scale": write_tiny_weights(folder / "own.safetensors", **STREET),
        "street": write_tiny_weights(folder / "street.safetensors", focal_px=100.0, **STREET),
        "sweep": write_tiny_weights(folder / "sweep.safetensors", seed=1, **FILLED),
    }


@pytest.fixture(scope="module")
def sample():
    return KittiObjectDataset(PACKAGED_FRAMES)[0]


@pytest.fixture
def predictor(weights):
    completer = DepthPredictor.load(weights["sweep"])
    completer.image_weights = weights["street"]
    return completer


def same(one, other):
    return (
        torch.equal(one.depth_m, other.depth_m)
        and torch.equal(one.valid, other.valid)
        and torch.equal(one.uncertainty_m, other.uncertainty_m)
    )


def test_a_network_that_starts_from_a_street_corrects_it_by_the_image(weights, sample):
    size = sample.image_size
    network = load_network(TASK, weights["own scale"]).network
    top = -size[0] % network.stride

    def padded(plane, mode):
        return torch.nn.functional.pad(
            plane[None], (0, -size[1] % network.stride, top, 0), mode=mode
        )

    expected = network(
        padded(sample.image / 255, "replicate"),
        torch.zeros(1, 1, size[0] + top, size[1] + -size[1] % network.stride),
        padded(street_depth(sample)[None], "replicate"),
    )
    depth = DepthPredictor.load(weights["own scale"])(replace(sample, points=None))
    clamped = expected.depth_m[0, 0, top:, : size[1]].clamp(NEAREST_M, FARTHEST_M)
    torch.testing.assert_close(depth.depth_m, clamped)
    torch.testing.assert_close(depth.uncertainty_m, expected.uncertainty_m[0, 0, top:, : size[1]])


def test_another_focal_length_gives_depth_at_the_images_own_size(weights, sample):
    depth = DepthPredictor.load(weights["street"])(sample)
    assert depth.depth_m.shape == depth.uncertainty_m.shape == sample.image_size
    assert depth.guessed is None
    assert depth.valid.any()


@pytest.mark.parametrize("points", [None, torch.zeros(0, 4)], ids=["no sweep", "no returns"])
def test_without_returns_the_whole_depth_is_a_guess(predictor, weights, sample, points):
    blind = replace(sample, points=points)
    depth = predictor(blind)
    assert same(depth, DepthPredictor.load(weights["street"])(blind))
    assert depth.guessed.all()
    assert not depth.valid.any()
    assert not only_valid(depth).depth_m.any()
    assert depth.to_json()["guessed_share"] == 1.0


def test_a_hidden_half_is_filled_by_the_guess_and_the_rest_is_kept(predictor, weights, sample):
    width = sample.image_size[1]
    given = without_columns(sample, 0, width // 2)
    depth, guess = predictor(given), DepthPredictor.load(weights["street"])(given)
    alone = DepthPredictor.load(weights["sweep"])
    alone.image_weights = None
    holes = depth.guessed
    assert 0.4 < float(holes.float().mean()) < 0.5
    for name in ("depth_m", "uncertainty_m"):
        values = getattr(depth, name)
        assert torch.equal(values[holes], getattr(guess, name)[holes])
        assert torch.equal(values[~holes], getattr(alone(given), name)[~holes])
    assert not depth.valid[holes].any()
    assert torch.equal(depth.valid[~holes], alone(given).valid[~holes])


def test_sound_sweeps_and_missing_cameras_get_no_guess(predictor, sample):
    alone = pickle.loads(pickle.dumps(predictor))
    alone.image_weights = None
    black = replace(sample, image=torch.zeros_like(sample.image))
    for given in (sample, replace(sample, image=None), black):
        depth = predictor(given)
        assert same(depth, alone(given))
        assert depth.guessed is None


def test_neither_sensor_gives_no_depth(predictor, sample):
    nothing = replace(sample, points=torch.zeros(0, 4), image=torch.zeros_like(sample.image))
    depth = predictor(nothing)
    assert not depth.depth_m.any()
    assert not depth.valid.any()
    with pytest.raises(ValueError, match="has no sweep"):
        predictor(replace(sample, points=None, image=None))


def test_without_image_weights_such_frames_have_no_depth(predictor, sample):
    predictor.image_weights = None
    depth = predictor(replace(sample, points=torch.zeros(0, 4)))
    assert not depth.depth_m.any()
    assert depth.guessed is None


def test_points_with_their_calibration_give_the_samples_depth(predictor, sample):
    width = sample.image_size[1]
    for given in (sample, without_columns(sample, 0, width // 2)):
        by_points = predictor.complete_points(
            given.points, given.calibration, given.image_size, given.image
        )
        assert same(by_points, predictor(given))


def test_a_map_alone_is_not_enough_for_a_network_that_needs_the_calibration(weights):
    with pytest.raises(ValueError, match="needs the camera's calibration"):
        DepthPredictor.load(weights["street"]).complete(torch.ones(8, 8), None)


def test_manifests_name_both_networks(predictor, weights):
    assert set(predictor.made_by) == {"weights_sha256", "image_weights_sha256", "engine"}
    assert "image_weights_sha256" not in DepthPredictor.load(weights["street"]).made_by


def test_settings_that_contradict_a_street_are_refused():
    street = {"filled_input": True, "filling": "street", "shift_conv": None}
    for wrong in ({"keep_measured": True}, {"surroundings_px": 3}):
        with pytest.raises(ValueError, match="street holds no measurements"):
            DepthCompletionConfig(**street, **wrong)
    with pytest.raises(ValueError, match="street is an input"):
        DepthCompletionConfig(filling="street")
    with pytest.raises(ValueError, match="focal_px must be from 50 to 5000"):
        DepthCompletionConfig(**street, focal_px=1.0)
