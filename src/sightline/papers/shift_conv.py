"""Tables and figures of Yu and Kee 2021 (Shift-Convolution): published results beside ours.

"3D LiDAR Depth Completion Based on Shift-Convolution Using Adjacent Pixel Information", Table 1
(sparsity of the input), Table 2 (benchmark), Table 3 (ablation); Fig. 4, 5, 7 and 10.
"""

import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import torch

from sightline.augmentation.sample_changes import crop
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.sample_dataset import NamedSubset, SampleDataset
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.network_task import NETWORK_TASK
from sightline.depth_completion.predictor import Completer, DepthCompleter, DepthPredictor
from sightline.depth_completion.targets import expand_depth
from sightline.evaluation.depth_scores import score_depth
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import CROP_SIZE
from sightline.export.names import EngineChoice
from sightline.geometry.projection import sparse_depth_map
from sightline.inference.network import LoadedNetwork, load_network
from sightline.jobs.progress import track
from sightline.papers.rows import (
    GivenNetwork,
    add_rows,
    describe,
    find_departures,
    find_frame,
    missing_note,
    networks_note,
    new_table,
)
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.depth import colorize_depth
from sightline.visualization.image import camera_picture
from sightline.visualization.lettering import with_title

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

Protocol = Literal["benchmark", "ground truth", "held-out rings"]
"""Protocol of the RMSE. Only "benchmark", on KITTI's 1,000 selected frames, is comparable with the
paper; "ground truth" applies the same rules to other frames of a depth completion tree."""

PUBLISHED_BENCHMARK: Final = (
    ("CSPN", 1019.64, 1.0),
    ("Depth Coefficients", 1109.04, 0.1),
    ("DFuseNet", 1206.66, 0.08),
    ("Shift-Convolution", 1102.11, 0.06),
)
"""Table 2: method, RMSE [mm], run time [s] (on a TITAN Xp)."""
PUBLISHED_ABLATION: Final = {"with": 1102.11, "without": 1206.93}
"""Table 3: RMSE [mm] with and without Shift-Conv."""
FIGURES: Final = "shift_conv_frame.png"
"""File name of the picture of a frame."""

_OPTIONS: Final = {"with": "--weights", "without": "--weights-without"}
_NEEDS_FRAMES = "needs KITTI's val_selection_cropped"
_BENCHMARK_FRAMES = 1000
_BEAMS = 64
_PAPER_CROP = (256, 1216)  # height, width of all frames in the paper
_POINT_PX = 3  # drawn size of a measurement


@dataclass(frozen=True, kw_only=True, slots=True)
class Sparsity:
    """Numbers of pixels with and without a measurement, as means over the frames."""

    measured_pixels: float
    empty_pixels: float

    @property
    def measured_share(self) -> float:
        """Share of the pixels with a measurement."""
        return self.measured_pixels / (self.measured_pixels + self.empty_pixels)

    def to_json(self) -> dict[str, float]:
        """Convert to the contents of a report file."""
        return {**asdict(self), "measured_share": self.measured_share}


