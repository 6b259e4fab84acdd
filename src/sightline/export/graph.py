"""Task's description of a network, or a part of one, for export."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from torch import Tensor, nn

from sightline.export.metadata import ExportMetadata

Cases = Mapping[str, Mapping[str, Tensor]]
"""Inputs of a graph, by a name that describes their size and peculiarity."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportGraph:
    """Module for export to one file; a network of two stages has two.

    Can be pickled if its module and `cases` can.
    """

    module: nn.Module
    """Module in eval mode."""
    example_inputs: Mapping[str, Tensor]
    """Inputs by parameter name of `forward`; see `export_onnx`."""
    metadata: ExportMetadata
    """Metadata for the file."""
    cases: Callable[[], Cases]
    """Function that creates the inputs for the comparison with PyTorch; the same at every call."""
    max_difference: float
    """Largest allowed difference to PyTorch, in `unit`."""
    unit: str = ""
    """Unit of the comparison; empty: each output is compared in its own unit."""
    scale: float = 1.0
    """Factor from the outputs' unit to `unit`, e.g. 1000 from metres to mm."""
    name: str = ""
    """Name among the graphs of a network, e.g. proposals; empty: the only graph."""
