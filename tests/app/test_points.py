import struct

import numpy as np
import torch

from sightline.app.points import MAX_POINTS, pack_points


def unpacked(packed):
    count, step_m = struct.unpack_from("<If", packed)
    rows = np.frombuffer(packed, np.uint8, offset=8).reshape(count, 8)
    steps = rows[:, :6].copy().view("<i2")
    return steps * step_m, rows[:, 6] / 255, rows[:, 7]


def test_a_point_takes_eight_bytes_and_comes_back_to_half_a_centimetre():
    points = torch.tensor([[1.234, -50.678, 0.5, 0.2], [-79.996, 0.0, -1.73, 1.0]])
    packed = pack_points(points)
    assert len(packed) == 8 + 2 * 8
    places, reflectance, fault = unpacked(packed)
    assert np.abs(places - points[:, :3].numpy()).max() <= 0.00501
    assert np.abs(reflectance - points[:, 3].numpy()).max() <= 0.5 / 255 + 1e-6
    assert fault.tolist() == [0, 0]


def test_far_points_make_the_steps_larger_instead_of_being_cut():
    points = torch.tensor([[1000.0, -600.0, 20.0, 0.0]])
    places, _, _ = unpacked(pack_points(points))
    assert np.abs(places - points[:, :3].numpy()).max() <= 1000 / 32767


def test_points_that_the_sound_sweep_does_not_have_are_marked():
    sound = torch.tensor([[1.0, 2.0, 3.0, 0.5], [4.0, 5.0, 6.0, 0.5], [7.0, 8.0, 9.0, 0.1]])
    broken = torch.stack((sound[2], sound[0] + torch.tensor([0.0, 0.0, 0.001, 0.0])))
    assert unpacked(pack_points(broken, sound))[2].tolist() == [0, 1]


def test_no_sweep_no_points_and_points_that_are_not_finite():
    assert len(unpacked(pack_points(None))[0]) == 0
    assert len(unpacked(pack_points(torch.zeros(0, 4), torch.zeros(0, 4)))[0]) == 0
    holed = torch.tensor([[np.nan, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    assert unpacked(pack_points(holed))[0].tolist() == [[np.float32(1.0), 0, 0]]


def test_a_huge_sweep_is_thinned_evenly_to_a_bounded_size():
    points = torch.arange(MAX_POINTS * 2 + 1).float()[:, None].repeat(1, 4) / 1e4
    places, _, _ = unpacked(pack_points(points))
    assert MAX_POINTS / 2 < len(places) <= MAX_POINTS
    assert abs(places[-1, 0] - points[-1, 0].item()) < 0.02
