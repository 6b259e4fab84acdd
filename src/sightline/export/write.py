"""Export of networks to files, kept only if their outputs agree with PyTorch's."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from sightline.export.engines import TorchEngine, open_engine
from sightline.export.graph import ExportGraph
from sightline.export.names import SUFFIXES, Format
from sightline.export.onnx import export_onnx
from sightline.export.openvino import export_openvino, ir_files
from sightline.export.parity import ParityReport, check_parity
from sightline.files.atomic import atomic_path
from sightline.geometry.wrong_types import named_arguments


@named_arguments
def export_graphs(
    graphs: Sequence[ExportGraph],
    out: Path,
    format: Format,  # noqa: A002 - the flag is --format
) -> dict[Path, ParityReport]:
    """Write a network's graphs as files for ONNX Runtime or OpenVINO, and check their outputs.

    The files accept images of any size that the network's stride divides. They are kept, all or
    none, if all agree with PyTorch on their cases.

    Args:
        graphs: Graphs of one network.
        out: File to write: .onnx, or .xml for OpenVINO with its weights beside it as .bin. With
            several graphs, each name is appended: out-NAME.onnx.
        format: Format of the files.

    Returns:
        The differences to PyTorch, by file.

    Raises:
        ValueError: The suffix of `out` does not match the format, the extra `export` is not
            installed, or a file differs by more than its graph allows.
    """
    if out.suffix != SUFFIXES[format]:
        others = [each for each, suffix in SUFFIXES.items() if suffix == out.suffix]
        remedy = f"give --format {others[0]}" if others else "rename it"
        raise ValueError(
            f"a file in the format {format} ends in {SUFFIXES[format]}, got {out}; {remedy}"
        )
    export, place = (export_onnx, atomic_path) if format == "onnx" else (export_openvino, ir_files)
    reports = {}
    with ExitStack() as kept_together:
        for graph in graphs:
            path = out.with_stem(f"{out.stem}-{graph.name}") if graph.name else out
            aside = kept_together.enter_context(place(path))
            export(graph.module, graph.example_inputs, aside, metadata=graph.metadata)
            reports[path] = _check(graph, aside, path)
    return reports


def _check(graph: ExportGraph, aside: Path, path: Path) -> ParityReport:
    """Compare a temporary file with PyTorch."""
    reference = TorchEngine(graph.module, tuple(graph.example_inputs), metadata=graph.metadata)
    report = check_parity(
        reference,
        [open_engine(aside)],
        graph.cases(),
        unit=graph.unit,
        scale=graph.scale,
        allowed=graph.max_difference,
    )
    if not report.is_within(graph.max_difference):
        worst, unit = report.worst, graph.unit and f" {graph.unit}"
        raise ValueError(
            f"{path} was not kept: {worst.engine} differs from PyTorch by "
            f"{worst.max_difference:.3g}{unit} in {worst.output} at {worst.case}, expected "
            f"at most {graph.max_difference:g}{unit}; use --engine torch with these weights"
        )
    return report
