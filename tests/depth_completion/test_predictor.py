import dataclasses
import pickle

import numpy as np
import pytest
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.depth_completion.config import PlaneSmoothing, SignedThreshold, by_direction
from sightline.depth_completion.methods import starting_depth
from sightline.depth_completion.mirrored_prediction import predict_with_mirror
from sightline.depth_completion.postprocess import FARTHEST_M, NEAREST_M
from sightline.depth_completion.predictor import (
    DepthCompleter,
    DepthPredictor,
    choose_completer,
)
from sightline.depth_completion.registration import TASK
from sightline.depth_completion.sparse_map import inside_hull
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.network import load_network
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample
from tests.depth_completion.networks import write_tiny_weights
from tests.inference.trees import IMAGE_SIZE, small_calibration
from tests.reference.corrections import counted
from tests.reference.plane_smoothing import smoothed

FILLED = {"filled_input": True, "residual": True, "uncertainty": True}


@pytest.fixture
def weights(tmp_path):
    return write_tiny_weights(tmp_path / "tiny.safetensors")


@pytest.fixture
def filled_weights(tmp_path):
    return write_tiny_weights(tmp_path / "tiny-filled.safetensors", **FILLED)


@pytest.fixture
def sample():
    return KittiObjectDataset(PACKAGED_FRAMES)[0]


def random_frame(height, width, *, density=0.2, seed=0):
    """Random sparse map and image."""
    generator = torch.Generator().manual_seed(seed)
    depth_m = 5 + 40 * torch.rand(height, width, generator=generator)
    is_measured = torch.rand(height, width, generator=generator) < density
    image = torch.randint(0, 256, (3, height, width), generator=generator).to(torch.uint8)
    return torch.where(is_measured, depth_m, 0.0), image


def test_a_map_whose_sides_the_stride_divides_is_what_the_network_says(filled_weights):
    sparse, image = random_frame(16, 20)
    filled = starting_depth(sparse)
    network = load_network(TASK, filled_weights).network
    expected = network(image[None] / 255, sparse[None, None], filled.depth_m[None, None])
    dense = DepthPredictor.load(filled_weights).complete(sparse, image)
    torch.testing.assert_close(
        dense.depth_m, expected.depth_m[0, 0].clamp(NEAREST_M, FARTHEST_M), rtol=1e-5, atol=1e-5
    )
    torch.testing.assert_close(
        dense.uncertainty_m, expected.uncertainty_m[0, 0], rtol=1e-5, atol=1e-5
    )
    assert not (dense.valid & ~filled.valid).any()


def test_a_network_without_a_completion_to_start_from_is_valid_among_the_measurements(weights):
    sparse, image = random_frame(16, 20, density=0.05)
    dense = DepthPredictor.load(weights).complete(sparse, image)
    assert dense.uncertainty_m is None
    assert np.array_equal(dense.valid.numpy(), inside_hull(sparse.numpy() > 0))


def test_a_map_is_smoothed_as_the_settings_say(tmp_path):
    smoothing = PlaneSmoothing(windows_px=(2, 3), noise_m=0.5)
    settings = {**FILLED, "correction": "log"}  # a factor of 4 at most: within the range
    plain, smooth = (
        DepthPredictor.load(
            write_tiny_weights(tmp_path / name, smoothing=each, **settings)
        ).complete(*random_frame(15, 19))
        for name, each in (("plain.safetensors", None), ("smooth.safetensors", smoothing))
    )
    expected = smoothed(plain.depth_m.numpy(), smoothing.windows_px, smoothing.noise_m)
    np.testing.assert_allclose(smooth.depth_m, expected.clip(NEAREST_M, FARTHEST_M), rtol=1e-4)
    assert not torch.equal(smooth.depth_m, plain.depth_m)
    assert torch.equal(smooth.uncertainty_m, plain.uncertainty_m)


