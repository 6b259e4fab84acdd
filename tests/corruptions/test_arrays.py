import numpy as np
import pytest
import torch

from sightline.augmentation.faults import fault_rng
from sightline.corruptions.arrays import corrupt_arrays
from sightline.corruptions.kinds import KINDS, plain_severity
from tests.data.scenes import sample_of

SAMPLE = sample_of(depth=None, objects=None)
MATRICES = {
    "image_from_camera": SAMPLE.calibration.image_from_camera.numpy(),
    "camera_from_lidar": SAMPLE.calibration.camera_from_lidar.numpy(),
}
IMAGE = SAMPLE.image.numpy().transpose(1, 2, 0)
POINTS = SAMPLE.points.numpy()


@pytest.mark.parametrize("kind", KINDS)
def test_arrays_become_what_a_sample_becomes_and_stay_as_they_are(kind):
    image, points = IMAGE.copy(), POINTS.copy()
    found = corrupt_arrays(
        kind, 4, image=image, points=points, **MATRICES, seed=5, name=SAMPLE.sample_id
    )
    expected = KINDS[kind].at(4).corrupt(SAMPLE, fault_rng(SAMPLE, 5, kind))
    assert np.array_equal(found.image.transpose(2, 0, 1), expected.sample.image.numpy())
    assert np.array_equal(found.points, expected.sample.points.numpy())
    assert found.record == expected.record
    for name in ("camera_mask", "lidar_mask", "broken_points", "point_sources"):
        mask = getattr(expected, name)
        assert (getattr(found, name) is None) == (mask is None)
        assert mask is None or torch.equal(torch.from_numpy(getattr(found, name)), mask)
    found.image[:], found.points[:] = 3, 3
    assert np.array_equal(image, IMAGE)
    assert np.array_equal(points, POINTS)


def test_a_lidar_alone_needs_the_size_of_the_image():
    found = corrupt_arrays("lidar_fog", 5, points=POINTS, image_size=(120, 400), **MATRICES)
    assert found.image is None
    assert found.lidar_mask.shape == (120, 400)
    listed = corrupt_arrays("lidar_fog", 5, points=POINTS, image_size=[120, 400], **MATRICES)
    assert np.array_equal(listed.points, found.points)
    with pytest.raises(ValueError, match="image_size"):
        corrupt_arrays("lidar_fog", 5, points=POINTS, **MATRICES)


