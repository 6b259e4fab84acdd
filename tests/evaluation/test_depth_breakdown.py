import io
import math
import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from sightline.data.formats.map_png import write_depth_png
from sightline.evaluation.depth import evaluate_depth
from sightline.evaluation.depth_breakdown import (
    bands,
    error_sums,
    lost_returns,
    paired_difference,
)
from tests.reference import depth_breakdown as reference

ENDS = (10.0, 20.0, 40.0)


def images(seed):
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 9)), int(rng.integers(1, 12)))
    truth = rng.uniform(1, 60, shape) * (rng.random(shape) < 0.7)
    prediction = rng.uniform(0.5, 60, shape)
    near = rng.random(shape) < 0.5
    prediction[near] = (truth + rng.normal(0, 1.5, shape))[near].clip(0.5)
    sparse = np.where(rng.random(shape) < 0.3, truth + rng.normal(0, 0.3, shape), 0).clip(0)
    return prediction, truth, sparse


@given(st.integers(0, 2**31), st.integers(1, 3))
def test_bands_and_places_pool_all_pixels_as_loops_over_them_say(seed, count):
    frames = [images(seed + index) for index in range(count)]
    sums = error_sums(*frames[0][:2], band_ends_m=ENDS, sparse_m=frames[0][2])
    for prediction, truth, sparse in frames[1:]:
        sums = sums + error_sums(prediction, truth, band_ends_m=ENDS, sparse_m=sparse)
    expected = reference.breakdown(frames, ENDS)
    for band in bands(sums, ENDS, places=True):
        row = expected[band.name]
        assert band.pixels == row["pixels"]
        if band.pixels:
            for name in ("rmse_mm", "mae_mm", "bias_mm", "nearer_share", "farther_share"):
                assert getattr(band, name) == pytest.approx(row[name], rel=1e-9, abs=1e-9)
        else:
            assert math.isnan(band.mae_mm)
    lost = lost_returns(sums)
    sound, gone, far, far_gone = reference.lost_returns(frames)
    assert (lost.sound, lost.sound_beyond_40m) == (sound, far)
    assert lost.lost_share == pytest.approx(gone / sound if sound else math.nan, nan_ok=True)
    share = far_gone / far if far else math.nan
    assert lost.lost_share_beyond_40m == pytest.approx(share, nan_ok=True)


def test_a_paired_interval_holds_the_mean_and_narrows_to_it_where_all_images_agree():
    same = paired_difference(
        "RMSE", [float(n) for n in range(3, 13)], [float(n) for n in range(1, 11)]
    )
    assert (same.mean, same.low, same.high, same.better, same.images) == (2.0, 2.0, 2.0, 0, 10)
    few = paired_difference(
        "RMSE", [float(n) for n in range(3, 12)], [float(n) for n in range(1, 10)]
    )
    assert (few.mean, few.low, few.high) == (2.0, None, None)
    rng = np.random.default_rng(0)
    ours, theirs = rng.normal(0, 1, 400), rng.normal(0.5, 1, 400)
    pair = (ours.tolist(), theirs.tolist())
    wide = paired_difference("RMSE", *pair, resamples=4000)
    error = np.std(ours - theirs, ddof=1) / np.sqrt(400)
    assert wide.low == pytest.approx(wide.mean - 1.96 * error, abs=0.15 * error)
    assert wide.high == pytest.approx(wide.mean + 1.96 * error, abs=0.15 * error)
    assert wide == paired_difference("RMSE", *pair, resamples=4000)


@pytest.fixture
def folders(tmp_path):
    rng = np.random.default_rng(3)
    for index in range(3):
        truth = rng.uniform(2, 60, (8, 20)).astype(np.float32)
        sparse = np.where(rng.random(truth.shape) < 0.2, truth, np.float32(0))
        for name, depth in (
            ("truth", truth),
            ("sparse", sparse),
            ("exact", truth),
            ("near", truth * np.float32(0.9)),
        ):
            (tmp_path / name).mkdir(exist_ok=True)
            write_depth_png(tmp_path / name / f"{index}.png", depth)
    return tmp_path


@pytest.mark.filterwarnings("ignore:.* they are copies")
def test_a_report_holds_bands_returns_and_the_difference_to_another_method(folders):
    report = evaluate_depth(
        folders / "near",
        folders / "truth",
        band_ends_m=(20.0, 50.0),
        sparse=folders / "sparse",
        against=folders / "exact",
        progress=False,
    )
    content = report.to_json()
    assert [band["name"] for band in content["bands"]] == [
        *("0-20 m", "20-50 m", "50 m on"),
        *("measured", "between", "beyond"),
    ]
    near, far, beyond = content["bands"][:3]
    assert beyond["pixels"] > 0
    assert near["bias_mm"] == pytest.approx(-near["mae_mm"])
    assert far["nearer_share"] == 1.0
    assert near["pixels"] + far["pixels"] + beyond["pixels"] == 3 * 8 * 20
    assert content["returns"][0]["lost_share_beyond_40m"] == 1.0
    by_score = {row["score"]: row for row in content["against"]}
    assert by_score["MAE"]["mean"] == pytest.approx(report.mean.mae_mm)
    assert by_score["RMSE"]["better"] == 0
    assert by_score["RMSE"]["low"] is None
    with Console(width=100, record=True, file=io.StringIO()) as console:
        console.print(report.table())
    assert "at least 10 images, got 3" in console.export_text()


@pytest.mark.parametrize("against", ["near", "copy"])
def test_a_method_that_is_compared_with_itself_is_told(folders, against):
    shutil.copytree(folders / "near", folders / "copy")
    with pytest.warns(UserWarning, match="same scores in all 3 images, so every difference is 0"):
        evaluate_depth(
            folders / "near", folders / "truth", against=folders / against, progress=False
        )


@pytest.mark.parametrize("ends", [(20.0, 10.0), (0.0, 10.0), (math.inf,), (math.nan,)])
def test_bands_that_do_not_ascend_are_refused(folders, ends):
    with pytest.raises(ValueError, match="ascending"):
        evaluate_depth(folders / "near", folders / "truth", band_ends_m=ends, progress=False)


def test_sparse_maps_that_lack_an_image_are_named(folders):
    (folders / "sparse" / "1.png").unlink()
    with pytest.raises(ValueError, match=r"sparse lacks maps for 1 of the 3"):
        evaluate_depth(
            folders / "near", folders / "truth", sparse=folders / "sparse", progress=False
        )


def test_sweeps_in_place_of_sparse_maps_are_told_as_such(folders):
    sweeps = folders / "velodyne"
    sweeps.mkdir()
    (sweeps / "0.bin").write_bytes(b"")
    with pytest.raises(ValueError, match=r"holds 1 \.bin files, which are sweeps, .* depth PNGs"):
        evaluate_depth(folders / "near", folders / "truth", sparse=sweeps, progress=False)


def test_a_negative_seed_is_refused_however_few_images_there_are(folders):
    with pytest.raises(ValueError, match="seed must not be negative, got -1"):
        evaluate_depth(folders / "near", folders / "truth", seed=-1, progress=False)
