import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.geometry.calibration import Calibration, plain_calibration
from sightline.structures.arrays import image_planes, share_in_image, sweep_points, warn_of_view
from sightline.structures.sample import CameraLidarSample
from tests.data.recordings import CAMERA_FROM_LIDAR, CAMERA_MATRIX, IMAGE, POINTS, SAMPLE

CALIBRATION = Calibration.from_matrices(CAMERA_MATRIX, CAMERA_FROM_LIDAR)


@pytest.mark.parametrize("kind", [np.float32, np.float64, ">f4", torch.tensor])
def test_arrays_of_any_type_make_the_simulated_sample(kind):
    points = kind(POINTS) if callable(kind) else POINTS.astype(kind)
    made = CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=points)
    assert torch.equal(made.image, SAMPLE.image)
    assert torch.equal(made.points, SAMPLE.points)
    assert made.image_size == SAMPLE.image_size


def test_either_sensor_may_be_missing_but_not_the_size():
    made = CameraLidarSample.from_arrays(CALIBRATION, points=POINTS, image_size=(375, 1242))
    assert made.image is None
    assert CameraLidarSample.from_arrays(CALIBRATION, image=SAMPLE.image).points is None
    with pytest.raises(ValueError, match="without an image needs image_size: give height and"):
        CameraLidarSample.from_arrays(CALIBRATION, points=POINTS)


def test_a_size_may_come_from_an_array_but_not_contradict_the_image():
    size = np.array(IMAGE.shape[:2])
    made = CameraLidarSample.from_arrays(CALIBRATION, points=POINTS, image_size=tuple(size))
    assert made.image_size == (375, 1242)
    with pytest.raises(ValueError, match=r"is 375x1242 .*, but image_size is 1242x375; give"):
        CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, image_size=(1242, 375))


def test_a_principal_point_of_another_image_is_doubted():
    matrix = np.array(CAMERA_MATRIX)
    matrix[0, 2] *= 0.3
    calibration = Calibration.from_matrices(matrix, CAMERA_FROM_LIDAR)
    with pytest.warns(UserWarning, match="camera_matrix has its principal point at"):
        CameraLidarSample.from_arrays(calibration, image=IMAGE, points=POINTS)


def test_an_image_cropped_without_kittis_camera_matrix_is_doubted():
    matrix = np.array([[721.5377, 0, 609.5593], [0, 721.5377, 172.854], [0, 0, 1]])
    calibration = Calibration.from_matrices(matrix, CAMERA_FROM_LIDAR)
    cropped = np.ascontiguousarray(IMAGE[-352:, 13:1229])
    with pytest.warns(UserWarning, match="camera_matrix is of KITTI's images of 375x1242"):
        CameraLidarSample.from_arrays(calibration, image=cropped, points=POINTS)


def test_a_camera_matrix_is_doubted_once_and_as_that_of_a_recording(recwarn):
    skewed, in_mm = CAMERA_MATRIX.copy(), CAMERA_MATRIX.copy()
    skewed[0, 1] = 120
    in_mm[:2] /= 200
    for matrix in (skewed, in_mm):
        calibration = Calibration.from_matrices(matrix, CAMERA_FROM_LIDAR)
        CameraLidarSample.from_arrays(calibration, image=IMAGE, points=POINTS)
    assert [str(each.message) for each in recwarn] == [
        "camera_matrix has skewed pixel axes (120 and 0 px), expected 0 for a rectified camera",
        "camera_matrix has focal lengths of 3.60769 and 3.60769 px, which do not fit an image of "
        "375x1242 (height x width): they are probably in millimetres, expected pixels",
    ]


def test_the_height_of_the_lidar_is_estimated_from_the_points_if_it_is_not_given():
    made = CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=POINTS)
    assert made.lidar_height_m == pytest.approx(1.73, abs=0.1)
    with pytest.warns(UserWarning, match=r"lidar_height_m is 2.23, but the road .* gives 1.7"):
        higher = CameraLidarSample.from_arrays(
            CALIBRATION, image=IMAGE, points=POINTS, lidar_height_m=2.23
        )
    assert higher.higher_than_kitti_m == pytest.approx(0.5)
    assert SAMPLE.higher_than_kitti_m == 0