@pytest.mark.parametrize("flip_test", [False, True])  # with it, corrections are those of the mean
@pytest.mark.parametrize(
    ("above", "beside"),
    [
        (None, None),
        (0.4, SignedThreshold(nearer=0.3, farther=0.02)),
        (SignedThreshold(nearer=0.0, farther=0.5), 0.2),
    ],
)
def test_small_corrections_are_left_out_as_the_settings_say(flip_test, above, beside, tmp_path):
    sparse, image = random_frame(70, 19)
    sparse[:55] = 0
    settings = {**FILLED, "correction": "log", "flip_test": flip_test}
    thresholds = {
        "least_correction": 0.1,
        "least_correction_above": above,
        "least_correction_beside": beside,
    }
    plain_m, corrected_m = (
        DepthPredictor.load(write_tiny_weights(tmp_path / name, **settings, **extra))
        .complete(sparse, image)
        .depth_m.numpy()
        for name, extra in (
            ("plain.safetensors", {}),
            ("thresholds.safetensors", thresholds),
        )
    )
    filled_m = starting_depth(sparse).depth_m.numpy()
    directions = [by_direction(each, default=0.1) for each in (above, beside)]
    expected_m = counted(plain_m, filled_m, sparse.numpy() > 0, 0.1, *directions)
    np.testing.assert_allclose(corrected_m, expected_m, rtol=1e-4)
    assert (corrected_m != plain_m).any()


def test_measurements_that_the_completion_keeps_are_put_back_as_the_settings_say(tmp_path):
    sparse, image = random_frame(40, 60)
    settings = {**FILLED, "filling": "second", "keep_measured": True}
    weights = write_tiny_weights(tmp_path / "w.safetensors", **settings)
    depth_m = DepthPredictor.load(weights).complete(sparse, image).depth_m
    is_kept = (sparse > 0) & (starting_depth(sparse, "second").depth_m == sparse)
    assert is_kept.any()
    assert torch.equal(depth_m[is_kept], sparse[is_kept])
    assert (depth_m != starting_depth(sparse, "second").depth_m)[~is_kept].any()


