import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.data.open import open_dataset
from sightline.detection2d.config import InputConfig, PostprocessConfig
from sightline.detection2d.placement import Candidates, camera_image, lidar_image, padded
from sightline.detection2d.predictor import DetectionPredictor
from sightline.detection2d.views import draw_band, gate_over_frame, views_of
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.sample import CameraLidarSample
from tests.detection2d.frames import TINY_COMPACT, write_network
from tests.geometry.cameras import CAMERA_FROM_LIDAR
from tests.reference.gates import gate_laid_over_frame

KEPT = InputConfig(size=None)
REAL_KITTI = [  # height, width, focal length, principal row of KITTI's recording days
    (375, 1242, 721.5377, 172.854),
    (370, 1224, 707.0493, 180.5066),
    (374, 1238, 718.3351, 181.5122),
    (376, 1241, 718.856, 185.2157),
    (352, 1216, 721.5377, 149.854),
]


def frame(size, focal_px, *, principal_y=None, pitch_deg=0.0, seed=0):
    """Noise of a camera that looks down by a pitch, with points on the road and above it."""
    height, width = size
    rng = np.random.default_rng(seed)
    y = (height - 1) / 2 if principal_y is None else principal_y
    matrix = [[focal_px, 0, (width - 1) / 2, 0], [0, focal_px, y, 0], [0, 0, 1, 0]]
    cos, sin = math.cos(math.radians(pitch_deg)), math.sin(math.radians(pitch_deg))
    pitched = torch.eye(4, dtype=torch.float64)
    pitched[1:3, 1:3] = torch.tensor([[cos, -sin], [sin, cos]], dtype=torch.float64)
    points = rng.uniform((3, -15, -1.7, 0), (60, 15, 2, 1), (500, 4)).astype(np.float32)
    return CameraLidarSample(
        sample_id="frame",
        calibration=Calibration(
            image_from_camera=torch.tensor(matrix, dtype=torch.float64),
            camera_from_lidar=pitched @ torch.tensor(CAMERA_FROM_LIDAR, dtype=torch.float64),
        ),
        image_size=size,
        image=torch.from_numpy(rng.integers(0, 255, (3, *size), dtype=np.uint8)),
        points=torch.from_numpy(points),
    )


def views(sample, config=KEPT, **changes):
    return views_of(sample, config, **{"stride": 32, "smallest_px": 32, **changes})


