"""Doubts whether CameraInfo belongs to the images and their frame."""

import cv2
import numpy as np
import pytest

from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import CAMERA_FROM_LIDAR, CAMERA_MATRIX, IMAGE, BagMaker

BASELINE_M = 0.12
LENS = (-0.03, 0.01, 0.0005, -0.0003, -0.002)
SMALLER = CAMERA_MATRIX * [[0.9], [0.9], [1.0]]
OFFSET_PX = -BASELINE_M * CAMERA_MATRIX[0, 0]
ZEROS = np.zeros((3, 3))


def report_of(
    folder,
    *,
    camera="camera_optical",
    offset_px=0.0,
    image="/front/image_rect",
    info="/front/camera_info",
    other_info=None,
    **tf,
):
    """Import a bag with a chain from the LiDAR to the camera, and return the report."""
    options = {"info_topic": tf.pop("info_topic", None)}
    folder.mkdir(exist_ok=True)
    with BagMaker(folder / "drive") as bag:
        plain = bag.header
        bag.header = lambda name, at: plain(name.replace("camera_optical", camera), at)
        tf |= {f"{camera}__lidar": CAMERA_FROM_LIDAR}
        bag.transforms("/tf_static", 10**9, **tf)
        bag.info(info, 10**9, offset_px=offset_px)
        if other_info is not None:
            bag.info(other_info, 10**9, matrix=2 * CAMERA_MATRIX)
        bag.image(image, 10**9)
        bag.cloud("/points", 10**9)
    return str(import_recording(folder / "drive", folder / "out", **options))


def beside(metres):
    """Pose of a camera to the right."""
    pose = np.eye(4)
    pose[0, 3] = metres
    return pose


def test_a_baseline_that_is_in_p_and_in_tf_is_told(tmp_path):
    left = beside(-BASELINE_M)  # so camera_optical is the right camera's own frame
    report = report_of(tmp_path, offset_px=OFFSET_PX, camera_optical__other=left)
    assert "warning: P of CameraInfo has the baseline of a stereo pair, 0.12 m, and TF" in report
    assert "counted twice, 8.66 px at 10 m; look whether points fit" in report


@pytest.mark.parametrize(
    ("camera", "is_doubtful"),
    [("right_optical", True), ("bright_optical", False), ("left_optical", False)],
)
def test_a_second_camera_s_own_frame_is_also_known_by_its_name(tmp_path, camera, is_doubtful):
    report = report_of(tmp_path, offset_px=OFFSET_PX, camera=camera)
    assert ("has right_optical, probably the second camera's own frame" in report) == is_doubtful
    assert ("stereo" in report) == is_doubtful


@pytest.mark.parametrize(
    ("offset_px", "frames"),
    [
        (OFFSET_PX, {"camera_optical__right": beside(BASELINE_M)}),  # P's own frame is the first's
        (OFFSET_PX, {"camera_optical__centre": beside(-BASELINE_M / 2)}),
        (OFFSET_PX, {}),
        (0.0, {"camera_optical__left": beside(-BASELINE_M)}),
        (0.0, {}),
    ],
)
def test_a_baseline_that_is_in_p_or_in_tf_alone_is_no_doubt(tmp_path, offset_px, frames):
    assert "stereo" not in report_of(tmp_path, offset_px=offset_px, **frames)


@pytest.mark.parametrize(
    ("image", "info"),
    [
        ("/front/image_rect", "/rear/camera_info"),
        ("/sensing/camera/camera0/image_rect", "/sensing/camera/camera1/camera_info"),
        ("/zed/left/color/image_rect", "/zed/right/color/camera_info"),
    ],
)
def test_a_camera_info_of_another_camera_s_folder_is_told(tmp_path, image, info):
    report = report_of(tmp_path, image=image, info=info)
    assert f"warning: {info} is not beside {image}: it may belong to another camera" in report