PUBLISHED_SPARSITY: Final = Sparsity(measured_pixels=19_984.9, empty_pixels=286_515.1)
"""Table 1: sparsity of the input."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Measured:
    """Results of one method on the given data."""

    network: GivenNetwork
    rmse_mm: float
    """Mean of the RMSEs of frames of 1216x352, as in KITTI's benchmark; smaller ones are whole."""
    paper_rmse_mm: float
    """Mean of the RMSEs of frames of 1216x256, as in the paper."""
    seconds: float
    """Median wall-clock time per frame of 1216x256 on this machine."""

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of a report file."""
        return {
            "name": self.network.name,
            "rmse_mm": self.rmse_mm,
            "rmse_mm_1216x256": self.paper_rmse_mm,
            "seconds": self.seconds,
            "is_papers": self.network.is_papers,
            "network": asdict(self.network),
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class ShiftConvReport:
    """The paper's tables with our measurements."""

    data: str | None = None
    """Data set; None: nothing was measured."""
    protocol: Protocol = "benchmark"
    frames: int = 0
    sparsity: tuple[Sparsity, Sparsity] | None = None
    """Sparsity of whole images and of the paper's crop."""
    classical: Measured | None = None
    """Best method without training, as a reference."""
    with_shift_conv: Measured | None = None
    """Result with Shift-Conv; None: no weights were given."""
    without_shift_conv: Measured | None = None

    def to_json(self) -> dict[str, object]:
        """Contents of the report file; a figure that was not measured is None."""
        whole, crop = (None, None) if self.sparsity is None else self.sparsity
        results = {
            name: None if row is None else row.to_json() for name, row in self._results.items()
        }
        return {
            "data": self.data,
            "frames": self.frames,
            "protocol": self.protocol,
            "comparable_with_published": self.protocol == "benchmark" and self.data is not None,
            "table_1": {
                "published": PUBLISHED_SPARSITY.to_json(),
                "whole_images": whole and whole.to_json(),
                "crop_1216x256": crop and crop.to_json(),
            },
            "table_2": {
                "published": [
                    {"name": name, "rmse_mm": rmse_mm, "seconds": seconds}
                    for name, rmse_mm, seconds in PUBLISHED_BENCHMARK
                ],
                "classical": self.classical and self.classical.to_json(),
                "shift_conv": results["with"],
            },
            "table_3": {
                "published": {f"{name}_mm": value for name, value in PUBLISHED_ABLATION.items()},
                **results,
            },
            "not_measured": self._missing(),
        }

    def table(self) -> "Group":
        """Make the tables, one below the other, and a line on what was not measured."""
        from rich.console import Group

        rows = [row.network for row in self._results.values() if row is not None]
        notes = (networks_note(rows), missing_note(self._missing()))
        tables = self._sparsity_table(), self._benchmark_table(), self._ablation_table()
        return Group(*tables, *filter(None, notes))

    @property
    def _results(self) -> dict[str, Measured | None]:
        return {"with": self.with_shift_conv, "without": self.without_shift_conv}

    def _missing(self) -> list[str]:
        if self.data is None:
            return ["ours, without --data and weights"]
        measured = [name for name, row in self._results.items() if row and row.network.is_papers]
        absent = " ".join(option for name, option in _OPTIONS.items() if name not in measured)
        recipe = (
            "the paper's networks (recipes depth-shiftconv-kitti, depth-without-shiftconv-kitti)"
        )
        benchmark = [] if self.protocol == "benchmark" else [f"the benchmark, {_NEEDS_FRAMES}"]
        return [*benchmark, *([f"{recipe}, without {absent}"] if absent else [])]

    def _sparsity_table(self) -> "Table":
        frames = f", mean of {self.frames:,} frames" if self.frames else ""
        table = new_table(
            f"Table 1: sparsity of the projected sweep{frames}",
            ("", "measured pixels", "empty pixels", "measured"),
        )
        names = ("published", "ours, whole images", "ours, 1216x256")
        for name, each in zip(names, (PUBLISHED_SPARSITY, *(self.sparsity or ())), strict=False):
            counts = f"{each.measured_pixels:,.1f}", f"{each.empty_pixels:,.1f}"
            table.add_row(name, *counts, f"{each.measured_share:.2%}")
        return table

    def _benchmark_table(self) -> "Table":
        columns = ("method", "network", *self._rmse_columns(), "s a frame")
        title = "Table 2: KITTI depth completion (times on different machines)"
        table = new_table(title, columns, texts=2)
        for name, rmse_mm, seconds in PUBLISHED_BENCHMARK:
            cells = self._published_cells(rmse_mm)
            table.add_row(f"{name}, published", "", *cells, f"{seconds:g}")
        if self.classical is not None:
            cells = self._our_cells(self.classical, with_time=True)
            table.add_row("no training, ours", self.classical.network.name, *cells)
        self._add_rows(table, "Shift-Convolution", "with", with_time=True)
        return table

    def _ablation_table(self) -> "Table":
        columns = ("Shift-Conv", "network", *self._rmse_columns())
        table = new_table("Table 3: Shift-Conv", columns, texts=2)
        for name, published_mm in PUBLISHED_ABLATION.items():
            table.add_row(f"{name}, published", "", *self._published_cells(published_mm))
            self._add_rows(table, name, name, with_time=False)
        return table

    def _add_rows(self, table: "Table", title: str, name: str, *, with_time: bool) -> None:
        row = self._results[name]
        cells = () if row is None else self._our_cells(row, with_time=with_time)
        network = None if row is None else row.network
        add_rows(table, (f"{title}, ours",), _OPTIONS[name], network, cells)

    def _our_cells(self, row: Measured, *, with_time: bool) -> tuple[str, ...]:
        needs = () if self.protocol == "benchmark" else (_NEEDS_FRAMES,)
        seconds = (f"{row.seconds:.3f}",) if with_time else ()
        return (*needs, f"{row.paper_rmse_mm:,.2f}", f"{row.rmse_mm:,.2f}", *seconds)

    def _published_cells(self, rmse_mm: float) -> tuple[str, ...]:
        return (f"{rmse_mm:,.2f}", *[""] * (len(self._rmse_columns()) - 1))

    def _rmse_columns(self) -> tuple[str, ...]:
        """Titles of the RMSE columns: first the published, then ours by frame size."""
        if self.protocol == "benchmark":
            return ("RMSE mm, 1216x256", "1216x352")
        where = f"{self.protocol}, {self.frames:,} frames"
        return ("RMSE mm, KITTI's 1,000 frames", f"RMSE mm, {where}, 1216x256", "1216x352")