def test_a_height_by_the_road_of_a_cloud_in_another_unit_is_doubted():
    scaled = POINTS * np.float32([0.3048, 0.3048, 0.3048, 1])
    with pytest.warns(UserWarning, match=r"is 0\.\d\d m above it.* in feet"):
        CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=scaled)
    CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=scaled, lidar_height_m=0.53)


@pytest.mark.parametrize("height_m", [2, np.float32(2), np.int16(2), torch.tensor(2.0)])
def test_numbers_may_be_of_any_type(height_m):
    made = CameraLidarSample.from_arrays(
        CALIBRATION, image=IMAGE, points=POINTS, lidar_height_m=height_m, max_intensity=height_m
    )
    assert made.higher_than_kitti_m == pytest.approx(0.27)
    moved = replace(made, timestamp_s=1, lidar_height_m=2)
    assert moved.higher_than_kitti_m == made.higher_than_kitti_m


def test_a_grey_picture_becomes_three_channels_and_a_view_of_it_a_picture_of_its_own():
    with pytest.warns(UserWarning, match="images are grey"):
        planes = image_planes(IMAGE[::-1, ::2, 0])
    assert planes.shape == (3, 375, 621)
    assert torch.equal(planes[0], planes[2])
    with pytest.warns(UserWarning, match="images are grey"):
        assert torch.equal(image_planes(IMAGE[::-1, ::2, :1]), planes)  # BGR, as in OpenCV


@pytest.mark.parametrize(
    "image",
    [IMAGE / 255, IMAGE[..., :2], np.zeros(5, np.uint8), torch.zeros(4, 5, 3).byte()],
)
def test_what_is_no_picture_is_refused(image):
    with pytest.raises(ValueError, match=r"the image is .* expected uint8, an array of height"):
        image_planes(image)


def test_rows_that_are_not_finite_are_left_out_and_a_missing_intensity_is_none():
    points = np.array([[1, 2, 3], [np.nan, 0, 0], [4, 5, np.inf], [4, 5, 6]])
    with (
        pytest.warns(UserWarning, match="three columns, x, y, z: the reflectance of their"),
        pytest.warns(UserWarning, match="2 of 4 points are left out, 2 with x, y, z not fin"),
    ):
        assert sweep_points(points).tolist() == [[1, 2, 3, 0], [4, 5, 6, 0]]
    with pytest.warns(UserWarning, match="there are no points"):
        assert sweep_points(np.zeros((0, 4))).shape == (0, 4)


def test_bad_intensities_and_clouds_without_an_echo_are_warned_of_with_counts():
    points = np.array([[1, 2, 3, np.nan], [4, 5, 6, 0.5]])
    with pytest.warns(UserWarning, match="1 of 2 points have an intensity that is not finite"):
        assert sweep_points(points).tolist() == [[1, 2, 3, 0], [4, 5, 6, 0.5]]
    with pytest.warns(UserWarning, match="the points: 9 of 9 points are left out.* none is left"):
        assert sweep_points(np.zeros((9, 4))).shape == (0, 4)


def test_an_organised_cloud_is_a_cloud_and_points_without_an_echo_are_none():
    points = np.arange(24, dtype=np.float32).reshape(2, 3, 4) / 24
    points[1, 2, :3] = 0
    assert sweep_points(points).tolist() == points.reshape(-1, 4)[:-1].tolist()


@pytest.mark.parametrize(
    ("points", "max_intensity", "message"),
    [
        (np.zeros((5, 2)), 1.0, r"float64 of shape \(5, 2\), expected numbers in rows of x, y, z"),
        (POINTS[:500].T, 1.0, r"float32 of shape \(4, 500\), expected numbers in rows"),
        (np.array([["a", "b", "c"]]), 1.0, "expected numbers in rows"),
        (POINTS * 1000, 1000.0, "they are probably in millimetres; write them in metres"),
        (POINTS * np.float32([1, 1, 1, 255]), 1.0, r"to 2\d\d\.?\d*, expected 0 to 1; set max_"),
        (POINTS - np.float32([0, 0, 0, 2]), 1.0, "intensities from -2"),
        (POINTS, 0.0, "max_intensity must be positive"),
    ],
)
def test_what_is_no_cloud_in_metres_is_refused(points, max_intensity, message):
    with pytest.raises(ValueError, match=message):
        sweep_points(points, max_intensity)


