"""Boxes fitted to other sensors' labels."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.predictor import Detection3DPredictor
from sightline.detection3d.suppression import ClassAlignment, align
from sightline.detection3d.task import Detection3D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D
from tests.detection3d.frames import COMPACT, simulated_frames, write_network
from tests.reference.alignment import aligned

metres = st.floats(-2, 2)


def detections(rows, names):
    boxes = torch.tensor(rows, dtype=torch.float64).reshape(-1, 7)
    return Detections3D(
        class_names=tuple(names), boxes=Boxes3D(boxes), scores=torch.rand(len(boxes))
    )


@given(st.integers(0, 10**6), st.integers(0, 6), metres, metres)
def test_boxes_are_those_of_the_slow_way(seed, count, length_m, towards_m):
    generator = torch.Generator().manual_seed(seed)
    rows = 20 * torch.rand(count, 7, generator=generator, dtype=torch.float64) - 10
    rows[:, 3:6] = rows[:, 3:6].abs() / 3 + 0.2
    names = [("Car", "Cyclist")[int(row[0] > 0)] for row in rows]
    found = detections(rows.tolist(), names)
    alignment = ClassAlignment(name="Car", length_m=length_m, towards_m=towards_m)
    expected = torch.tensor(
        aligned(rows.tolist(), names, "Car", length_m, towards_m), dtype=torch.float64
    )
    moved = align(found, [alignment])
    torch.testing.assert_close(moved.boxes.tensor, expected.reshape(-1, 7))
    assert moved.class_names == found.class_names
    assert torch.equal(moved.scores, found.scores)
    assert torch.equal(found.boxes.tensor, rows)  # the input is untouched


def test_a_car_ahead_comes_nearer_from_either_heading_and_one_across_stays():
    rows = [[20.0, 0, -1, 4, 2, 1.5, yaw] for yaw in (0.0, torch.pi, torch.pi / 2)]
    found = align(detections(rows, ["Car"] * 3), [ClassAlignment(name="Car", towards_m=0.5)])
    torch.testing.assert_close(
        found.boxes.tensor[:, 0], torch.tensor([19.5, 19.5, 20.0], dtype=torch.float64)
    )


def test_a_box_on_the_lidar_stays():
    found = align(detections([[0.0] * 3 + [1.0] * 4], ["Car"]),
                  [ClassAlignment(name="Car", towards_m=0.5)])  # fmt: skip
    assert not found.boxes.tensor[0, :3].any()


def test_it_acts_in_use_and_not_in_training(tmp_path):
    cars = ClassAlignment(name="Car", length_m=-0.1, towards_m=0.08)
    config = replace(COMPACT, alignment=(cars,))
    write_network(tmp_path / "plain", COMPACT)
    write_network(tmp_path / "aligned", config)
    sample = simulated_frames()[0]
    plain = Detection3DPredictor.load(tmp_path / "plain")(sample)
    moved = Detection3DPredictor.load(tmp_path / "aligned")(sample)
    assert "Car" in plain.class_names
    torch.testing.assert_close(moved.boxes.tensor, align(plain, [cars]).boxes.tensor)


@pytest.mark.parametrize("network", [None, COMPACT])
def test_a_training_from_aligned_weights_has_none(tmp_path, network):
    cars = ClassAlignment(name="Car", length_m=-0.1, towards_m=0.08)
    written = write_network(tmp_path / "w", replace(COMPACT, alignment=(cars,)))
    task = Detection3D(network, initial_weights=tmp_path / "w")
    assert task.network_config().alignment == ()
    for name, tensor in task.network.state_dict().items():
        assert torch.equal(tensor, written.state_dict()[name])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"name": "Van"}, "alignment names Van, but the classes are Car, Pedestrian, Cyclist"),
        ({"name": "Car", "length_m": float("nan")}, r"alignment.length_m must be from -10 to 10"),
        ({"name": "Car", "towards_m": 11.0}, r"alignment.towards_m must be from -10 to 10, got 11"),
    ],
)
def test_alignments_that_make_no_sense_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        replace(COMPACT, alignment=(ClassAlignment(**settings),))


def test_a_class_is_aligned_once():
    cars = ClassAlignment(name="Car", length_m=-0.1)
    with pytest.raises(ValueError, match="alignment names a class more than once"):
        replace(COMPACT, alignment=(cars, cars))