def reproduce_shift_conv(
    data: Path | None = None,
    *,
    weights: str | Path | None = None,
    weights_without: str | Path | None = None,
    figures: Path | None = None,
    figure_frame: str | None = None,
    engine: EngineChoice = "torch",
    device: str = "cpu",
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
) -> ShiftConvReport:
    """Measure the figures of the paper's tables on the given data.

    A depth completion tree is scored against its ground truth by KITTI's rules; only the 1,000
    frames of `val_selection_cropped` give the benchmark's figure. Other data is scored on held-out
    rings (`sightline.evaluation.held_out`) with 64 beams. Both are done twice: with frames of
    1216x256, as in the paper, and of 1216x352, as in the benchmark.

    Args:
        data: Folder of the data set; see `open_dataset`. None: the published figures alone.
        weights: Weights of the paper's network; see `load_network`. None: its rows stay open.
        weights_without: Weights of the same network trained without Shift-Conv.
        figures: Folder for a picture of one frame, see `write_frame`. None: none is drawn.
        figure_frame: Name of that frame. None: the first.
        engine: Engine that runs the networks.
        device: Device that runs the networks.
        sample_list: List of the samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Raises:
        ValueError: The data cannot be read or scored, weights or figures are given without data,
            or `weights` is without or `weights_without` with Shift-Conv.
    """
    if data is None:
        if weights is not None or weights_without is not None or figures is not None:
            raise ValueError("weights and figures need data; name a data set with --data")
        return ShiftConvReport()
    with_ = _load(weights, has_shift_conv=True)
    without = _load(weights_without, has_shift_conv=False)
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=("image", "points")
    )
    frame_index = find_frame(dataset, figure_frame)
    protocol = _protocol(dataset)

    def measure(loaded: LoadedNetwork[DepthCompletionNet] | None) -> Measured | None:
        if loaded is None:
            return None
        paper, design = DepthCompletionConfig(), "with Shift-Conv"
        if loaded.network.shift_branch is None:
            paper, design = replace(paper, shift_conv=None), "without Shift-Conv"
        departures = find_departures(loaded.network.config, paper)
        network = describe(loaded, design, departures)
        predictor = DepthPredictor(loaded, engine=engine, device=device)
        return _measure(dataset, predictor, network, protocol)

    method = DepthCompleter("adaptive")
    given = GivenNetwork(name=method.name, design="ours, no training", departures=("no network",))
    report = ShiftConvReport(
        data=str(data),
        protocol=protocol,
        frames=len(dataset),
        sparsity=measure_sparsity(dataset),
        classical=_measure(dataset, method, given, protocol),
        with_shift_conv=measure(with_),
        without_shift_conv=measure(without),
    )
    if figures is not None:
        write_frame(figures / FIGURES, dataset[frame_index], with_)
    return report


def _load(
    weights: str | Path | None, *, has_shift_conv: bool
) -> LoadedNetwork[DepthCompletionNet] | None:
    if weights is None:
        return None
    loaded = load_network(NETWORK_TASK, weights)
    if (loaded.network.shift_branch is not None) != has_shift_conv:
        actual, expected = ("without", "with") if has_shift_conv else ("with", "without")
        raise ValueError(
            f"{loaded.name} is a network {actual} Shift-Conv, expected one {expected}; give "
            "--weights the one and --weights-without the other"
        )
    return loaded