def test_points_that_float32_cannot_hold_are_left_out_as_those_that_are_not_finite():
    points = np.float64([[3, 1, 0, 1], [np.finfo(np.float64).max, 1, 0, 1]])  # marks a missing echo
    with pytest.warns(UserWarning, match="1 of 2 points are left out"):
        assert sweep_points(points).tolist() == [[3, 1, 0, 1]]


@pytest.mark.parametrize("lost", [0, 1, 3, 6])
def test_each_loss_of_plain_rows_is_counted_and_of_organised_rows_only_most_of_them(lost):
    points = POINTS[:9].copy()
    points[:lost, 1] = np.nan
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(sweep_points(points)) == 9 - lost
    messages = [str(each.message) for each in caught]
    assert [f"{lost} of 9 points are left out" in each for each in messages] == [True] * bool(lost)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(sweep_points(points.reshape(3, 3, 4))) == 9 - lost
    assert len(caught) == (lost == 6)


@pytest.mark.parametrize("first", [0, 1])
def test_whole_numbers_that_are_evenly_spread_are_taken_for_ring_numbers(first):
    points = np.concatenate([POINTS] * 2)[:4000].astype(np.float64)
    points[:, 3] = np.arange(4000) % 64 + first
    with pytest.raises(ValueError, match=rf"{first} to {first + 63} .* like ring numbers; giv"):
        sweep_points(points)
    points[:, 3] = np.minimum(points[:, 3], 9)  # brightness with one frequent value
    with pytest.raises(ValueError, match="expected 0 to 1; set max_intensity"):
        sweep_points(points)


@pytest.mark.parametrize(
    ("fields", "stacked"),
    [
        ("x y z ring intensity", "'x', 'y', 'z', 'intensity'"),
        ("X Y Z Reflectivity", "'X', 'Y', 'Z', 'Reflectivity'"),
        ("y intensity X Z", "'X', 'y', 'Z', 'intensity'"),
        ("range azimuth", "'x', 'y', 'z'"),
    ],
)
def test_a_structured_array_is_refused_with_the_stack_of_its_fields(fields, stacked):
    points = np.zeros(9, [(name, np.float32) for name in fields.split()])
    with pytest.raises(
        ValueError, match=re.escape(f"for name in ({stacked})], axis=-1)")
    ) as caught:
        sweep_points(points)
    assert f"fields {', '.join(fields.split())}, expected" in str(caught.value)


def test_columns_after_the_fourth_are_left_out_with_a_warning():
    with pytest.warns(UserWarning, match="have 5 columns: .* the others are dropped"):
        assert sweep_points(np.array([[1, 2, 3, 0.5, 7]])).tolist() == [[1, 2, 3, 0.5]]


def test_a_scale_far_above_all_intensities_is_doubted():
    for max_intensity in (255, 1e8):
        with pytest.warns(UserWarning, match="are below a hundredth of max_int"):
            sweep_points(POINTS, max_intensity)
    sweep_points(POINTS * np.float32([1, 1, 1, 0]), 255)  # a sensor without intensities


