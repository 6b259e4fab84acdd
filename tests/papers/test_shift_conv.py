import json
import statistics
from dataclasses import replace

import numpy as np
import pytest
import torch
from rich.console import Console

from sightline.augmentation.sample_changes import crop
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.formats.image_file import read_rgb
from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import DepthCompleter, DepthPredictor
from sightline.evaluation.depth_scores import score_depth
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import split_rings
from sightline.geometry.projection import sparse_depth_map
from sightline.papers import shift_conv as module
from sightline.papers.shift_conv import FIGURES, measure_sparsity, reproduce_shift_conv
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.visualization.lettering import with_title
from tests.data.trees import write_selection
from tests.depth_completion.networks import write_tiny_weights


@pytest.fixture
def selection(tmp_path):
    """Two frames in the layout of KITTI's selection."""
    for number, seed in (("0000000005", 0), ("0000000008", 1)):
        write_selection(tmp_path, number, seed)
    return tmp_path


@pytest.fixture
def as_official(monkeypatch):
    """Lets two frames pass for the benchmark's thousand."""
    monkeypatch.setattr(module, "_BENCHMARK_FRAMES", 2)


@pytest.fixture
def weights(tmp_path):
    return write_tiny_weights(tmp_path / "spread.safetensors")


@pytest.fixture
def weights_without(tmp_path):
    return write_tiny_weights(tmp_path / "plain.safetensors", shift_conv=None)


def text(report):
    console = Console(width=200)
    with console.capture() as captured:
        console.print(report.table())
    return captured.get()


def rows(report, start):
    """Lines of the tables that start so."""
    return [line for line in text(report).splitlines() if line.strip().startswith(start)]


def as_papers(measured):
    return replace(measured, network=replace(measured.network, departures=()))


def test_published_figures_are_quoted(selection):
    printed = text(reproduce_shift_conv(selection))
    for figure in ("6.52%", "1,019.64", "1,109.04", "1,206.66", "1,102.11", "1,206.93"):
        assert figure in printed


def test_sparsity_is_the_mean_number_of_measured_pixels(selection):
    dataset = open_dataset(selection)
    samples = [dataset[0], dataset[1]]
    maps = [sparse_depth_map(each.points, each.calibration, each.image_size) for each in samples]
    whole, _ = measure_sparsity(dataset)
    assert whole.measured_pixels == statistics.fmean(int((each > 0).sum()) for each in maps)
    assert whole.measured_pixels + whole.empty_pixels == maps[0].numel()


def test_sparsity_of_the_papers_crop_is_that_of_the_images_bottom_centre():
    dataset = open_dataset(PACKAGED_FRAMES, sample_list=["000000"])
    sample = dataset[0]
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    height, width = sample.image_size
    left = (width - 1216) // 2
    _, crop = measure_sparsity(dataset)
    assert crop.measured_pixels == int((sparse[height - 256 :, left : left + 1216] > 0).sum())
    assert crop.measured_pixels + crop.empty_pixels == 256 * 1216


@pytest.mark.usefixtures("as_official")
def test_the_official_frames_give_the_benchmarks_figure(selection, weights, weights_without):
    report = reproduce_shift_conv(selection, weights=weights, weights_without=weights_without)
    assert report.protocol == "benchmark"
    dataset = KittiDepthDataset(selection)
    for measured, completer in (
        (report.classical, DepthCompleter("adaptive")),
        (report.with_shift_conv, DepthPredictor.load(weights)),
        (report.without_shift_conv, DepthPredictor.load(weights_without)),
    ):
        errors_mm = [
            score_depth(completer(sample).depth_m.numpy(), sample.depth.numpy()).rmse_mm
            for sample in (dataset[0], dataset[1])
        ]
        assert measured.rmse_mm == pytest.approx(statistics.fmean(errors_mm))
        assert measured.seconds > 0
    figure = f"{report.with_shift_conv.paper_rmse_mm:,.2f}"
    papers_row, other_row = rows(report, "with, ours")
    assert "needs --weights" in papers_row
    assert figure not in papers_row
    assert "not the paper's: spread: with Shift-Conv" in other_row
    assert figure in other_row
    assert "Not the paper's network: spread (shift_conv.channels 9, " in text(report)
    report = replace(
        report,
        with_shift_conv=as_papers(report.with_shift_conv),
        without_shift_conv=as_papers(report.without_shift_conv),
    )
    (papers_row,) = rows(report, "with, ours")
    assert figure in papers_row
    assert "needs" not in text(report)


def test_fewer_frames_are_not_called_the_benchmark(selection, weights):
    report = reproduce_shift_conv(selection, weights=weights)
    assert report.protocol == "ground truth"
    assert "ground truth, 2 frames" in text(report)
    line = rows(report, "with, ours")[1]
    assert "needs KITTI's val_selection_cropped" in line
    assert f"{report.with_shift_conv.rmse_mm:,.2f}" in line