@pytest.mark.parametrize("kind", ["camera_fog", "lidar_fog"])
def test_points_of_half_precision_are_those_of_single_precision(kind):
    half = POINTS.astype(np.float16)
    found, same = (
        corrupt_arrays(kind, 3, image=IMAGE, points=points, **MATRICES)
        for points in (half, half.astype(np.float32))
    )
    assert np.array_equal(found.points, same.points)
    assert np.array_equal(found.image, same.image)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"image": IMAGE.astype(np.float32)}, "image must be uint8, height x width x 3; got float"),
        ({"image": IMAGE.transpose(2, 0, 1)}, "got uint8 of shape 3 x 120 x 400"),
        ({"points": POINTS[:, :2]}, "the points are float32 of shape .300, 2., expected"),
        ({"points": POINTS[None]}, "points must be N x 3 or more, .* got float32 of shape 1 x 300"),
        ({"camera_from_lidar": None}, "give both or neither"),
        ({"camera_from_lidar": None, "image_from_camera": None}, "camera_fog needs a calibration"),
        ({"points": np.array([[1, 2, 3, 0], [1, 2, 3, np.nan]])}, "finite and .* row 1 is not"),
        (
            {"points": np.array([[1e39, 0, 0, 0]])},
            "points must be finite and at most 1e\\+06; row 0",
        ),
        (
            {"points": POINTS * [[1, 1, 1, 255]]},
            "reflectances .* from 0 to 1, got .* by the sensor",
        ),
        ({"image_from_camera": np.eye(3)}, "image_from_camera must be 3 x 4 numbers"),
        ({"depth": np.zeros((3, 3, 3))}, "depth must be floating point, height x width"),
        ({"depth": np.zeros((3, 4))}, "height x width as the image, 120 x 400; got .* 3 x 4"),
        ({"depth": np.full((120, 400), np.nan)}, "depth must not be negative or NaN"),
        (
            {"image": None, "image_size": (0, 5)},
            "image_size is .0, 5., expected .height, width.",
        ),
        ({"image_size": (5, 5)}, "image is 120x400 .* but image_size is 5x5; omit"),
        ({"image": IMAGE[:, :, 0], "image_size": (5, 5)}, "image must be uint8, height x width"),
        ({"points": np.full((1, 4), np.inf, np.float16)}, "points must be finite .* row 0 is not"),
        ({"seed": -1}, "seed must not be negative"),
        ({"seed": True}, "seed is True, expected a whole number of 0 or more"),
        ({"points": POINTS * [[1e3, 1e3, 1e3, 1]]}, "points: .* probably in millimetres; write"),
        ({"points": np.ma.masked_array(POINTS, POINTS > 9)}, "points has .* values masked"),
        ({"image": np.ma.masked_array(IMAGE, IMAGE > 9)}, "image has .* values masked"),
        ({"image": torch.empty(3, 4, 3, device="meta")}, "image is a tensor on the device meta"),
        (
            {"image": IMAGE.transpose(2, 0, 1)},
            r"channels first: give np\.asarray\(image\)\.transpose\(1, 2, 0\)",
        ),
        ({"depth": np.full((120, 400), np.inf)}, "depth must be finite"),
    ],
)
def test_what_is_no_such_array_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        corrupt_arrays("camera_fog", 1, **{"image": IMAGE, **MATRICES, **wrong})


@pytest.mark.parametrize("kind", ["camera_fog", "lidar_fog"])
def test_tensors_and_lists_are_arrays_as_well(kind):
    expected = corrupt_arrays(kind, 4, image=IMAGE, points=POINTS, **MATRICES)
    tensors = {name: torch.from_numpy(matrix) for name, matrix in MATRICES.items()}
    lists = {name: matrix.tolist() for name, matrix in MATRICES.items()}
    for points, matrices in ((torch.from_numpy(POINTS), tensors), (POINTS, lists)):
        found = corrupt_arrays(kind, 4, image=torch.from_numpy(IMAGE), points=points, **matrices)
        np.testing.assert_array_equal(found.image, expected.image)
        np.testing.assert_array_equal(found.points, expected.points)
    with pytest.raises(ValueError, match="expected an array; give rows of one length"):
        corrupt_arrays(kind, 4, image=[[1], [2, 3]], **MATRICES)


@pytest.mark.parametrize("kind", ["lidar_fog", "lidar_point_drop"])
def test_clouds_of_three_columns_or_of_five_are_those_of_four(kind):
    dark = POINTS * np.float32([1, 1, 1, 0])
    five = np.hstack([POINTS, np.full((len(POINTS), 1), np.nan)])  # a column that nobody needs
    messages = {3: "the reflectance of their points is set to 0", 5: "the others are dropped"}
    for given, same in ((POINTS[:, :3], dark), (five, POINTS)):
        with pytest.warns(UserWarning, match=messages[given.shape[1]]):
            found = corrupt_arrays(kind, 3, image=IMAGE, points=given, **MATRICES)
        expected = corrupt_arrays(kind, 3, image=IMAGE, points=same, **MATRICES)
        assert np.array_equal(found.points, expected.points)
        assert np.array_equal(found.point_sources, expected.point_sources)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_kinds_that_need_no_calibration_do_the_same_without_one(kind):
    given = {"image": IMAGE, "points": POINTS, "name": "a"}
    if KINDS[kind].at(3).needs_calibration:
        with pytest.raises(ValueError, match=f"{kind} needs a calibration"):
            corrupt_arrays(kind, 3, **given)
        return
    expected, found = corrupt_arrays(kind, 3, **given, **MATRICES), corrupt_arrays(kind, 3, **given)
    assert np.array_equal(found.image, expected.image)
    assert np.array_equal(found.points, expected.points)
    assert found.record == expected.record