@pytest.mark.parametrize("columns", [[0, 1, 2, 4, 3], [0, 1, 2, 4]])
@pytest.mark.parametrize("max_intensity", [1, 31, 255])
def test_ring_numbers_in_the_place_of_intensities_are_told_as_such(columns, max_intensity):
    elevation = np.degrees(np.arctan2(POINTS[:, 2], np.hypot(*POINTS[:, :2].T)))
    rows = np.hstack([POINTS, np.floor(elevation - elevation.min())[:, None]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match=r"ring numbers \(0 to \d+, .* order x, y, z, intens"):
            sweep_points(rows[:, columns], max_intensity)


def test_negative_intensities_are_not_blamed_on_their_scale():
    with pytest.raises(ValueError, match=r"intensities from -1 to 0, .*; write intensities from 0"):
        sweep_points(np.float32([[3, 1, 0, -1], [4, 1, 0, 0]]))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"image_size": (0, 1242)},
            "image_size is .0, 1242., expected .height, width.",
        ),
        ({"lidar_height_m": 1730.0}, "lidar_height_m is 1730, expected -0.3 to 10; give .* metres"),
        ({"lidar_height_m": float("nan")}, "lidar_height_m is nan, expected"),
        ({"lidar_tilt_deg": (0, 90)}, r"lidar_tilt_deg is \(0, 90\), expected roll and pitch"),
        ({"lidar_tilt_deg": (0, float("nan"))}, "lidar_tilt_deg is .*, expected roll and pitch"),
        ({"lidar_tilt_deg": (3,)}, r"lidar_tilt_deg is \(3,\), expected roll and pitch"),
    ],
)
def test_sizes_and_heights_that_no_sensor_has_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        CameraLidarSample.from_arrays(CALIBRATION, **{"image_size": (375, 1242), **given})


def test_the_share_of_points_in_the_image_is_one_where_sweeps_are_cut_to_it():
    assert share_in_image(SAMPLE.points, CALIBRATION, SAMPLE.image_size) > 0.99
    assert share_in_image(SAMPLE.points[:0], CALIBRATION, SAMPLE.image_size) == 0


def test_points_that_the_image_does_not_show_are_warned_of():
    start = r"^0 % of the \d+ points fall into the image of 375x1242 \(height x width\): "
    behind = POINTS * np.float32([-1, -1, 1, 1])
    with pytest.warns(UserWarning, match=f"{start}they lie beside or behind .* camera_from_lidar"):
        CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=behind)
    above = POINTS + np.float32([0, 0, 30, 0])
    with pytest.warns(UserWarning, match=f"{start}check camera_matrix against the image's size"):
        warn_of_view(torch.from_numpy(above), CALIBRATION, SAMPLE.image_size)


def test_a_cloud_of_no_points_is_taken_with_a_warning():
    with pytest.warns(UserWarning, match="there are no points: .* give None if there is no LiDAR"):
        made = CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, points=np.zeros((0, 4)))
    assert made.points.shape == (0, 4)


def test_rows_that_a_masked_array_masks_are_no_echoes():
    far = POINTS[:, :1] > 20
    masked = np.ma.masked_array(POINTS, np.broadcast_to(far, POINTS.shape))
    assert torch.equal(sweep_points(masked), sweep_points(POINTS[~far[:, 0]]))
    with pytest.raises(ValueError, match=r"the image has .* values masked, .*; fill them"):
        image_planes(np.ma.masked_array(IMAGE, IMAGE > 200))


@pytest.mark.parametrize(
    ("image", "remedy"),
    [
        (IMAGE / 255, r"\(255 \* image\).round\(\).clip\(0, 255\) as uint8"),
        (IMAGE.astype(np.float32), r"\(image\).round\(\)"),
        (np.full((4, 5, 3), np.nan), "round its levels"),
        (IMAGE / 255 * 1.2 - 0.1, r"round its levels: \(255 \* image\).round"),  # as by resizing
        (IMAGE * 1.2 - 25.0, r"round its levels: \(image\).round"),
        (IMAGE - 110.0, r"normalised: give \(image \* std \+ mean\).round\(\)"),
        (IMAGE.transpose(2, 0, 1), r"channels first: give np\.asarray\(image\)\.transpose"),
        (torch.from_numpy(IMAGE), "channels last: give image.permute"),
        (np.dstack((IMAGE, IMAGE[..., :1])), "leave its fourth channel out"),
        (IMAGE.astype(">u2"), "convert it to RGB of 8 bits"),
        (np.array("a.png"), "read the file first"),
        (IMAGE[None], "give one picture at a time"),
        (IMAGE[:0], "it holds no pixel: give a whole picture"),
    ],
)
def test_a_picture_of_another_layout_is_told_how_to_convert_it(image, remedy):
    with pytest.raises(ValueError, match=f"the image is .* expected uint8, .*{remedy}"):
        image_planes(image)