@pytest.mark.parametrize(("height", "width", "focal_px", "principal_y"), REAL_KITTI)
@pytest.mark.parametrize("pitch_deg", [-1.0, 0.0, 1.0])
def test_kittis_frames_are_one_view_as_they_are(height, width, focal_px, principal_y, pitch_deg):
    sample = frame((height, width), focal_px, principal_y=principal_y, pitch_deg=pitch_deg)
    (view,) = views(sample)
    assert view.sample is sample
    assert not view.is_cut
    images = view.inputs(("image", "lidar"), KEPT, 32)
    size = (-(-height // 32) * 32, -(-width // 32) * 32)
    assert torch.equal(images["image"][0], padded(camera_image(sample), size))
    assert torch.equal(images["lidar"][0], padded(lidar_image(sample, KEPT), size))


cameras = st.tuples(
    st.integers(200, 1600),  # height
    st.integers(64, 300),  # width, which does not matter
    st.floats(300, 2500),  # focal length
    st.floats(-12, 12),  # pitch
)


@settings(max_examples=30)
@given(camera=cameras)
def test_points_of_a_view_go_back_to_their_pixels_of_the_frame(camera):
    height, width, focal_px, pitch_deg = camera
    sample = frame((height, width), focal_px, pitch_deg=pitch_deg)
    xyz = sample.points[:, :3].double()
    in_frame = project_points(xyz, sample.calibration).pixels
    for view in views(sample):
        pixels = project_points(xyz, view.sample.calibration).pixels
        seen = project_points(xyz, view.sample.calibration).in_image(view.sample.image_size)
        boxes = view.placement.to_image(torch.cat((pixels, pixels), dim=1)[seen])
        torch.testing.assert_close(boxes[:, :2], in_frame[seen], atol=1e-6, rtol=0)
        torch.testing.assert_close(boxes[:, 2:], in_frame[seen], atol=1e-6, rtol=0)


@settings(max_examples=30)
@given(camera=cameras)
def test_views_are_bands_about_the_horizon(camera):
    height, width, focal_px, pitch_deg = camera
    sample = frame((height, width), focal_px, pitch_deg=pitch_deg)
    shown = views(sample)
    for view in shown:
        rows = view.sample.image_size[0]
        assert rows <= 205 + 235 + 32  # begins at a whole stride
        assert view.placement.top % 32 == 0
        assert view.placement.top + rows <= view.full_height
        scale = view.placement.scale_y
        horizon = scale * ((height - 1) / 2 - focal_px * math.tan(math.radians(pitch_deg)))
        for row in (horizon - 200, horizon + 230):  # is in the band where it is in the frame
            inside = view.placement.top <= row < view.placement.top + rows
            assert inside or not 0 <= row < view.full_height - 1
    scales = [view.placement.scale_y / shown[0].placement.scale_y for view in shown]
    assert [view.range_m for view in shown] == [80 * scale for scale in scales]
    has_coarse = shown[0].is_cut
    has_fine = focal_px >= 1.3 * 750
    assert len(shown) == 1 + has_coarse + has_fine
    if has_coarse:
        assert scales[1] == pytest.approx(0.5, abs=0.01)
    if has_fine:
        assert scales[-1] == pytest.approx(min(2, focal_px / 750), rel=0.01)


def test_a_pitch_moves_the_band():
    tops = [
        views(frame((1500, 200), 722.0, pitch_deg=pitch))[0].placement.top for pitch in (-8, 0, 8)
    ]
    assert tops == [640, 544, 416]


def test_views_answer_for_boxes_by_their_height_and_not_for_those_that_are_cut_off():
    first, coarse, fine = views(frame((3000, 400), 1444.0))
    scale = first.placement.scale_y
    start = first.placement.top
    end = start + first.sample.image_size[0]
    rows = torch.tensor(  # y_min, y_max in pixels of the resized frame
        [
            [start + 180, start + 200],  # small, near the horizon
            [start + 50, start + 50 + 110],  # in between
            [start + 50, start + 50 + 200],  # large
            [end - 200.0, end - 1],  # cut off at the bottom
            [start, start + 200.0],  # and at the top
        ]
    )
    columns = torch.zeros(5)
    boxes = torch.stack((columns, rows[:, 0], columns + 60, rows[:, 1]), dim=1)
    found = Candidates((boxes + 0.5) / scale - 0.5, torch.ones(5), torch.arange(5))
    owners = {
        name: view.own(found).class_indices.tolist()
        for name, view in (("first", first), ("coarse", coarse), ("fine", fine))
    }
    assert owners == {"first": [0, 1, 2], "coarse": [2, 3, 4], "fine": [0]}


@pytest.mark.parametrize("height", [375, 440])
def test_a_whole_view_answers_for_all_boxes(height):
    (view,) = views(frame((height, 400), 722.0))
    boxes = torch.tensor([[0.0, 0.0, 9.0, height - 1.0], [0.0, 5.0, 2.0, 7.0]])
    found = Candidates(boxes, torch.ones(2), torch.arange(2))
    assert view.own(found).class_indices.tolist() == [0, 1]


def test_half_the_scale_looks_like_twice_the_distance():
    sample = frame((1500, 200), 722.0)
    twice = replace(sample, points=sample.points * torch.tensor([2.0, 2.0, 1.0, 1.0]))
    near, far = views(sample)[1], views(twice)[0]
    depth = {
        name: view.inputs(("lidar",), KEPT, 32)["lidar"][0, 0]
        for name, view in (("near", near), ("far", far))
    }
    levels = [each[each > 0] for each in depth.values()]
    assert float(levels[0].max()) == pytest.approx(float(levels[1].max()), abs=0.02)


@pytest.mark.parametrize(
    ("config", "changes"),
    [(InputConfig(size=(64, 96)), {}), (KEPT, {"smallest_px": 257})],
    ids=["a network of one size", "a coarser view would be too small"],
)
def test_where_views_do_not_suit_the_network_it_is_shown_the_whole_frame(config, changes):
    (view,) = views(frame((500, 300), 722.0), config, **changes)
    assert not view.is_cut
    assert view.placement.top == 0


@settings(max_examples=20)
@given(camera=cameras, groups=st.integers(1, 2))
def test_gates_are_laid_as_by_plain_loops(camera, groups):
    height, width, focal_px, pitch_deg = camera
    shown = views(frame((height, width), focal_px, pitch_deg=pitch_deg))
    generator = torch.Generator().manual_seed(0)
    gates = []
    for view in shown:
        rows, columns = (-(-side // 32) * 4 for side in view.sample.image_size)
        gates.append(torch.rand(groups, rows, columns, generator=generator))
    laid = gate_over_frame(gates, shown, 32)
    expected = gate_laid_over_frame(
        [gate.mean(dim=0).numpy() for gate in gates],
        [view.placement.top for view in shown],
        [view.sample.image_size for view in shown],
        [shown[0].full_height / view.full_height for view in shown],
        shown[0].full_height,
    )
    np.testing.assert_allclose(laid.numpy(), expected, atol=1e-6)


def test_a_tall_frame_gets_boxes_and_gates_in_its_own_pixels(tmp_path):
    every_box = PostprocessConfig(min_score=0.0)
    write_network(tmp_path / "tiny.safetensors", replace(TINY_COMPACT, postprocess=every_box))
    sample = frame((1000, 300), 722.0)
    result = DetectionPredictor.load(tmp_path / "tiny.safetensors")(sample)
    assert result.camera_gate.shape == result.lidar_gate.shape == (125, 38)
    boxes = result.detections.boxes.tensor
    assert ((boxes[:, 2:] <= torch.tensor([299.0, 999.0])) & (boxes[:, :2] >= 0)).all()
    assert len(boxes) == 100


def test_training_draws_each_of_a_tall_frames_bands_at_its_scale_and_range():
    sample = frame((1200, 1920), 1400.0)
    expected = {(each.sample.image_size[0], each.range_m) for each in views(sample)}
    assert len(expected) == 3
    drawn = set()
    for seed in range(20):
        part, scale, range_m = draw_band(sample, KEPT, 32, np.random.default_rng(seed))
        rows = round(part.image_size[0] * scale)
        (height,) = (each for each, known_m in expected if known_m == range_m)
        assert abs(rows - height) <= 1
        assert part.image_size[1] == 1920
        drawn.add((height, range_m))
    assert drawn == expected


def test_training_shows_kittis_frames_whole():
    for seed in range(5):
        sample = frame((375, 1242), 721.5377, principal_y=172.854)
        part, scale, range_m = draw_band(sample, KEPT, 32, np.random.default_rng(seed))
        assert part is sample
        assert (scale, range_m) == (1.0, 80.0)


def test_a_packaged_frame_is_one_view():
    sample = open_dataset(PACKAGED_FRAMES)[0]
    (view,) = views(sample)
    assert view.sample is sample
