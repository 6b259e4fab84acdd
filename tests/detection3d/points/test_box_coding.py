"""Boxes by bins: against plain numbers, and back again."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass
from sightline.detection3d.points.box_coding import (
    decode_boxes,
    encode_boxes,
    likeliest_code,
    split_prediction,
)
from sightline.detection3d.points.config import BoxCodingConfig
from tests.detection3d.boxes import rows
from tests.reference import box_coding as reference

coordinate = st.floats(-80, 80) | st.integers(-4, 4).map(lambda k: k / 2)  # borders of bins, too
size = st.floats(0.05, 20)
yaw = st.floats(-math.pi, math.nextafter(math.pi, 0)) | st.integers(-12, 11).map(
    lambda k: k * math.pi / 12  # middles and borders of bins
)
boxes = st.tuples(coordinate, coordinate, coordinate, size, size, size, yaw)
offsets = st.tuples(*[st.floats(-4, 4) | st.integers(-7, 7).map(lambda k: k / 2)] * 3)
configs = st.sampled_from(
    [BoxCodingConfig(), BoxCodingConfig(scope_m=1.5, heading_bins=9), BoxCodingConfig(bin_m=3.0)]
)
means = st.sampled_from([CAR, PEDESTRIAN, CYCLIST]).map(lambda entry: entry.mean_size_m)
entries = st.lists(st.tuples(boxes, offsets, means), max_size=4)


def tensors(drawn):
    box = rows([entry[0] for entry in drawn])
    point = box[:, :3] - torch.tensor([entry[1] for entry in drawn]).double().reshape(-1, 3)
    mean = torch.tensor([entry[2] for entry in drawn]).double().reshape(-1, 3)
    return box, point, mean


@given(drawn=entries, config=configs)
def test_decoding_gives_back_every_box_also_beyond_the_scope(drawn, config):
    box, point, mean = tensors(drawn)
    again = decode_boxes(encode_boxes(box, point, mean, config), point, mean, config)
    turn = torch.remainder(again[:, 6] - box[:, 6] + 1, 2 * math.pi) - 1
    torch.testing.assert_close(again[:, :6], box[:, :6], atol=1e-9, rtol=0)
    torch.testing.assert_close(turn, torch.zeros_like(turn), atol=1e-9, rtol=0)
    assert ((again[:, 6] >= -math.pi) & (again[:, 6] < math.pi)).all()


@given(drawn=entries, config=configs)
def test_bins_and_residuals_are_those_of_plain_numbers(drawn, config):
    box, point, mean = tensors(drawn)
    code = encode_boxes(box, point, mean, config)
    for k in range(len(drawn)):
        dx, dy, dz = (box[k, :3] - point[k]).tolist()
        for offset, given_bin, residual in (
            (dx, code.x_bin[k].item(), code.x_residual[k].item()),
            (dy, code.y_bin[k].item(), code.y_residual[k].item()),
        ):
            expected = reference.bin_code(offset, config.scope_m, config.bin_m)
            # on a border either bin is right, with the residual that belongs to it
            assert given_bin + residual == pytest.approx(sum(expected), abs=1e-9)
            assert given_bin == expected[0] or abs(abs(residual) - 0.5) < 1e-9
        expected = reference.heading_code(box[k, 6].item(), config.heading_bins)
        residual = code.heading_residual[k].item()
        if abs(abs(residual) - 1) > 1e-9:
            assert code.heading_bin[k].item() == expected[0]
            assert residual == pytest.approx(expected[1], abs=1e-9)
        assert abs(residual) <= 1 + 1e-9
        assert code.z_offset[k].item() == dz
        relative = [
            (s - m) / m for s, m in zip(box[k, 3:6].tolist(), mean[k].tolist(), strict=True)
        ]
        assert code.size_residual[k].tolist() == pytest.approx(relative)


def test_convention_the_first_heading_bin_is_centred_on_yaw_0_and_they_turn_counter_clockwise():
    config = BoxCodingConfig(heading_bins=4)
    yaws = torch.tensor([0.0, 0.7, 0.9, math.pi / 2, -math.pi, -math.pi / 2, -0.7])
    box = torch.zeros(7, 7)
    box[:, 3:6], box[:, 6] = 1.0, yaws
    code = encode_boxes(box, torch.zeros(7, 3), torch.ones(7, 3), config)
    assert code.heading_bin.tolist() == [0, 0, 1, 1, 2, 3, 0]


def test_a_network_that_is_sure_of_the_code_is_decoded_to_the_box():
    config = BoxCodingConfig()
    box = rows([[10, 5, -1, 4.1, 1.7, 1.6, -2.0], [8, 4, 0, 3.5, 1.5, 1.4, 3.0]])
    point, mean = box[:, :3] + 0.7, torch.tensor([CAR.mean_size_m] * 2).double()
    code = encode_boxes(box, point, mean, config)
    values = torch.randn(2, config.channels).double()
    prediction = split_prediction(values, config)
    for scores, residuals, chosen, residual in (
        (prediction.x_bins, prediction.x_residuals, code.x_bin, code.x_residual),
        (prediction.y_bins, prediction.y_residuals, code.y_bin, code.y_residual),
        (
            prediction.heading_bins,
            prediction.heading_residuals,
            code.heading_bin,
            code.heading_residual,
        ),
    ):
        scores.scatter_(1, chosen[:, None], 99.0)
        residuals.scatter_(1, chosen[:, None], residual[:, None])
    prediction.z_offset[:, 0] = code.z_offset
    prediction.size_residual[:] = code.size_residual
    decoded = decode_boxes(likeliest_code(prediction), point, mean, config)
    torch.testing.assert_close(decoded, box)


def test_no_prediction_is_decoded_to_a_size_that_is_not_positive():
    config, nothing, mean = BoxCodingConfig(), torch.zeros(1, 3), torch.ones(1, 3)
    code = likeliest_code(split_prediction(torch.full((1, config.channels), -9.0), config))
    assert (decode_boxes(code, nothing, mean, config)[:, 3:6] > 0).all()


def test_published_numbers_make_76_channels():
    assert BoxCodingConfig().channels == 76
    assert BoxCodingConfig().center_bins == 12


def test_settings_out_of_range_are_refused():
    for scope_m, bin_m in (
        (3.0, 0.7),
        (0.0, 0.5),
        (3.0, 0.0),
        (1.0, 4.0),
        (math.inf, 1.0),
        (3.0, 5e-324),
    ):
        with pytest.raises(ValueError, match="2 \\* scope_m must be a multiple of bin_m"):
            BoxCodingConfig(scope_m=scope_m, bin_m=bin_m)
    with pytest.raises(ValueError, match="heading_bins must be at least 1, got 0"):
        BoxCodingConfig(heading_bins=0)
    for length_m in (0.0, -1.0, math.nan, math.inf, 1e9):
        with pytest.raises(ValueError, match="mean_size_m of Tram must be from 0"):
            RoadUserClass(name="Tram", mean_size_m=(length_m, 2.0, 3.0))