@pytest.mark.parametrize("kind", [bool, complex, object, str])
def test_points_of_another_type_than_numbers_are_told_to_convert_it(kind):
    with pytest.raises(ValueError, match=r"expected numbers in rows .*; convert them to float32"):
        sweep_points(POINTS.astype(kind))


def test_a_picture_of_shares_in_whole_numbers_is_doubted_and_a_black_one_is_not():
    with pytest.warns(UserWarning, match=r"no level above 1 of 255.* give .255 \* image"):
        image_planes((IMAGE / 255).round().astype(np.uint8))
    assert not image_planes(np.zeros_like(IMAGE)).any()
    assert image_planes((IMAGE > 99) * np.uint8(4)).max() == 4


@pytest.mark.parametrize(
    ("mean", "std"), [(0.5, 0.5), ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))]
)
def test_a_normalised_picture_is_told_how_to_undo_it_and_is_then_the_same(mean, std):
    image = (IMAGE / 255 - mean) / std
    with pytest.raises(ValueError, match="are probably normalised: give ") as error:
        image_planes(image)
    remedy = str(error.value).split(": give ")[1].split(" as uint8")[0]
    undone = eval(remedy, {"image": image, "mean": mean, "std": std})
    assert np.array_equal(image_planes(undone.astype(np.uint8)), image_planes(IMAGE))
    with pytest.raises(ValueError, match=r"mean and std \(of shape 3, 1, 1; 0.5 and 0.5 for level"):
        image_planes(torch.tensor(image).permute(2, 0, 1))


def test_a_normalised_picture_that_was_only_rounded_is_doubted():
    rounded = ((IMAGE / 255 - 0.45) / 0.22).round().clip(0, 255).astype(np.uint8)
    with pytest.warns(UserWarning, match=r"no level above 2 of 255.* give .255 \* \(image \* std"):
        image_planes(rounded)


def test_a_sample_has_a_picture_of_its_own():
    buffer = torch.zeros(3, 4, 5, dtype=torch.uint8)
    planes = image_planes(buffer)
    buffer[:] = 9  # the next frame
    assert not planes.any()


def test_true_is_no_height():
    with pytest.raises(ValueError, match="lidar_height_m is True, expected a number; give one"):
        CameraLidarSample.from_arrays(CALIBRATION, image=IMAGE, lidar_height_m=True)


@pytest.mark.parametrize("wrong", [None, "calib.txt", {"P2": 1}, np.eye(3)])
def test_what_is_no_calibration_is_told_how_to_make_one(wrong):
    with pytest.raises(TypeError, match=r"calibration is of type .*; make one by Calibration.from"):
        plain_calibration(wrong)


@pytest.mark.parametrize("num_clouds", [2, 3, 8])
@pytest.mark.parametrize("kind", [np.stack, lambda clouds: torch.tensor(np.stack(clouds))])
def test_a_batch_of_clouds_is_refused_unless_it_is_given_as_one_sweep(num_clouds, kind):
    starts = np.linspace(0, 400, num_clouds).astype(int)  # as if turning on between sweeps
    clouds = [np.roll(POINTS, start, axis=0)[:16000] for start in starts]
    given = kind(clouds)
    with pytest.raises(ValueError, match=r"are . clouds, .*; give one cloud at a time") as error:
        sweep_points(given)
    assert "or points.reshape(-1, 4) for parts of one sweep" in str(error.value)
    assert len(sweep_points(np.stack(clouds).reshape(-1, 4))) == 16000 * num_clouds


def test_a_cloud_without_heights_is_doubted():
    flat = POINTS * np.float32([1, 1, 0, 1])
    with pytest.warns(UserWarning, match="with z = 0: the cloud is flat; write the measured z"):
        sweep_points(flat)
