"""Differences of the engines' outputs to PyTorch's."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from torch import Tensor

from sightline.export.engines import Engine

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, kw_only=True, slots=True)
class OutputDifference:
    """Difference of one output of one engine on one input, in the report's unit.

    NaN or infinite if a value of either output is.
    """

    engine: str
    case: str
    """Name of the input."""
    output: str
    max_difference: float
    """Largest absolute difference to the reference."""
    mean_difference: float
    """Mean of the absolute differences."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ParityReport:
    """Differences of every engine, input and output."""

    differences: tuple[OutputDifference, ...]
    unit: str
    """Unit of the differences, e.g. mm; empty: each output has its own."""
    allowed: float | None = None
    """Largest difference of engines that count as equal in the table; None: no judgement."""

    @property
    def worst(self) -> OutputDifference:
        """Output with the largest difference; a non-finite one counts as the largest."""
        return max(self.differences, key=lambda entry: _order(entry.max_difference))

    def is_within(self, bound: float) -> bool:
        """Whether no difference is larger than the bound, and all are finite."""
        return self.worst.max_difference <= bound

    def to_json(self) -> dict[str, object]:
        """Contents of the report file; non-finite differences are null."""
        return {
            "unit": self.unit,
            "differences": [
                {
                    "engine": entry.engine,
                    "case": entry.case,
                    "output": entry.output,
                    "max": _or_none(entry.max_difference),
                    "mean": _or_none(entry.mean_difference),
                }
                for entry in self.differences
            ],
        }

    def table(self) -> "Table":
        """Lay out a row per engine, input and output; below, the largest difference, judged."""
        from rich.table import Table

        table = Table(
            title="difference to PyTorch" + (f", {self.unit}" if self.unit else ""),
            title_justify="left",
            caption=self._verdict(),
            caption_justify="left",
        )
        for column in ("engine", "input", "output"):
            table.add_column(column, no_wrap=True)
        for column in ("max", "mean"):
            table.add_column(column, justify="right", no_wrap=True)
        for entry in self.differences:
            values = (f"{entry.max_difference:.2g}", f"{entry.mean_difference:.2g}")
            table.add_row(entry.engine, entry.case, entry.output, *values)
        return table

    def _verdict(self) -> str:
        worst = self.worst
        unit = self.unit and f" {self.unit}"
        largest = (
            f"largest: {worst.max_difference:.2g}{unit}, {worst.engine}, {worst.output} at "
            f"{worst.case}"
        )
        if self.allowed is None:
            return largest
        relation = "within" if self.is_within(self.allowed) else "more than"
        return f"{largest}; {relation} the {self.allowed:g}{unit} allowed"


def check_parity(
    reference: Engine,
    engines: Sequence[Engine],
    cases: Mapping[str, Mapping[str, Tensor]],
    *,
    unit: str = "",
    scale: float = 1.0,
    allowed: float | None = None,
) -> ParityReport:
    """Run engines on the same inputs as the reference and compare the outputs.

    Args:
        reference: Reference engine, usually PyTorch's.
        engines: Engines to compare with the reference.
        cases: Inputs, by a name that describes their size.
        unit: Unit of the differences in the report; empty: each output has its own.
        scale: Factor from the outputs' unit to `unit`, e.g. 1000 from metres to mm.
        allowed: Largest difference of engines that count as equal in the table, in `unit`.

    Raises:
        ValueError: There is no engine or no input; or the names or sizes of an engine's outputs
            differ from the reference.
    """
    if not engines or not cases:
        raise ValueError("parity needs at least one engine and one input, got none")
    differences = []
    for case, inputs in cases.items():
        expected = reference(inputs)
        for engine in engines:
            outputs = engine(inputs)
            if list(outputs) != list(expected):
                raise ValueError(
                    f"{engine.name} gives the outputs {', '.join(outputs)}, but {reference.name} "
                    f"{', '.join(expected)}; export the weights again"
                )
            for name, output in outputs.items():
                largest, mean = _difference(output, expected[name], f"{engine.name}'s {name}")
                difference = OutputDifference(
                    engine=engine.name,
                    case=case,
                    output=name,
                    max_difference=largest * scale,
                    mean_difference=mean * scale,
                )
                differences.append(difference)
    return ParityReport(differences=tuple(differences), unit=unit, allowed=allowed)


def _difference(output: Tensor, expected: Tensor, place: str) -> tuple[float, float]:
    """Largest and mean absolute difference; 0 between empty outputs."""
    if output.shape != expected.shape:
        raise ValueError(
            f"{place} has the shape {tuple(output.shape)}, expected {tuple(expected.shape)}; "
            "export the weights again"
        )
    if not output.numel():
        return 0.0, 0.0
    difference = (output.cpu().double() - expected.cpu().double()).abs()
    return difference.max().item(), difference.mean().item()


def _order(difference: float) -> float:
    return math.inf if math.isnan(difference) else difference


def _or_none(difference: float) -> float | None:
    return difference if math.isfinite(difference) else None
