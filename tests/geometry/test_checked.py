import pickle
from dataclasses import dataclass

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.checked import checked
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample
from tests.data.recordings import SAMPLE

MATRICES = {
    "image_from_camera": SAMPLE.calibration.image_from_camera,
    "camera_from_lidar": SAMPLE.calibration.camera_from_lidar,
}


@checked()
@dataclass(frozen=True, slots=True)
class Row:
    values: np.ndarray
    names: tuple[str, ...]


FIELDS = {"sample_id": "a", "calibration": SAMPLE.calibration, "image_size": (3, 4)}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Calibration(**{**MATRICES, "image_from_camera": np.eye(3)}),
            r"Calibration takes image_from_camera as Float64\[Tensor, '\*batch 3 4'\], got "
            r"f64\[3,3\]\(numpy\); Calibration.from_matrices converts matrices",
        ),
        (
            lambda: CameraLidarSample(**{**FIELDS, "sample_id": 42}),
            "CameraLidarSample takes sample_id as str, got 42; CameraLidarSample.from_arrays conv",
        ),
        (
            lambda: CameraLidarSample(**FIELDS, image=torch.zeros(3, 3, 4)),
            r"takes image as UInt8\[Tensor, '3 height width'\] . None, got f32\[3,3,4\]",
        ),
        (lambda: Boxes3D(torch.zeros(2, 6)), r"Boxes3D takes tensor as Float\[.* 7'\], got f32"),
        (
            lambda: DepthMap(depth_m=torch.zeros(3, 4), valid=torch.ones(3, 5).bool()),
            r"DepthMap takes valid as Bool\[Tensor, 'height width'\], got .*; convert it",
        ),
    ],
)
def test_a_field_of_another_type_is_named_in_one_line(make, message):
    with pytest.raises(TypeError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_wide_class_takes_whole_numbers_for_floats_and_stays_what_it_is():
    sample = CameraLidarSample(**FIELDS, timestamp_s=3)
    assert pickle.loads(pickle.dumps(sample)).timestamp_s == 3
    with pytest.raises(TypeError, match="'calibration'"):
        CameraLidarSample(sample_id="a", image_size=(3, 4))


def test_what_is_unknown_at_the_same_places_is_equal_in_tensors_and_arrays():
    rows = torch.tensor([[1.0, 2.0, 3.0, 4.0], [torch.nan] * 4])
    assert Boxes2D(rows) == Boxes2D(rows.clone())
    assert hash(Boxes2D(rows)) == hash(Boxes2D(rows.clone()))
    assert Boxes2D(rows) != Boxes2D(rows.flip(0))
    assert Boxes2D(rows) != Boxes2D(rows.nan_to_num())
    assert Boxes2D(rows) != Boxes2D(rows[:1])
    assert Row(np.array([np.nan, 1.0]), ("a",)) == Row(np.array([np.nan, 1.0]), ("a",))
    assert Row(np.array([np.nan, 1.0]), ("a",)) != Row(np.array([1.0, np.nan]), ("a",))
    assert Row(np.array([1, 2]), ("a",)) == Row(np.array([1, 2]), ("a",))
    assert Row(np.array(["a"]), ("a",)) == Row(np.array(["a"]), ("a",))