def test_a_camera_info_of_another_camera_s_folder_is_taken_where_it_is_named(tmp_path):
    report = report_of(tmp_path, info="/rear/camera_info", info_topic="/rear/camera_info")
    assert "not beside" not in report


@pytest.mark.parametrize(
    ("image", "info"),
    [
        ("/front/image_rect", "/camera_info"),
        ("/image_rect", "/front/camera_info"),
        ("/front/rgb/image_rect", "/front/camera_info"),
        ("/front/image_rect", "/front/rectified/camera_info"),
        ("/sensors/image_rect/front", "/sensors/camera_info/front"),
    ],
)
def test_a_camera_info_that_may_be_beside_the_images_is_no_doubt(tmp_path, image, info):
    assert "not beside" not in report_of(tmp_path, image=image, info=info)


@pytest.mark.parametrize(
    ("image", "info", "other_info"),
    [
        ("/image_rect", "/camera_info", "/depth/camera_info"),
        ("/camera/image_rect", "/camera/camera_info", "/camera/depth/camera_info"),
        ("/camera/image_rect", "/camera/camera_info", "/camera/aligned/depth/camera_info"),
    ],
)
def test_the_camera_info_beside_the_images_goes_before_those_below(
    tmp_path, image, info, other_info
):
    report = report_of(tmp_path, image=image, info=info, other_info=other_info)
    assert f"calibration {info} " in report


@pytest.mark.parametrize(
    ("name", "coefficients", "model"),
    [
        ("equidistant", (*LENS[:4], 0.0), "equidistant"),
        ("equidistant", (*LENS[:4], *[0.0] * 4), "equidistant"),
        ("radtan", LENS, "plumb_bob"),
        ("Plumb_Bob", LENS, "plumb_bob"),
        ("plumb-bob", LENS[:4], "plumb_bob"),
        ("", LENS, "plumb_bob"),
        ("Rational_Polynomial", (*LENS, 0.0, 0.0, 0.0), "rational_polynomial"),
        ("plumb_bob", (*LENS, 0.0, 0.0, 0.0), "rational_polynomial"),
        ("rational_polynomial", LENS, "plumb_bob"),
        ("EQUIDISTANT", LENS[:4], "equidistant"),
        ("equi", LENS[:4], "equidistant"),
        ("fisheye", LENS[:4], "equidistant"),
        ("kannala_brandt", LENS[:4], "equidistant"),
        ("radtan", (0.0,) * 5, None),
        ("PINHOLE", (0.0,) * 5, None),
        ("brown_conrady", (0.0,) * 5, None),
        ("none", (), None),
    ],
)
def test_lens_models_are_known_in_their_usual_spellings(tmp_path, name, coefficients, model):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9, distortion=coefficients, model=name)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    import_recording(tmp_path / "drive", tmp_path / "out", undistort=model is not None)
    lens = read_recording_calibration(tmp_path / "out" / "calibration.yaml").lens
    assert (None if lens is None else lens.model) == model


def test_lens_models_that_need_more_than_a_name_are_refused(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9, distortion=LENS, model="pinhole")
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    with pytest.raises(ValueError, match=r"the lens model 'pinhole' is unknown; .*--calibration"):
        import_recording(tmp_path / "drive", tmp_path / "out", undistort=True)


def test_compressed_images_are_rectified_without_a_note_by_their_usual_name(tmp_path):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9, distortion=LENS)
        content = cv2.imencode(".jpg", IMAGE)[1].tobytes()
        bag.jpeg("/front/image_rect/compressed", 10**9, content)
        bag.cloud("/points", 10**9)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "count as rectified" not in report
    assert read_recording_calibration(tmp_path / "out" / "calibration.yaml").lens is None