def test_a_flip_test_is_made_where_the_settings_say_so(tmp_path):
    sparse, image = random_frame(16, 20)
    weights = write_tiny_weights(tmp_path / "w.safetensors", flip_test=True, **FILLED)
    network = load_network(TASK, weights).network
    filled_m = starting_depth(sparse).depth_m
    inputs = {
        "image": image / 255,
        "sparse_depth_m": sparse[None],
        "filled_depth_m": filled_m[None],
    }
    expected = predict_with_mirror(
        lambda each: {"depth_m": network(**each).depth_m},
        {name: plane[None] for name, plane in inputs.items()},
    )
    dense = DepthPredictor.load(weights).complete(sparse, image)
    torch.testing.assert_close(
        dense.depth_m, expected["depth_m"][0, 0].clamp(NEAREST_M, FARTHEST_M), rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("size", [(15, 20), (16, 19), (13, 17), (1, 1), (2, 1)])
@pytest.mark.parametrize("number_of_measurements", ["few", "all"])
def test_any_size_is_completed(filled_weights, size, number_of_measurements):
    sparse, image = random_frame(*size, density=1.0 if number_of_measurements == "all" else 0.0)
    sparse[-1, 0] = 10.0
    dense = DepthPredictor.load(filled_weights).complete(sparse, image)
    assert tuple(dense.depth_m.shape) == size
    assert (dense.depth_m > 0).all()


def test_what_is_added_to_reach_the_stride_lies_at_the_top_and_right_and_holds_no_returns(weights):
    sparse, image = random_frame(15, 19, density=1.0)
    padded_sparse = torch.nn.functional.pad(sparse, (0, 1, 1, 0))
    padded_image = torch.cat((image[:, :1], image), dim=1)
    padded_image = torch.cat((padded_image, padded_image[:, :, -1:]), dim=2)
    predictor = DepthPredictor.load(weights)
    expected = predictor.complete(padded_sparse, padded_image).depth_m[1:, :-1]
    assert torch.equal(predictor.complete(sparse, image).depth_m, expected)


def test_arrays_and_tensors_give_the_same_even_if_they_run_backwards_or_are_read_only(weights):
    sparse, image = random_frame(16, 20)
    predictor = DepthPredictor.load(weights)
    expected = predictor.complete(sparse, image).depth_m
    bgr = np.ascontiguousarray(image.permute(1, 2, 0).numpy()[:, :, ::-1])
    bgr.flags.writeable = False
    array = sparse.numpy().astype(np.float64)
    array.flags.writeable = False
    assert torch.equal(predictor.complete(array, bgr[:, :, ::-1]).depth_m, expected)


def test_points_in_a_camera_give_what_their_sparse_map_gives(weights):
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(300, 4, generator=generator) * torch.tensor([30.0, 20, 10, 1])
    points -= torch.tensor([-5.0, 10, 5, 0])
    sparse = sparse_depth_map(points, small_calibration(), IMAGE_SIZE)
    assert sparse.any()
    predictor = DepthPredictor.load(weights)
    expected = predictor.complete(sparse).depth_m
    for cloud in (points, points[:, :3].numpy()):
        dense = predictor.complete_points(cloud, small_calibration(), IMAGE_SIZE)
        assert torch.equal(dense.depth_m, expected)


def test_a_missing_camera_is_a_black_image(weights):
    sparse, image = random_frame(16, 20)
    predictor = DepthPredictor.load(weights)
    without = predictor.complete(sparse).depth_m
    assert torch.equal(without, predictor.complete(sparse, torch.zeros_like(image)).depth_m)
    assert not torch.equal(without, predictor.complete(sparse, image).depth_m)
    assert (without > 0).all()


def test_an_empty_sweep_gives_no_depth_and_nothing_valid(filled_weights):
    _, image = random_frame(15, 20)
    predictor = DepthPredictor.load(filled_weights)
    for picture in (image, None):
        dense = predictor.complete(torch.zeros(15, 20), picture)
        assert not dense.depth_m.any()
        assert not dense.valid.any()
        assert dense.uncertainty_m.isinf().all()


def test_a_sample_is_completed_with_its_image(weights):
    _, image = random_frame(*IMAGE_SIZE)
    points = torch.tensor([[10.0, 0, 0, 0.5], [12, 2, 1, 0.5]])
    sample = CameraLidarSample(
        sample_id="one",
        calibration=small_calibration(),
        image_size=IMAGE_SIZE,
        image=image,
        points=points,
    )
    predictor = DepthPredictor.load(weights)
    expected = predictor.complete_points(points, small_calibration(), IMAGE_SIZE, image)
    assert torch.equal(predictor(sample).depth_m, expected.depth_m)


@pytest.mark.parametrize("completer", ["method", "network"])
def test_a_sample_without_a_sweep_is_refused(weights, completer):
    sample = CameraLidarSample(
        sample_id="blind", calibration=small_calibration(), image_size=IMAGE_SIZE
    )
    predictor = DepthCompleter("nearest") if completer == "method" else DepthPredictor.load(weights)
    with pytest.raises(ValueError, match="sample blind has no sweep"):
        predictor(sample)


@pytest.mark.parametrize("completer", ["method", "network"])
@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_a_sweep_with_points_that_are_not_finite_is_refused(weights, sample, completer, value):
    points = sample.points.clone()
    points[3, 2] = value
    predictor = DepthCompleter("nearest") if completer == "method" else DepthPredictor.load(weights)
    with pytest.raises(ValueError, match="1 points with NaN or infinite values"):
        predictor(dataclasses.replace(sample, points=points))


def test_points_that_are_not_finite_are_counted_in_a_warning(weights, sample):
    points = sample.points.numpy().copy()
    points[:2, 0] = np.nan
    predictor = DepthPredictor.load(weights)
    with pytest.warns(UserWarning, match=f"2 of {len(points)} points are left out"):
        found = predictor.complete_points(points, sample.calibration, sample.image_size)
    kept = predictor.complete_points(points[2:], sample.calibration, sample.image_size)
    assert torch.equal(found.depth_m, kept.depth_m)


@pytest.mark.parametrize(
    ("sparse", "image", "expected"),
    [
        (torch.full((4, 4), -1.0), None, "holds -1.0 in row 0, column 0"),
        (np.full((4, 4), np.nan), None, "holds nan"),
        (torch.ones(1, 4, 4), None, r"shape \(1, 4, 4\), expected height and width"),
        (torch.ones(4, 4), torch.zeros(3, 4, 5, dtype=torch.uint8), "torch.uint8 .*; give it in"),
        (torch.ones(4, 5), np.zeros((3, 4, 5), np.uint8), r"\(4, 5, 3\).*; it has channels first"),
        (torch.ones(4, 4), torch.zeros(3, 4, 4), r"torch.float32 .*\(255 \* image\).round\(\)"),
        (torch.ones(4, 4), np.full((4, 4, 3), -2.0), "are probably normalised: give"),
    ],
)
def test_inputs_that_make_no_sense_are_refused_in_one_line(weights, sparse, image, expected):
    with pytest.raises(ValueError, match=expected) as raised:
        DepthPredictor.load(weights).complete(sparse, image)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("shape", [(5, 2), (5,), (1, 5, 4)])
def test_points_without_coordinates_are_refused_with_their_shape(weights, shape):
    predictor = DepthPredictor.load(weights)
    with pytest.raises(
        ValueError, match=rf"shape \({shape[0]},.*expected one row per point that begins with x, y"
    ):
        predictor.complete_points(np.ones(shape), small_calibration(), IMAGE_SIZE)


@pytest.mark.parametrize("was_used", [False, True])
def test_a_predictor_survives_pickling(filled_weights, was_used):
    sparse, image = random_frame(15, 20)
    predictor = DepthPredictor.load(filled_weights)
    if was_used:
        predictor.complete(sparse, image)
    copied = pickle.loads(pickle.dumps(predictor))
    assert copied.sha256 == predictor.sha256
    expected = predictor.complete(sparse, image)
    assert torch.equal(copied.complete(sparse, image).depth_m, expected.depth_m)


def test_a_network_tells_what_it_can(weights, filled_weights):
    assert not DepthPredictor.load(weights).estimates_uncertainty
    assert DepthPredictor.load(filled_weights).estimates_uncertainty
    assert DepthPredictor.load(weights).has_shift_conv


def test_weights_or_a_method_is_chosen_and_never_both(weights):
    assert choose_completer().name == TASK.default_weights
    assert choose_completer(method="linear") == DepthCompleter("linear")
    assert choose_completer(weights=weights).name == "tiny"
    with pytest.raises(ValueError, match=r"got method linear and weights .*name one of them"):
        choose_completer(method="linear", weights=weights)
    with pytest.raises(ValueError, match=r"adaptive is a method .* --method adaptive"):
        choose_completer(weights="adaptive")


def test_masked_values_are_no_measurements_and_other_byte_orders_are_numbers(weights):
    predictor = DepthPredictor.load(weights)
    sparse, _ = random_frame(16, 24)
    expected = predictor.complete(sparse).depth_m
    wild = np.where(sparse.numpy() > 0, sparse.numpy(), -9)
    for values in (np.ma.masked_less(wild, 0), sparse.numpy().astype(">f4")):
        assert torch.equal(predictor.complete(values).depth_m, expected)


def test_a_cloud_by_columns_or_in_millimetres_is_refused(weights):
    predictor = DepthPredictor.load(weights)
    cloud = np.random.default_rng(0).uniform(5, 50, (90, 3))
    for wrong, expected in (
        (1000 * cloud, "in millimetres"),
        (cloud.T, "one row per point that begins with x, y, z"),
    ):
        with pytest.raises(ValueError, match=expected):
            predictor.complete_points(wrong, small_calibration(), IMAGE_SIZE)


def test_a_sparse_map_of_a_png_s_values_or_millimetres_is_told(weights):
    predictor = DepthPredictor.load(weights)
    sparse, image = random_frame(40, 60)
    for wrong in ((256 * sparse).numpy().astype(np.uint16), 1000 * sparse):
        with pytest.warns(
            UserWarning, match=r"values are above 300 m, beyond every LiDAR: give met"
        ):
            predictor.complete(wrong, image)
    predictor.complete(sparse, image)


@pytest.mark.parametrize(
    ("levels", "cause"), [(1, "of shares from 0 to 1"), (2, "a normalised one")]
)
def test_a_picture_that_was_cast_before_scaling_is_told(weights, sample, levels, cause):
    predictor = DepthPredictor.load(weights)
    sparse, image = random_frame(16, 24)
    with pytest.warns(UserWarning, match=f"no level above {levels} of 255.* probably {cause}"):
        predictor.complete(sparse, image % (levels + 1))
    given = (sample.points, sample.calibration, sample.image_size, sample.image % (levels + 1))
    with pytest.warns(UserWarning, match=f"no level above {levels} of 255"):
        predictor.complete_points(*given)
    predictor(dataclasses.replace(sample, image=given[-1]))  # told when it was made


def test_an_image_size_with_width_before_height_is_told(weights, sample):
    predictor = DepthPredictor.load(weights)
    predictor.complete_points(sample.points, sample.calibration, sample.image_size)
    with pytest.warns(UserWarning, match="height and width are probably swapped"):
        predictor.complete_points(sample.points, sample.calibration, sample.image_size[::-1])


def test_there_is_no_completer_of_a_method_that_there_is_not():
    with pytest.raises((ValueError, TypeError), match="liner"):
        DepthCompleter("liner")
