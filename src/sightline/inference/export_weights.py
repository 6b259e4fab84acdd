"""Trained networks as files that run without PyTorch."""

from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from sightline.data.atomic import atomic_path
from sightline.depth_completion.model import DepthCompletionNet
from sightline.export.engines import TorchEngine, open_engine
from sightline.export.onnx import export_onnx
from sightline.export.openvino import export_openvino, ir_files
from sightline.export.parity import ParityReport, check_parity
from sightline.inference.weights import load_network

Format = Literal["onnx", "openvino"]

MAX_DIFFERENCE_MM = 1.0
"""An exported network may differ by so much from PyTorch's in any pixel of any output.

Both compute in float32, whose step is 0.008 mm at 85 m; the order of sums differs. Measured on
networks with random weights: 0.22 mm at most (docs/results.md has the shipped ones)."""

_SUFFIXES = {"onnx": ".onnx", "openvino": ".xml"}
_SIZES_IN_STRIDES = ((5, 7), (8, 13))  # heights and widths; other than the example's
_FARTHEST_M = 85.0
_DENSITY = 0.05  # share of pixels with a return, about as a 64-beam sweep gives


def export_weights(
    weights: str | Path,
    out: Path,
    format: Format,  # noqa: A002 - the flag is --format
) -> ParityReport:
    """Writes a trained network as a file for ONNX Runtime or OpenVINO, and checks what it gives.

    The file takes images of any size that the network's stride divides. It is kept only if it
    gives, on random inputs of two sizes, with and without camera and LiDAR, what PyTorch gives.

    Args:
        weights: Name of weights that come with the package, or a file.
        out: File to write: .onnx, or .xml for OpenVINO, whose weights go beside it as .bin.
        format: What to write.

    Returns:
        The differences to PyTorch, in millimetres.

    Raises:
        ValueError: There are no such weights, `out` has another suffix than the format, the extra
            `export` is not installed, or the file differs by more than `MAX_DIFFERENCE_MM`.
    """
    if out.suffix != _SUFFIXES[format]:
        raise ValueError(
            f"a file in the format {format} ends in {_SUFFIXES[format]}, got {out}; rename it"
        )
    loaded = load_network(weights)
    network = loaded.network
    cases = _cases(network)
    example = loaded.example_inputs()
    export, place = (export_onnx, atomic_path) if format == "onnx" else (export_openvino, ir_files)
    with place(out) as aside:
        export(network, example, aside, metadata=loaded.metadata)
        reference = TorchEngine(network, tuple(example), metadata=loaded.metadata)
        report = check_parity(reference, [open_engine(aside)], cases, unit="mm", scale=1e3)
        if not report.is_within(MAX_DIFFERENCE_MM):
            worst = report.worst
            raise ValueError(
                f"{out} was not kept: {worst.engine} differs from PyTorch by "
                f"{worst.max_difference:.3g} mm in {worst.output} at {worst.case}, expected at "
                f"most {MAX_DIFFERENCE_MM:g} mm; use --engine torch with these weights"
            )
    return report


def _cases(network: DepthCompletionNet) -> dict[str, dict[str, Tensor]]:
    """Random inputs, the same for every call, by name."""
    generator = torch.Generator().manual_seed(0)
    cases = {}
    for blocks in _SIZES_IN_STRIDES:
        height, width = (number * network.stride for number in blocks)
        inputs = _random_inputs(network, (height, width), generator)
        size = f"{height}x{width}"
        black = torch.zeros_like(inputs["image"])
        empty = torch.zeros_like(inputs["sparse_depth_m"])
        cases[size] = inputs
        cases[f"{size}, no camera"] = {**inputs, "image": black}
        cases[f"{size}, no LiDAR"] = {**inputs, "sparse_depth_m": empty}
    return cases


def _random_inputs(
    network: DepthCompletionNet, size: tuple[int, int], generator: torch.Generator
) -> dict[str, Tensor]:
    depth_m = 1 + (_FARTHEST_M - 1) * torch.rand(1, 1, *size, generator=generator)
    is_measured = torch.rand(1, 1, *size, generator=generator) < _DENSITY
    inputs = {
        "image": torch.rand(1, 3, *size, generator=generator),
        "sparse_depth_m": torch.where(is_measured, depth_m, 0.0),
    }
    return {**inputs, "filled_depth_m": depth_m} if network.takes_filled_depth else inputs
