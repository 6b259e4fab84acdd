"""Doubts whether CameraInfo belongs to the images and their frame."""

import numpy as np
import pytest

from sightline.data.importing.import_recording import import_recording
from tests.data.recordings import CAMERA_FROM_LIDAR, CAMERA_MATRIX, BagMaker

BASELINE_M = 0.12
OFFSET_PX = -BASELINE_M * CAMERA_MATRIX[0, 0]


def report_of(
    folder,
    *,
    camera="camera_optical",
    offset_px=0.0,
    image="/front/image_rect",
    info="/front/camera_info",
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
