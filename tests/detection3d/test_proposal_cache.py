"""Stored first-stage outputs: equal to the stage's own, and refused where they are not."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.cli.main import main
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_conversion import kitti_from_detections
from sightline.data.formats.kitti_labels import read_results
from sightline.data.open import open_dataset
from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.examples import Detection3DExampleConfig, Detection3DExamples
from sightline.detection3d.points.config import ProposalConfig, ProposalSamplingConfig
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.detection3d.proposal_cache import first_stage_identity, read_record
from sightline.detection3d.task import Detection3D
from sightline.geometry.tilt import Tilt
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import (
    IMAGE,
    POINTS,
    write_calibration,
    write_cloud_file,
    write_recording,
)
from tests.detection3d.frames import NAMES, SWEEP, TINY, simulated_frames, write_network

LOSS = Detection3DLossConfig(sampling=ProposalSamplingConfig(num_samples=16, max_foreground=8))
SETTINGS = Detection3DExampleConfig(input=SWEEP, class_names=NAMES, changes=None)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    write_network(path)
    return path


def run(weights, out, *more, data=PACKAGED_FRAMES):
    command = ["proposals", str(data), str(out), "--weights", str(weights)]
    return main([*command, "--workers", "1", *more])


@pytest.fixture(scope="module")
def cache(weights, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cache") / "proposals"
    assert run(weights, folder) == 0
    return folder


@pytest.fixture(scope="module")
def frames():
    return simulated_frames()


def example(sample, cache, *, training):
    examples = Detection3DExamples(SETTINGS, cache=cache)
    return examples.prepare(sample, np.random.default_rng(0), training=training)


def test_a_frames_file_holds_what_the_first_stage_gives(weights, cache, frames):
    predictor = Detection3DPredictor.load(weights)
    points, record, _ = read_record(cache, frames[0], training=False)
    proposed = predictor._stages.propose(points)
    assert points.shape == (SWEEP.num_points, 4)
    torch.testing.assert_close(record.boxes, proposed.boxes)
    torch.testing.assert_close(record.scores, proposed.scores)
    torch.testing.assert_close(record.features.float(), proposed.features, rtol=1e-3, atol=1e-3)
    _, more, _ = read_record(cache, frames[0], training=True)
    assert len(record.boxes) <= TINY.proposals.num_proposals < len(more.boxes)


def test_result_files_hold_every_proposal_in_the_image(weights, frames, tmp_path, capsys):
    assert run(weights, tmp_path / "found", "--as-results") == 0
    predictor = Detection3DPredictor.load(weights)
    for sample in frames:
        proposed, refined = predictor.both_stages(sample)
        expected = kitti_from_detections(proposed, sample.calibration, sample.image_size)
        content = read_results(tmp_path / "found" / f"{sample.sample_id}.txt")
        assert content.class_names == expected.class_names
        np.testing.assert_allclose(content.scores, expected.scores, atol=1e-4)
        np.testing.assert_allclose(content.locations, expected.locations, atol=0.01)
        assert len(content) != len(refined.scores)
    labels = PACKAGED_FRAMES / "training" / "label_2"
    assert main(["evaluate", "proposals", str(tmp_path / "found"), str(labels)]) == 0
    main(
        [
            "predict",
            "detection3d",
            str(PACKAGED_FRAMES),
            str(tmp_path / "found"),
            "--weights",
            str(weights),
            "--engine",
            "torch",
            "--overwrite",
        ]
    )
    assert "stage" in capsys.readouterr().err


def test_scores_by_the_cache_are_those_by_the_first_stage_itself(weights, cache, frames):
    task = Detection3D(TINY, stages="second", initial_weights=weights)
    task.network.eval()
    predictor = Detection3DPredictor.load(weights)
    with torch.inference_mode():
        detections = task.score(example(frames[0], cache, training=False))
    expected = predictor(frames[0])
    assert len(detections[0].scores) == pytest.approx(len(expected.scores), abs=1)
    torch.testing.assert_close(detections[0].scores[0], expected.scores[0], atol=1e-3, rtol=0)


def test_a_second_stage_trains_on_it(weights, cache, frames):
    task = Detection3D(TINY, loss=LOSS, stages="second", initial_weights=weights)
    losses = task.losses(example(frames[0], cache, training=True))
    losses.total.backward()
    assert float(losses.terms["second/confidence"].detach()) > 0
    assert any(each.grad.abs().sum() > 0 for each in task.network.refinement.parameters())


def test_all_zero_proposals_are_dropped(weights, cache, frames):
    batch = example(frames[0], cache, training=True)
    record = batch.records[0]
    filled = replace(
        record,
        boxes=torch.cat((record.boxes, torch.zeros(5, 7))),
        classes=torch.cat((record.classes, torch.zeros(5, dtype=torch.int64))),
        scores=torch.cat((record.scores, torch.zeros(5))),
    )
    task = Detection3D(TINY, loss=LOSS, stages="second", initial_weights=weights)
    both = [task.losses(replace(batch, records=(each,))).total for each in (record, filled)]
    torch.testing.assert_close(both[0], both[1])


def test_a_stopped_job_is_finished_and_a_finished_one_left_alone(weights, cache, capsys):
    kept = (cache / "000000.safetensors").read_bytes()
    (cache / "000001.safetensors").unlink()
    assert run(weights, cache) == 0
    assert "frames: 1 written, 1 there already" in capsys.readouterr().out
    assert (cache / "000000.safetensors").read_bytes() == kept
    assert (cache / "000001.safetensors").is_file()


def test_a_cache_of_other_weights_settings_or_data_is_refused(
    weights, cache, frames, tmp_path, capsys
):
    write_network(tmp_path / "other.safetensors", seed=1)
    assert run(tmp_path / "other.safetensors", cache) == 2
    assert "first_stage" in capsys.readouterr().err
    batch = example(frames[0], cache, training=True)
    other = Detection3D(TINY, stages="second", initial_weights=tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="by a first stage of other weights or settings"):
        other.losses(batch)
    fewer = replace(TINY, proposals=ProposalConfig(num_proposals=9, num_candidates=200))
    changed = Detection3D(fewer, stages="second")
    with pytest.raises(ValueError, match="by a first stage of other weights or settings"):
        changed.losses(batch)
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(PACKAGED_FRAMES, elsewhere)
    sweeps = elsewhere / "training" / "velodyne"
    (sweeps / "000000.bin").write_bytes((sweeps / "000001.bin").read_bytes()[16:])
    assert run(weights, cache, data=elsewhere) == 2
    assert (
        "was made of another sweep or calibration than the data's frame" in capsys.readouterr().err
    )
    moved = frames[0].calibration.camera_from_lidar.clone()
    moved[0, 3] += 0.001
    for other in (
        replace(frames[0], points=frames[0].points + 1),
        replace(frames[0], calibration=replace(frames[0].calibration, camera_from_lidar=moved)),
        replace(frames[0], image=None, image_size=(375, 1224)),
    ):
        with pytest.raises(ValueError, match="was made of another sweep or calibration than the"):
            example(other, cache, training=True)
    trained = Detection3D(TINY, stages="both", initial_weights=weights)
    with pytest.raises(ValueError, match="set stages to second, or leave the cache out"):
        trained.losses(batch)


def rounded_otherwise(sample):
    """A sample as another processor computes it."""
    calibration = sample.calibration
    other = replace(
        calibration,
        image_from_camera=calibration.image_from_camera * (1 + 1e-14),
        camera_from_lidar=calibration.camera_from_lidar + 1e-15 * torch.eye(4)[[1, 2, 0, 0]].T,
    )
    return replace(sample, calibration=other)


def test_rounding_is_no_other_sweep(cache, frames):
    read_record(cache, rounded_otherwise(frames[0]), training=False)


@pytest.mark.parametrize(
    ("mount", "told"),
    [
        ({"lidar_height_m": 1.65}, "a LiDAR 1.90 m above the road, which the data give as 1.65 m;"),
        (
            {"lidar_tilt_deg": {"roll": 0, "pitch": 3.5}},
            "a LiDAR whose tilt the data give as another one, by 3.5 degrees",
        ),
    ],
)
def test_a_corrected_mount_is_refused(weights, tmp_path, capsys, mount, told):
    stated = {"lidar_height_m": 1.9, "lidar_tilt_deg": {"roll": 0, "pitch": 0}}
    data = write_recording(tmp_path / "recording", cloud=".npy", **stated)
    assert run(weights, tmp_path / "cache", data=data) == 0
    write_calibration(data, **stated | mount)
    assert run(weights, tmp_path / "cache", data=data) == 2
    assert f"a.safetensors: was made of {told}" in capsys.readouterr().err


def test_a_cache_goes_on_where_added_frames_change_the_estimated_mount(weights, tmp_path, capsys):
    data = write_recording(tmp_path / "data", cloud=".npy")
    assert run(weights, tmp_path / "cache", data=data) == 0
    before = open_dataset(data)[0].lidar_height_m
    for name in ("c", "d", "e"):
        write_rgb(data / "images" / f"{name}.jpg", IMAGE[:, ::-1] // (ord(name) - 97))
        lower = POINTS[: len(POINTS) - ord(name)] - np.float32([0, 0, 0.1, 0])
        write_cloud_file(data / "points" / f"{name}.npy", lower)
    sample = open_dataset(data)[0]
    assert sample.lidar_height_m == pytest.approx(before + 0.1, abs=0.02)
    assert run(weights, tmp_path / "cache", data=data) == 0
    assert "frames: 3 written, 2 there already" in capsys.readouterr().out
    assert read_record(tmp_path / "cache", sample, training=True)[2].lidar_height_m == before


def test_truth_has_the_mount_of_the_cache(cache, frames):
    tilt = torch.from_numpy(Tilt(roll_deg=0.0, pitch_deg=1.2).level_from_lidar)
    estimated = replace(frames[0], lidar_height_m=1.8, level_from_lidar=tilt)
    for training in (True, False):
        one, other = (example(each, cache, training=training) for each in (frames[0], estimated))
        assert torch.equal(one.truths[0].boxes, other.truths[0].boxes)
    with pytest.raises(
        ValueError, match=r"LiDAR 1\.73 m above the road, which the data give as 2\.00 m"
    ):
        example(replace(frames[0], lidar_height_m=2.0), cache, training=True)


def test_missing_and_damaged_files_are_refused_in_one_line(cache, frames, tmp_path):
    with pytest.raises(ValueError, match="so the cache lacks this frame; make the cache again"):
        read_record(tmp_path, frames[0], training=False)
    content = (cache / "000000.safetensors").read_bytes()
    for damaged in (content[:100], b"", content[: len(content) // 2]):
        (tmp_path / "000000.safetensors").write_bytes(damaged)
        with pytest.raises(ValueError, match="is no frame of a proposal cache") as refused:
            read_record(tmp_path, frames[0], training=False)
        assert "\n" not in str(refused.value)


def test_the_identity_hangs_on_weights_and_on_settings_of_the_first_stage_alone(tmp_path):
    network = write_network(tmp_path / "w.safetensors")
    identity = first_stage_identity(network)
    with torch.no_grad():
        next(network.refinement.parameters()).add_(1)
    assert first_stage_identity(network) == identity
    with torch.no_grad():
        next(network.points.parameters()).add_(1)
    assert first_stage_identity(network) != identity


def test_the_manifest_says_what_made_it(cache):
    manifest = json.loads((cache / "sightline.json").read_text())
    assert manifest["output"] == "proposal cache"
    assert manifest["format"] == 3