def test_other_data_is_scored_on_held_out_rings(weights):
    report = reproduce_shift_conv(PACKAGED_FRAMES, weights=weights, sample_list=["000001"])
    assert (report.protocol, report.frames) == ("held-out rings", 1)
    sample = open_dataset(PACKAGED_FRAMES, sample_list=["000001"])[0]
    expected = evaluate_held_out([sample], DepthPredictor.load(weights), beams=(64,))
    assert report.with_shift_conv.rmse_mm == pytest.approx(expected.scores[0].rmse_mm)
    assert "held-out rings, 1 frames" in text(report)


def test_held_out_rings_of_the_papers_crop_are_those_of_the_whole_frame(weights, monkeypatch):
    size = (64, 96)  # smaller than the paper's: truth lies outside
    monkeypatch.setattr(module, "_PAPER_CROP", size)
    report = reproduce_shift_conv(PACKAGED_FRAMES, weights=weights, sample_list=["000001"])
    sample = open_dataset(PACKAGED_FRAMES, sample_list=["000001"])[0]
    whole = replace(sample, points=split_rings(sample).sample.points)
    left = (sample.image_size[1] - 96) // 2
    given = crop(whole, sample.image_size[0] - 64, left, *size)
    frame = split_rings(sample, crop_size=size)
    assert torch.equal(frame.truth_m, split_rings(sample).truth_m[-64:, 560:656])
    truth_m = frame.truth_m.numpy()
    errors_m = (DepthPredictor.load(weights)(given).depth_m.numpy() - truth_m)[truth_m > 0]
    expected_mm = 1e3 * np.sqrt(np.mean(errors_m.astype(np.float64) ** 2))
    assert report.with_shift_conv.paper_rmse_mm == pytest.approx(expected_mm, rel=1e-5)
    assert report.with_shift_conv.paper_rmse_mm != report.with_shift_conv.rmse_mm


def test_ground_truth_of_the_papers_crop_is_that_of_the_bottom_centre(
    selection, weights, monkeypatch
):
    size = (8, 24)  # of frames of 12x40
    monkeypatch.setattr(module, "_PAPER_CROP", size)
    report = reproduce_shift_conv(selection, weights=weights)
    dataset, errors_mm = open_dataset(selection, parts=("image", "points")), []
    for sample in (dataset[0], dataset[1]):
        height, width = sample.image_size
        given = crop(sample, height - 8, (width - 24) // 2, *size)
        depth_m = DepthPredictor.load(weights)(given).depth_m.numpy()
        errors_mm.append(score_depth(depth_m, given.depth.numpy()).rmse_mm)
    assert report.with_shift_conv.paper_rmse_mm == pytest.approx(statistics.fmean(errors_mm))
    assert report.with_shift_conv.paper_rmse_mm != report.with_shift_conv.rmse_mm


@pytest.mark.usefixtures("as_official")
def test_what_was_not_measured_says_what_it_needs(selection):
    report = reproduce_shift_conv(selection)
    assert "needs --weights WEIGHTS" in rows(report, "with, ours")[0]
    assert "needs --weights-without WEIGHTS" in rows(report, "without, ours")[0]
    assert text(report).rstrip().splitlines()[-1] == (
        "Not measured: the paper's networks (recipes depth-shiftconv-kitti, "
        "depth-without-shiftconv-kitti), without --weights --weights-without."
    )
    saved = json.loads(json.dumps(report.to_json()))
    assert saved["table_2"]["shift_conv"] is None
    assert saved["table_3"]["with"] is saved["table_3"]["without"] is None


def test_the_file_for_scripts_says_whether_figures_compare(selection, weights, monkeypatch):
    saved = reproduce_shift_conv(selection, weights=weights).to_json()
    assert saved["comparable_with_published"] is False
    assert saved["table_3"]["with"]["name"] == "spread"
    monkeypatch.setattr(module, "_BENCHMARK_FRAMES", 2)
    assert reproduce_shift_conv(selection).to_json()["comparable_with_published"] is True


def test_without_data_the_published_figures_stand_alone():
    report = reproduce_shift_conv()
    assert "1,102.11" in text(report)
    assert "Not measured: ours, without --data and weights." in text(report)
    assert report.to_json()["comparable_with_published"] is False


def test_the_figure_shows_the_papers_maps_of_a_frame(selection, weights, tmp_path):
    def height(folder, **settings):
        reproduce_shift_conv(selection, figures=folder, **settings)
        return read_rgb(folder / FIGURES).shape[0]

    size = KittiDepthDataset(selection)[0].image_size
    one_map = with_title(np.zeros((min(size[0], 256), 9, 3), np.uint8), "").shape[0]
    assert height(tmp_path / "plain") == 4 * one_map  # image, sweep, truth, expanded truth
    assert height(tmp_path / "network", weights=weights) == 6 * one_map
    with pytest.raises(ValueError, match="frame nowhere to draw is not among the 2 frames"):
        height(tmp_path / "none", figure_frame="nowhere")


def test_weights_given_as_what_they_are_not_are_refused(selection, weights, weights_without):
    with pytest.raises(ValueError, match="plain is a network without Shift-Conv, expected one"):
        reproduce_shift_conv(selection, weights=weights_without)
    with pytest.raises(
        ValueError, match="spread is a network with Shift-Conv, expected one without"
    ):
        reproduce_shift_conv(selection, weights_without=weights)