def test_several_kinds_meet_a_frame_one_after_the_other():
    found = corrupt_arrays(
        "lidar_point_drop+lidar_gaussian_noise+camera_contrast", 3, image=IMAGE, points=POINTS
    )
    assert found.record.sensors == ("camera", "lidar")
    assert set(found.record.parameters) > {"camera_contrast.factor"}
    assert len(found.points) < len(POINTS)
    moved = np.abs(found.points[:, :3] - POINTS[found.point_sources, :3])
    assert 0 < moved.max() < 1
    assert found.broken_points.all()
    assert (found.image != IMAGE).any()
    for wrong in ("lidar_fog+lidar_fog", "lidar_fog+", "camera_fog+fogg"):
        with pytest.raises(ValueError, match=r"named twice|no kind of corruption"):
            corrupt_arrays(wrong, 3, image=IMAGE, points=POINTS, **MATRICES)


@pytest.mark.parametrize("severity", [True, 2.5, 9, 0, "3", None, [3]])
def test_a_severity_is_a_whole_number_from_one_to_five(severity):
    with pytest.raises(ValueError, match="camera_fog has severities from 1 to 5, got "):
        plain_severity("camera_fog", severity)


def test_a_calibration_and_a_depth_that_no_sensors_have_are_warned_of_as_elsewhere():
    inverted = np.linalg.inv(MATRICES["camera_from_lidar"])
    given = {"image": IMAGE, "points": POINTS}
    with pytest.warns(UserWarning, match="camera_from_lidar is probably inverted"):
        corrupt_arrays("camera_fog", 1, **given, **{**MATRICES, "camera_from_lidar": inverted})
    skewed = MATRICES["image_from_camera"] + np.eye(3, 4, 1) * [[50], [0], [0]]
    with pytest.warns(UserWarning, match="^image_from_camera has skewed pixel axes .50 and 0 px"):
        corrupt_arrays("camera_fog", 1, **given, **{**MATRICES, "image_from_camera": skewed})
    doubled = MATRICES["image_from_camera"] * [[2], [2], [1]]
    with pytest.warns(UserWarning, match="^image_from_camera has its principal point .* another r"):
        corrupt_arrays("camera_fog", 1, **given, **{**MATRICES, "image_from_camera": doubled})
    with pytest.warns(
        UserWarning, match="^depth has a 99th percentile of depths of 2e.04 m: give metres"
    ):
        corrupt_arrays("camera_fog", 1, **given, **MATRICES, depth=np.full((120, 400), 2e4))


def test_a_masked_depth_is_unknown_there():
    depth = np.full((120, 400), 20.0)
    masked = np.ma.masked_array(depth, depth > 3)
    found, expected = (
        corrupt_arrays("camera_fog", 3, image=IMAGE, **MATRICES, depth=each)
        for each in (masked, 0 * depth)
    )
    assert np.array_equal(found.image, expected.image)


@pytest.mark.parametrize(
    ("doubtful", "message"),
    [
        ({"image": (IMAGE > 99).astype(np.uint8)}, "no level above 1 of 255"),
        (
            {"points": POINTS + np.float32([150, 0, 0, 0])},
            "none nearer than .* in a map's or world's f",
        ),
        ({"points": POINTS * np.float32([1, 1, 1, 1e-4])}, "below a hundredth of max_intensity"),
    ],
)
def test_arrays_are_doubted_as_those_of_a_sample_are(doubtful, message):
    with pytest.warns(UserWarning, match=message):
        corrupt_arrays(
            "camera_fog", 1, **{"image": IMAGE, "points": POINTS, **MATRICES, **doubtful}
        )
