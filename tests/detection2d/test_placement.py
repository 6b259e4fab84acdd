from dataclasses import replace

import pytest
import torch

from sightline.augmentation.scene_changes import resize
from sightline.detection2d.config import InputConfig
from sightline.detection2d.placement import place
from tests.detection2d.frames import painted_frame

KEPT = InputConfig(size=None)


def seen_by(focal_px, size=(120, 400)):
    """A frame of a camera of this focal length."""
    sample = resize(painted_frame(0), *size)
    matrix = sample.calibration.image_from_camera.clone()
    matrix[0, 0] = matrix[1, 1] = focal_px
    return replace(sample, calibration=replace(sample.calibration, image_from_camera=matrix))


@pytest.mark.parametrize(
    ("focal_px", "scale", "size"),
    [
        (707.0, 1.0, (120, 400)),
        (722.0, 1.0, (120, 400)),
        (1500.0, 1.0, (60, 200)),
        (1500.0, 0.5, (30, 100)),
        (361.0, 1.0, (120, 400)),
        (361.0, 0.5, (60, 200)),
        (1e9, 1.0, (1, 1)),
    ],
)
def test_frames_of_a_longer_focal_length_are_shrunk_to_kittis(focal_px, scale, size):
    given, _ = place(seen_by(focal_px), replace(KEPT, scale=scale))
    assert given.image_size == size
    assert given.image.shape[1:] == size


def test_boxes_go_back_to_the_frames_own_pixels():
    sample = seen_by(1100.0)
    given, placement = place(sample, KEPT)
    boxes = given.objects.boxes2d.tensor
    assert (boxes < sample.objects.boxes2d.tensor).all()
    torch.testing.assert_close(placement.to_image(boxes), sample.objects.boxes2d.tensor)


def test_a_network_of_one_size_sees_every_camera_at_that_size():
    given, _ = place(seen_by(1500.0), InputConfig(size=(90, 300)))
    assert given.image_size == (90, 300)


def test_a_limit_that_is_none_is_refused():
    with pytest.raises(ValueError, match="longest_focal_px must be from 1 to"):
        InputConfig(longest_focal_px=0.0)
    with pytest.raises(ValueError, match="size must have up to 8388608 pixels, got"):
        InputConfig(size=(8192, 8192))