@pytest.mark.parametrize(
    ("topic", "is_straight"),
    [
        ("/front/image_rect", True),
        ("/front/image_rect_raw", True),
        ("/front/rectified/image", True),
        ("/front/rect/image", True),
        ("/front/image_undistorted", True),
        ("/front/undistorted/image_raw", True),
        ("/rectangle_cam/image", False),
        ("/front/image_raw", False),
        ("/rectifier/image_raw", False),
        ("/front/image_direct", False),
    ],
)
def test_rectified_images_are_known_by_their_topics(tmp_path, topic, is_straight):
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        bag.info("/front/camera_info", 10**9, distortion=LENS)
        bag.image(topic, 10**9)
        bag.cloud("/points", 10**9)
    if not is_straight:
        with pytest.raises(ValueError, match=r"the lens distorts .*undistort the images by --undi"):
            import_recording(tmp_path / "drive", tmp_path / "out")
        return
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert read_recording_calibration(tmp_path / "out" / "calibration.yaml").lens is None
    assert ("count as rectified, by the topic's name" in report) == ("image_" not in topic[6:13])


def report_of_infos(folder, infos, topic="/front/image_rect"):
    """Import a bag with these CameraInfo messages, and return the report and the camera matrix."""
    with BagMaker(folder / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for each, info in enumerate(infos):
            bag.info(f"{topic.rpartition('/')[0]}/camera_info", 10**9 + each, **info)
        bag.image(topic, 10**9)
        bag.cloud("/points", 10**9)
    report = str(import_recording(folder / "drive", folder / "out"))
    matrices = read_recording_calibration(folder / "out" / "calibration.yaml").matrices
    np.testing.assert_allclose(matrices.camera_from_lidar, CAMERA_FROM_LIDAR, atol=1e-9)
    return report, matrices.image_from_camera[:, :3]


@pytest.mark.parametrize("topic", ["/front/image_undistorted", "/undistorted/front/image"])
@pytest.mark.parametrize("diagonal", [(0, 0, 0), (0, 0, 1), (1, 1, 1), (np.nan, np.nan, np.nan)])
def test_rectified_images_without_p_have_k(tmp_path, topic, diagonal):
    info = {"projection": np.diag(diagonal), "rectification": ZEROS}
    report, matrix = report_of_infos(tmp_path, [info], topic)
    assert "P of CameraInfo has no usable focal length: K is used in its place" in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


def test_a_rectification_of_zeros_beside_p_is_none(tmp_path):
    report, matrix = report_of_infos(tmp_path, [{"rectification": ZEROS}])
    assert "K is used" not in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


@pytest.mark.parametrize("rectification", [ZEROS, np.eye(3)])
def test_p_alone_is_used_for_any_topic_if_nothing_is_distorted(tmp_path, rectification):
    info = {"matrix": ZEROS, "projection": CAMERA_MATRIX, "rectification": rectification}
    report, matrix = report_of_infos(tmp_path, [info], "/front/image_raw")
    assert "K of CameraInfo holds only zeros: P is used in its place, so images of" in report
    assert "/front/image_raw count as rectified" in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


def test_p_alone_is_named_in_the_error_if_there_is_a_lens(tmp_path):
    info = {"matrix": ZEROS, "projection": CAMERA_MATRIX, "distortion": LENS}
    with pytest.raises(ValueError, match="K holds only zeros, and P, which is given, is without"):
        report_of_infos(tmp_path, [info], "/front/image_raw")


def test_a_message_with_k_goes_before_more_messages_without(tmp_path):
    infos = [*[{"matrix": ZEROS, "projection": SMALLER}] * 2, {}]
    report, matrix = report_of_infos(tmp_path, infos, "/front/image_raw")
    assert "the first of them: K holds only zeros" in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


def test_a_message_with_p_goes_before_more_messages_without(tmp_path):
    report, matrix = report_of_infos(
        tmp_path, [*[{"matrix": SMALLER, "projection": ZEROS}] * 2, {}]
    )
    assert (
        "2 of 3 messages of /front/camera_info are unusable or less usable than number 2 (from 0)"
        in report
    )
    assert "the first of them: P has no usable focal length" in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


@pytest.mark.parametrize("has_projection", [True, False])
@pytest.mark.parametrize(
    ("factor", "size", "told"),
    [
        (0.01, IMAGE.shape[:2], "focal lengths of 7.21538 and 7.21538 px, which do not fit an"),
        (2.5, IMAGE.shape[:2], None),
        (0.4, (150, 497), None),
    ],
)
def test_a_first_calibration_that_does_not_fit_the_images_is_not_used(
    tmp_path, factor, size, told, has_projection
):
    later = [CAMERA_MATRIX * [[each], [each], [1.0]] for each in (1.0, 1.0001, 1.0002)]
    infos = [{"matrix": CAMERA_MATRIX * [[factor], [factor], [1.0]], "size": size}]
    infos += [{"matrix": each} for each in later]
    if not has_projection:
        infos = [{**info, "projection": ZEROS} for info in infos]
    report, matrix = report_of_infos(tmp_path, infos)
    assert "messages of /front/camera_info differ from number 1 (from 0)" in report
    assert told is None or told in report
    np.testing.assert_allclose(matrix, CAMERA_MATRIX)


@pytest.mark.parametrize("is_fixed", [True, False])
@pytest.mark.parametrize("size", [(375, 1242), (0, 0)])
def test_a_first_default_without_the_region_of_interest_is_not_used(tmp_path, size, is_fixed):
    """A region at the top left looks like an image of another size, by its principal point."""
    height, width = 230, 760
    cut = {"region": (0, 0, height, width), "size": IMAGE.shape[:2]}
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(6):
            focus = [[1.0], [1.0], [1.0]] if is_fixed else [[1 + at / 1e4]] * 2 + [[1.0]]
            info = {"size": size} if at == 0 else {**cut, "matrix": CAMERA_MATRIX * focus}
            bag.info("/front/camera_info", 10**9 + at, **info)
        bag.image("/front/image_raw", 10**9, picture=IMAGE[:height, :width])
        bag.cloud("/points", 10**9)
    report = str(import_recording(tmp_path / "drive", tmp_path / "out"))
    assert "differ from number 1 (from 0)" in report
    camera = read_recording_calibration(tmp_path / "out" / "calibration.yaml")
    matrix = camera.matrices.image_from_camera[:, :3]
    np.testing.assert_allclose(matrix, CAMERA_MATRIX, rtol=2e-4)


def test_a_first_image_of_another_size_does_not_outvote_the_other_messages(tmp_path):
    half = [[0.5], [0.5], [1.0]]
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        for at in range(4):
            time_ns = 10**9 + at * 10**8
            small = {"matrix": CAMERA_MATRIX * half, "size": (188, 621)} if at == 0 else {}
            bag.info("/front/camera_info", time_ns, **small)
            bag.image("/front/image_rect", time_ns, picture=IMAGE[::2, ::2] if at == 0 else IMAGE)
            bag.cloud("/points", time_ns)
    report = import_recording(tmp_path / "drive", tmp_path / "out")
    assert report.written == 3
    assert "image 0 is 188x621 (height x width), but its calibration is for 375x1242" in str(report)


def test_rectified_images_with_the_k_of_raw_ones_are_told_whatever_their_topic(tmp_path):
    raw = CAMERA_MATRIX.copy()
    raw[:2, 2] *= 1.2  # as kitti2bag publishes, of images of 1392x512
    with BagMaker(tmp_path / "drive") as bag:
        bag.transforms("/tf_static", 10**9, camera_optical__lidar=CAMERA_FROM_LIDAR)
        info = {"matrix": raw, "projection": CAMERA_MATRIX, "distortion": LENS}
        bag.info("/front/camera_info", 10**9, **info)
        bag.image("/front/image_raw", 10**9)
        bag.cloud("/points", 10**9)
    told = "P fits the images and K does not: they are probably rectified already"
    with pytest.raises(ValueError, match=f"the lens distorts .*{told}.* by --calibration"):
        import_recording(tmp_path / "drive", tmp_path / "out")
    assert told in str(import_recording(tmp_path / "drive", tmp_path / "out", undistort=True))
