import json
import statistics

import pytest
from rich.console import Console

from sightline.data.kitti_depth import KittiDepthDataset
from sightline.data.open import open_dataset
from sightline.depth_completion import reproduce as module
from sightline.depth_completion.predictor import DepthCompleter, DepthPredictor
from sightline.depth_completion.reproduce import measure_sparsity, reproduce_shiftconv
from sightline.evaluation.depth_scores import score_depth
from sightline.evaluation.held_out import evaluate_held_out
from sightline.geometry.projection import sparse_depth_map
from sightline.simulation.packaged import PACKAGED_FRAMES
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


def row(report, start):
    """Cells of the table's first row that starts so, without empty ones."""
    line = next(line for line in text(report).splitlines() if line.strip("│ ").startswith(start))
    return [cell.strip() for cell in line.split("│") if cell.strip()]


def test_published_figures_are_quoted(selection):
    said = text(reproduce_shiftconv(selection))
    for figure in ("6.52%", "1,019.64", "1,109.04", "1,206.66", "1,102.11", "1,206.93"):
        assert figure in said


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
    report = reproduce_shiftconv(selection, weights=weights, weights_without=weights_without)
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
    assert row(report, "with, ours") == ["with, ours", f"{report.with_shift_conv.rmse_mm:,.2f}"]
    assert "needs" not in text(report)


def test_fewer_frames_are_not_called_the_benchmark(selection, weights):
    report = reproduce_shiftconv(selection, weights=weights)
    assert report.protocol == "ground truth"
    assert "ground truth, 2 frames" in text(report)
    assert row(report, "with, ours") == [
        "with, ours",
        "needs KITTI's val_selection_cropped",
        f"{report.with_shift_conv.rmse_mm:,.2f}",
    ]


def test_other_data_is_scored_on_held_out_rings(weights):
    report = reproduce_shiftconv(PACKAGED_FRAMES, weights=weights, sample_list=["000001"])
    assert (report.protocol, report.frames) == ("held-out rings", 1)
    sample = open_dataset(PACKAGED_FRAMES, sample_list=["000001"])[0]
    expected = evaluate_held_out([sample], DepthPredictor.load(weights), beams=(64,))
    assert report.with_shift_conv.rmse_mm == pytest.approx(expected.scores[0].rmse_mm)
    assert "held-out rings, 1 frames" in text(report)


@pytest.mark.usefixtures("as_official")
def test_what_was_not_measured_says_what_it_needs(selection):
    report = reproduce_shiftconv(selection)
    assert "sightline fit --config depth-shiftconv-kitti" in row(report, "with, ours")[1]
    assert "--weights-without" in row(report, "without, ours")[1]
    saved = json.loads(json.dumps(report.to_json()))
    assert saved["table_2"]["shift_conv"] is None
    assert saved["table_3"]["with"] is saved["table_3"]["without"] is None


def test_the_file_for_scripts_says_whether_figures_compare(selection, weights, monkeypatch):
    saved = reproduce_shiftconv(selection, weights=weights).to_json()
    assert saved["comparable_with_published"] is False
    assert saved["table_3"]["with"]["name"] == "spread"
    monkeypatch.setattr(module, "_BENCHMARK_FRAMES", 2)
    assert reproduce_shiftconv(selection).to_json()["comparable_with_published"] is True


def test_weights_given_as_what_they_are_not_are_refused(selection, weights, weights_without):
    with pytest.raises(ValueError, match="plain is a network without Shift-Conv, expected one"):
        reproduce_shiftconv(selection, weights=weights_without)
    with pytest.raises(
        ValueError, match="spread is a network with Shift-Conv, expected one without"
    ):
        reproduce_shiftconv(selection, weights_without=weights)