def write_frame(
    path: Path, sample: CameraLidarSample, loaded: LoadedNetwork[DepthCompletionNet] | None
) -> None:
    """Draw the paper's crop of a frame, one map below the other: Fig. 4, 5, 7 and 10.

    From the top: image; projected sweep; ground truth and the expanded one, if there is any;
    E-Point and completed depth, if a network with Shift-Conv is given.

    Raises:
        ValueError: The sample has no sweep.
    """
    stride = 1 if loaded is None else loaded.network.stride
    sample = crop(sample, *_bottom_centre(sample.image_size, _PAPER_CROP, stride))
    if sample.points is None:
        raise ValueError(f"sample {sample.sample_id} has no sweep to draw; name another frame")
    sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    maps = [("Fig. 4: projected sweep", sparse, _POINT_PX)]
    if sample.depth is not None:
        maps += [("Fig. 5 (b): ground truth", sample.depth, _POINT_PX)]
        expanded = expand_depth(sample.depth[None, None])[0, 0]
        maps += [("Fig. 5 (a): expanded ground truth", expanded, 1)]
    if loaded is not None:
        image = torch.from_numpy(camera_picture(sample)).permute(2, 0, 1)
        given = (image[None] / 255, sparse[None, None], sparse[None, None])
        e_point_m = loaded.network(*given).e_point_m  # does not depend on a filled depth
        maps += [("Fig. 7: E-Point", e_point_m[0, 0], 1)]
        depth_m = DepthPredictor(loaded).complete(sparse, sample.image).depth_m
        maps += [(f"Fig. 10: completed depth, {loaded.name}", depth_m, 1)]
    parts = [with_title(camera_picture(sample), f"Frame {sample.sample_id}: image")]
    parts += [with_title(colorize_depth(map_, point_size_px=px), title) for title, map_, px in maps]
    write_rgb(path, np.concatenate(parts))


def _bottom_centre(
    image_size: tuple[int, int], size: tuple[int, int], stride: int = 1
) -> tuple[int, int, int, int]:
    """Top, left, height and width of a crop; height and width are multiples of the stride."""
    height, width = (min(*pair) // stride * stride for pair in zip(image_size, size, strict=True))
    return image_size[0] - height, (image_size[1] - width) // 2, height, width


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
        top, left, height, width = _bottom_centre(sample.image_size, _PAPER_CROP)
        part = is_measured[top : top + height, left : left + width]
        for counts, pixels in ((whole, is_measured), (cropped, part)):
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


def _measure(
    dataset: SampleDataset, completer: Completer, network: GivenNetwork, protocol: Protocol
) -> Measured:
    score = _score_rings if protocol == "held-out rings" else _score_truth
    rmse_mm, _ = score(dataset, completer, CROP_SIZE)
    paper_rmse_mm, seconds = score(dataset, completer, _PAPER_CROP)
    return Measured(network=network, rmse_mm=rmse_mm, paper_rmse_mm=paper_rmse_mm, seconds=seconds)


def _score_rings(
    dataset: SampleDataset, completer: Completer, size: tuple[int, int]
) -> tuple[float, float]:
    """Score frames of a size on held-out rings: mean RMSE [mm], median time [s]."""
    samples = (dataset[index] for index in range(len(dataset)))
    report = evaluate_held_out(
        samples, completer, beams=(_BEAMS,), crop_size=size, total=len(dataset)
    )
    return report.scores[0].rmse_mm, report.scores[0].milliseconds / 1e3


def _score_truth(
    dataset: SampleDataset, completer: Completer, size: tuple[int, int]
) -> tuple[float, float]:
    """Score frames of a size on their ground truth: mean RMSE [mm], median time [s]."""
    errors_mm, seconds = [], []
    for index in track(range(len(dataset)), description="scoring", total=len(dataset)):
        sample = dataset[index]
        if sample.depth is None:
            raise ValueError(
                f"sample {sample.sample_id} has no ground truth to score against; give the tree "
                "with val_selection_cropped"
            )
        top, left, height, width = _bottom_centre(sample.image_size, size)
        truth_m = sample.depth[top : top + height, left : left + width].numpy()
        given = crop(replace(sample, depth=None), top, left, height, width)
        start = time.perf_counter()
        depth_m = completer(given).depth_m.cpu().numpy()
        seconds.append(time.perf_counter() - start)
        errors_mm.append(score_depth(depth_m, truth_m).rmse_mm)
    return statistics.fmean(errors_mm), statistics.median(seconds)
