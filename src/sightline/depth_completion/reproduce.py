"""Tables of the Shift-Convolution paper with its own figures and ours.

Yu and Kee 2021, "3D LiDAR Depth Completion Based on Shift-Convolution Using Adjacent Pixel
Information": Table 1 (sparsity of the input), Table 2 (benchmark), Table 3 (ablation). Published
figures are quoted, ours are measured on the given data; a cell without a measurement names its
requirements.
"""

import statistics
import time
from collections.abc import Sequence
from pathlib import Path

from sightline.data.kitti_depth import KittiDepthDataset
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import NamedSubset, SampleDataset, open_dataset
from sightline.depth_completion.predictor import (
    Completer,
    DepthCompleter,
    DepthPredictor,
)
from sightline.depth_completion.reproduce_report import (
    Measured,
    Protocol,
    ShiftConvReport,
    Sparsity,
)
from sightline.evaluation.depth_scores import score_depth
from sightline.evaluation.held_out import evaluate_held_out
from sightline.export.names import EngineChoice
from sightline.geometry.projection import sparse_depth_map
from sightline.jobs.progress import track

_BENCHMARK_FRAMES = 1000
_BEAMS = 64
_PAPER_CROP = (256, 1216)  # height, width of all frames in the paper


def reproduce_shiftconv(
    data: Path,
    *,
    weights: str | Path | None = None,
    weights_without: str | Path | None = None,
    engine: EngineChoice = "torch",
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
) -> ShiftConvReport:
    """Measures the figures of the paper's tables on the given data.

    A depth completion tree is scored against its ground truth by KITTI's rules; only the 1,000
    frames of `val_selection_cropped` give the benchmark's figure. Other data is scored on held-out
    rings (`sightline.evaluation.held_out`) with 64 beams.

    Args:
        data: Folder of the data set; see `open_dataset`.
        weights: Weights of the paper's network; see `load_network`. None: its cells stay open.
        weights_without: Weights of the same network trained without Shift-Conv.
        engine: Engine that runs the networks.
        device: Device that runs the networks.
        sample_list: List of the samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Raises:
        ValueError: The data cannot be read or scored, `weights` is without or `weights_without`
            with Shift-Conv.
    """
    with_, without = (
        None if file is None else DepthPredictor.load(file, engine=engine, device=device)
        for file in (weights, weights_without)
    )
    for predictor, wanted in ((with_, True), (without, False)):
        if predictor is not None and predictor.has_shift_conv != wanted:
            raise ValueError(
                f"{predictor.name} is a network {'without' if wanted else 'with'} Shift-Conv, "
                f"expected one {'with' if wanted else 'without'}; give --weights the one and "
                "--weights-without the other"
            )
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=("image", "points")
    )
    protocol = _protocol(dataset)
    return ShiftConvReport(
        data=str(data),
        protocol=protocol,
        frames=len(dataset),
        sparsity=measure_sparsity(dataset),
        classical=_measure(dataset, DepthCompleter("adaptive"), protocol),
        with_shift_conv=None if with_ is None else _measure(dataset, with_, protocol),
        without_shift_conv=None if without is None else _measure(dataset, without, protocol),
    )


def measure_sparsity(dataset: SampleDataset) -> tuple[Sparsity, Sparsity]:
    """Count the pixels with a measurement, as the mean over the frames.

    Returns:
        Sparsity of whole images and of their bottom-centre crops to 1216x256, the paper's size; a
        smaller image is kept whole.

    Raises:
        ValueError: A sample has no sweep.
    """
    whole: list[tuple[int, int]] = []  # pixels with a measurement, all pixels
    cropped: list[tuple[int, int]] = []
    indices = track(range(len(dataset)), description="counting pixels", total=len(dataset))
    for sample in (dataset[index] for index in indices):
        if sample.points is None:
            raise ValueError(f"sample {sample.sample_id} has no sweep to count; leave it out")
        is_measured = sparse_depth_map(sample.points, sample.calibration, sample.image_size) > 0
        height, width = (min(*pair) for pair in zip(sample.image_size, _PAPER_CROP, strict=True))
        left = (sample.image_size[1] - width) // 2
        crop = is_measured[sample.image_size[0] - height :, left : left + width]
        for counts, pixels in ((whole, is_measured), (cropped, crop)):
            counts.append((int(pixels.sum()), pixels.numel()))
    return _mean_sparsity(whole), _mean_sparsity(cropped)


def _mean_sparsity(counts: Sequence[tuple[int, int]]) -> Sparsity:
    measured = statistics.fmean(number for number, _ in counts)
    return Sparsity(
        measured_pixels=measured,
        empty_pixels=statistics.fmean(total for _, total in counts) - measured,
    )


def _protocol(dataset: SampleDataset) -> Protocol:
    source = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if not isinstance(source, KittiDepthDataset):
        return "held-out rings"
    is_selection = source.split == "val_selection_cropped"
    return "benchmark" if is_selection and len(dataset) == _BENCHMARK_FRAMES else "ground truth"


def _measure(dataset: SampleDataset, completer: Completer, protocol: Protocol) -> Measured:
    samples = (dataset[index] for index in range(len(dataset)))
    if protocol == "held-out rings":
        report = evaluate_held_out(samples, completer, beams=(_BEAMS,), total=len(dataset))
        score = report.scores[0]
        return Measured(
            name=completer.name, rmse_mm=score.rmse_mm, seconds=score.milliseconds / 1e3
        )
    errors_mm, seconds = [], []
    for sample in track(samples, description="scoring", total=len(dataset)):
        if sample.depth is None:
            raise ValueError(
                f"sample {sample.sample_id} has no ground truth to score against; give the tree "
                "with val_selection_cropped"
            )
        start = time.perf_counter()
        depth_m = completer(sample).depth_m.cpu().numpy()
        seconds.append(time.perf_counter() - start)
        errors_mm.append(score_depth(depth_m, sample.depth.numpy()).rmse_mm)
    return Measured(
        name=completer.name,
        rmse_mm=statistics.fmean(errors_mm),
        seconds=statistics.median(seconds),
    )
