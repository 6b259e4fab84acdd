"""Gates beside what is known to be wrong: records of frames, figures of cases."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.corruptions.corruption import Corrupted, Record
from sightline.corruptions.suites import find_suite
from sightline.detection2d.predictor import DetectionResult
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.projection import sparse_depth_map
from sightline.papers.gates import (
    NUM_LEVELS,
    measure_gates,
    pool_gates,
    read_gate_record,
    score_gates,
    write_gate_record,
)
from sightline.structures.predictions import Detections2D
from tests.detection2d.frames import painted_frame
from tests.reference import gates as reference

SIZE = (24, 36)
NOTHING = Detections2D(class_names=(), boxes=Boxes2D(torch.zeros(0, 4)), scores=torch.zeros(0))
SOUND = painted_frame(0, SIZE, rows=[])


def make_result(camera, lidar):
    return DetectionResult(detections=NOTHING, camera_gate=camera, lidar_gate=lidar)


def corrupted(camera_mask, lidar_mask, sample=SOUND):
    record = Record(kind="test", sensors=("camera", "lidar"), parameters={})
    return Corrupted(sample=sample, record=record, camera_mask=camera_mask, lidar_mask=lidar_mask)


def record_of(camera, lidar, camera_mask, lidar_mask):
    return measure_gates(make_result(camera, lidar), SOUND, corrupted(camera_mask, lidar_mask))


def level(gate):
    return min(max(round(np.log(gate / (1 - gate)) * 32) + NUM_LEVELS // 2, 0), NUM_LEVELS - 1)


@given(
    seed=st.integers(0, 99),
    cells=st.tuples(st.integers(1, 7), st.integers(1, 9)),
    box=st.tuples(*(st.integers(0, 24) for _ in range(4))),
)
def test_cells_are_split_by_the_mask_as_loops_over_pixels_say(seed, cells, box):
    generator = torch.Generator().manual_seed(seed)
    camera, lidar = (0.01 + 0.98 * torch.rand(*cells, generator=generator) for _ in range(2))
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[min(box[0], box[1]) : max(box[0], box[1]), min(box[2:]) : max(box[2:])] = True
    found = record_of(camera, lidar, mask, mask)
    depth = sparse_depth_map(SOUND.points, SOUND.calibration, SIZE)
    everywhere = np.ones(SIZE, dtype=bool)
    for gate, seen, known in (
        (camera, found["camera"], everywhere),
        (lidar, found["lidar"], (depth > 0).numpy()),
    ):
        expected = reference.split(gate.tolist(), mask.tolist(), known.tolist())
        for group, gates in zip((seen.masked, seen.clear), expected, strict=True):
            counts = np.bincount([level(each) for each in gates], minlength=NUM_LEVELS)
            assert np.abs(np.cumsum(group.counts - counts)).max() <= 1  # a level's edge is float's
            assert group.num_cells == len(gates)
            assert group.total == pytest.approx(sum(gates))
        assert seen.means == pytest.approx([gate.double().mean().item()])


def test_a_record_is_read_as_it_was_written(tmp_path):
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[:, :12] = True
    record = record_of(torch.rand(3, 4), torch.rand(3, 4), mask, ~mask)
    write_gate_record(tmp_path / "0.json", record)
    again = read_gate_record(tmp_path / "0.json")
    for sensor in ("camera", "lidar"):
        before, after = record[sensor], again[sensor]
        assert before.means == after.means
        for group in ("masked", "clear"):
            assert getattr(before, group).total == getattr(after, group).total
            np.testing.assert_array_equal(
                getattr(before, group).counts, getattr(after, group).counts
            )


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"camera": 1, "lidar": 1}', '{"camera": {"mean": "x"}}', "[" * 9999]
)
def test_a_damaged_record_is_refused_by_name(tmp_path, text):
    (tmp_path / "0.json").write_text(text)
    with pytest.raises(ValueError, match=r"0\.json: is no record of gates; remove it and run"):
        read_gate_record(tmp_path / "0.json")


def test_a_record_of_a_level_that_there_is_not_is_refused(tmp_path):
    mask = torch.zeros(SIZE, dtype=torch.bool)
    write_gate_record(
        tmp_path / "0.json", record_of(torch.rand(3, 4), torch.rand(3, 4), mask, mask)
    )
    plain = json.loads((tmp_path / "0.json").read_text())
    for counts in ([[NUM_LEVELS, 1]], [[-1, 1]], [[0, -1]], [[0.5, 1]], [1], [[0, "many"]]):
        plain["camera"]["clear"]["counts"] = counts
        (tmp_path / "0.json").write_text(json.dumps(plain))
        with pytest.raises(ValueError, match="is no record of gates"):
            read_gate_record(tmp_path / "0.json")


@pytest.mark.parametrize("forged", [float("nan"), 1e300, 10**400, -0.1, "0.5", None, [[]]])
@pytest.mark.parametrize("place", ["mean", "total"])
def test_a_record_of_gates_that_no_map_can_have_is_refused(tmp_path, place, forged):
    mask = torch.zeros(SIZE, dtype=torch.bool)
    write_gate_record(
        tmp_path / "0.json", record_of(torch.rand(3, 4), torch.rand(3, 4), mask, mask)
    )
    plain = json.loads((tmp_path / "0.json").read_text())
    (plain["camera"] if place == "mean" else plain["camera"]["clear"])[place] = forged
    (tmp_path / "0.json").write_text(json.dumps(plain))
    with pytest.raises(ValueError, match="is no record of gates"):
        read_gate_record(tmp_path / "0.json")


def test_an_answer_without_gates_is_refused():
    mask = torch.zeros(SIZE, dtype=torch.bool)
    with pytest.raises(ValueError, match="no gates to measure in sample 000000; name"):
        record_of(None, None, mask, mask)


def test_a_gate_that_closes_where_its_sensor_is_broken_is_perfect_and_one_that_opens_the_worst():
    mask = torch.zeros(SIZE, dtype=torch.bool)
    mask[:, 18:] = True
    nowhere = torch.zeros_like(mask)
    noise = torch.linspace(0, 0.1, 24).reshape(4, 6)
    closing, still = 0.8 + noise, 0.5 + noise
    closing[:, 3:] -= 0.7
    clean = pool_gates([record_of(0.8 + noise, still, nowhere, nowhere)])
    scored = score_gates("box", pool_gates([record_of(closing, still, mask, nowhere)]), clean)
    assert scored.scores["camera"].auroc_cells == scored.scores["camera"].auroc_clean_cells == 1
    assert scored.scores["camera"].auroc_frames == 1
    assert scored.scores["camera"].masked_mean == pytest.approx(float(closing[:, 3:].mean()))
    assert scored.scores["camera"].clear_mean == pytest.approx(float(closing[:, :3].mean()))
    assert scored.scores["lidar"].auroc_cells is scored.scores["lidar"].auroc_frames is None
    assert scored.scores["lidar"].masked_mean is None
    opening = score_gates("box", pool_gates([record_of(1 - closing, still, mask, nowhere)]), clean)
    assert opening.scores["camera"].auroc_cells == 0


def test_gates_next_to_0_and_to_1_are_told_apart():
    nowhere = torch.zeros(SIZE, dtype=torch.bool)
    mask = nowhere.clone()
    mask[:12] = True
    for low, high in ((1e-5, 2e-5), (0.9998, 0.9999)):
        gate = torch.tensor([[low], [high]])
        scored = pool_gates([record_of(gate, gate, mask, nowhere)])
        assert score_gates("box", scored, scored).scores["camera"].auroc_cells == 1


def test_a_blank_sensor_has_no_other_cells_and_is_compared_with_clean_frames():
    (case,) = find_suite("dgfn7").select(["lidar_blank"])
    dead = case.corrupt(SOUND)
    gate = torch.full((3, 4), 0.25)
    record = measure_gates(make_result(1 - gate, gate), SOUND, dead)
    clean = measure_gates(
        make_result(1 - gate, 1 - gate), SOUND, replace(dead, lidar_mask=~dead.lidar_mask)
    )
    scored = score_gates("lidar_blank", pool_gates([record]), pool_gates([clean])).scores["lidar"]
    assert scored.auroc_cells is scored.clear_mean is None
    assert (scored.auroc_clean_cells, scored.auroc_frames) == (1, 1)
    assert scored.mean == scored.masked_mean == 0.25
