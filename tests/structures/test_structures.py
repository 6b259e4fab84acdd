import dataclasses

import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample, check_points
from tests.geometry.cameras import kitti_like_calibration


def two_objects():
    return ObjectLabels(
        class_names=("Car", "DontCare"),
        boxes2d=Boxes2D(torch.tensor([[10.0, 10, 60, 50], [0, 0, 5, 5]])),
        boxes3d=Boxes3D(torch.tensor([[10.0, 0, -1, 4, 2, 1.5, 0], [0.0] * 7])),
        truncation=torch.tensor([0.0, -1.0], dtype=torch.float64),
        occlusion=torch.tensor([0, -1]),
        alpha=torch.tensor([0.1, -10.0], dtype=torch.float64),
    )


def test_an_object_without_a_3d_part_says_so():
    assert two_objects().has_box3d.tolist() == [True, False]


def test_selecting_objects_takes_every_column_along():
    kept = two_objects().select(torch.tensor([False, True]))
    assert kept.class_names == ("DontCare",)
    assert kept.alpha.tolist() == [-10.0]
    assert len(kept) == len(kept.boxes2d) == len(kept.boxes3d) == 1


def test_labels_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match="columns of one length"):
        ObjectLabels(
            class_names=("Car",),
            boxes2d=Boxes2D(torch.zeros(2, 4)),
            boxes3d=Boxes3D(torch.zeros(2, 7)),
            truncation=torch.zeros(2, dtype=torch.float64),
            occlusion=torch.zeros(2, dtype=torch.long),
            alpha=torch.zeros(2, dtype=torch.float64),
        )


def test_detections_need_one_score_per_box():
    with pytest.raises(ValueError, match="1 classes, 1 boxes and 2 scores"):
        Detections3D(class_names=("Car",), boxes=Boxes3D(torch.zeros(1, 7)), scores=torch.zeros(2))


def test_an_image_of_another_size_than_the_camera_is_refused():
    with pytest.raises(ValueError, match=r"image of sample 000007 is 370x1242.*expected 375x1242"):
        CameraLidarSample(
            sample_id="000007",
            calibration=kitti_like_calibration(),
            image_size=(375, 1242),
            image=torch.zeros(3, 370, 1242, dtype=torch.uint8),
        )


def test_a_depth_map_of_another_size_than_the_camera_is_refused():
    with pytest.raises(ValueError, match=r"depth of sample 000007 is 375x1200"):
        CameraLidarSample(
            sample_id="000007",
            calibration=kitti_like_calibration(),
            image_size=(375, 1242),
            depth=torch.zeros(375, 1200),
        )


def test_shapes_are_checked_in_production_too():
    with pytest.raises(Exception, match="num_points 4"):
        CameraLidarSample(
            sample_id="000007",
            calibration=kitti_like_calibration(),
            image_size=(375, 1242),
            points=torch.zeros(5, 3),
        )


@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ([1, 1, 1, 255], "intensities from 76.5 to 255, expected 0 to 1"),
        ([1000, 1000, 1000, 1], "probably in millimetres"),
    ],
)
def test_points_of_another_scale_are_refused_with_the_samples_name(scales, said):
    points = torch.tensor([[10.0, 1, -1.5, 0.3], [20, -3, 0.5, 1]]).repeat(200, 1)
    sample = CameraLidarSample(
        sample_id="f7",
        calibration=kitti_like_calibration(),
        image_size=(4, 6),
        points=points,
    )
    check_points(sample)
    wrong = dataclasses.replace(sample, points=points * torch.tensor(scales).float())
    with pytest.raises(ValueError, match=f"the sweep of sample f7 has .*{said}"):
        check_points(wrong)
