"""Warnings are attributed to the user's line, so that a mistake made again is told again."""

import warnings
from functools import cached_property

import numpy as np
import pytest
from torch.utils.data import DataLoader, Dataset

from sightline import Calibration, CameraLidarSample
from tests import shape_checks
from tests.data.recordings import CAMERA_FROM_LIDAR, CAMERA_MATRIX, IMAGE, POINTS

INVERTED = np.linalg.inv(CAMERA_FROM_LIDAR)
SOUND = Calibration.from_matrices(CAMERA_MATRIX, CAMERA_FROM_LIDAR)
NOWHERE = CAMERA_MATRIX * [[3], [3], [1]]


def from_arrays(image=IMAGE, points=POINTS, calibration=SOUND):
    return CameraLidarSample.from_arrays(calibration, image=image, points=points)


CALLS = {
    "inverted": (lambda: Calibration.from_matrices(CAMERA_MATRIX, INVERTED), "inverted"),
    "grey": (lambda: from_arrays(IMAGE[:, :, 0]), "grey"),
    "black": (lambda: from_arrays(np.ones_like(IMAGE)), "level"),
    "empty": (lambda: from_arrays(points=POINTS[:0]), "empty"),
    "NaN": (lambda: from_arrays(points=np.where(POINTS > 60, np.nan, POINTS)), "finite"),
    "three columns": (lambda: from_arrays(points=POINTS[:, :3]), "reflectance"),
    "upside down": (lambda: from_arrays(points=POINTS * np.float32([1, -1, -1, 1])), "points up"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_warning_points_to_the_users_line(name):
    call, text = CALLS[name]
    with pytest.warns(UserWarning, match=text) as caught:
        call()
    assert {each.filename for each in caught} <= {__file__, shape_checks.__file__}


def test_a_mistake_made_again_on_another_line_is_told_again():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        Calibration.from_matrices(CAMERA_MATRIX, INVERTED)
        Calibration.from_matrices(CAMERA_MATRIX, CAMERA_FROM_LIDAR)
        Calibration.from_matrices(CAMERA_MATRIX, INVERTED)
    first, second = caught
    assert str(first.message) == str(second.message)
    assert second.lineno == first.lineno + 2


class _Doubtful(Dataset):
    """Data whose items warn, as Sightline's data sets do."""

    def __len__(self):
        return 1

    @cached_property
    def doubt(self):
        from_arrays(IMAGE[:, :, 0])
        return 0

    def __getitem__(self, index):
        return self.doubt


def test_a_warning_within_a_data_loader_points_to_the_loop(monkeypatch):
    monkeypatch.setitem(globals(), "__name__", "sightline.doubtful")  # frames above are no user's
    with pytest.warns(UserWarning, match="grey") as caught:
        exec("for _ in DataLoader(data): pass", {"DataLoader": DataLoader, "data": _Doubtful()})
    assert {each.filename for each in caught} <= {"<string>", shape_checks.__file__}
