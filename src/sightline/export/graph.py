"""What a task says about a network, or a part of one, that leaves PyTorch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from torch import Tensor, nn

from sightline.export.metadata import ExportMetadata

Cases = Mapping[str, Mapping[str, Tensor]]
"""Inputs of a graph, by a name that tells their size and what is special about them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportGraph:
    """A module that becomes one file; a network of two stages has two.

    May be pickled where its module and `cases` may.
    """

    module: nn.Module
    """In eval mode."""
    example_inputs: Mapping[str, Tensor]
    """By parameter of `forward`; see `export_onnx`."""
    metadata: ExportMetadata
    """Goes into the file."""
    cases: Callable[[], Cases]
    """Makes the inputs on which the file must give what PyTorch gives; the same at every call."""
    max_difference: float
    """Largest difference to PyTorch that is let pass, in `unit`."""
    unit: str = ""
    """Empty where the outputs' units differ: each is compared in its own."""
    scale: float = 1.0
    """Factor from the outputs' unit to `unit`, e.g. 1000 from metres to mm."""
    name: str = ""
    """Tells the graphs of a network apart, e.g. proposals; empty where there is only one."""
