"""Report of `reproduce_shiftconv`: the paper's figures beside our measurements."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, Literal

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
PUBLISHED_WITH_MM: Final = 1102.11
"""Table 3: RMSE with Shift-Conv."""
PUBLISHED_WITHOUT_MM: Final = 1206.93
"""Table 3: RMSE of the same network without Shift-Conv."""

_NEEDS_FRAMES = "needs KITTI's val_selection_cropped"
_NEEDS_WEIGHTS = "needs --weights (sightline fit --config depth-shiftconv-kitti)"
_NEEDS_WEIGHTS_WITHOUT = "needs --weights-without (the same recipe without Shift-Conv)"


@dataclass(frozen=True, kw_only=True, slots=True)
class Sparsity:
    """Numbers of pixels with and without a measurement, as means over the frames."""

    measured_pixels: float
    empty_pixels: float

    @property
    def measured_share(self) -> float:
        """Share of the pixels with a measurement."""
        return self.measured_pixels / (self.measured_pixels + self.empty_pixels)


PUBLISHED_SPARSITY: Final = Sparsity(measured_pixels=19_984.9, empty_pixels=286_515.1)
"""Table 1: sparsity of the input."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Measured:
    """Results of one method on the given data."""

    name: str
    rmse_mm: float
    """Mean of the frames' RMSEs."""
    seconds: float
    """Median wall-clock time per frame on this machine."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ShiftConvReport:
    """The paper's tables with our measurements."""

    data: str
    protocol: Protocol
    frames: int
    sparsity: tuple[Sparsity, Sparsity]
    """Sparsity of whole images and of the paper's crop."""
    classical: Measured
    """Best method without training, as a reference."""
    with_shift_conv: Measured | None
    """Result with Shift-Conv; None: no weights were given."""
    without_shift_conv: Measured | None

    def to_json(self) -> dict[str, object]:
        """Contents of the report file; a figure that was not measured is None."""
        whole, crop = self.sparsity
        return {
            "data": self.data,
            "frames": self.frames,
            "protocol": self.protocol,
            "comparable_with_published": self.protocol == "benchmark",
            "table_1": {
                "published": _sparsity_to_json(PUBLISHED_SPARSITY),
                "whole_images": _sparsity_to_json(whole),
                "crop_1216x256": _sparsity_to_json(crop),
            },
            "table_2": {
                "published": [
                    {"name": name, "rmse_mm": rmse_mm, "seconds": seconds}
                    for name, rmse_mm, seconds in PUBLISHED_BENCHMARK
                ],
                "classical": asdict(self.classical),
                "shift_conv": _to_json(self.with_shift_conv),
            },
            "table_3": {
                "published": {"with_mm": PUBLISHED_WITH_MM, "without_mm": PUBLISHED_WITHOUT_MM},
                "with": _to_json(self.with_shift_conv),
                "without": _to_json(self.without_shift_conv),
            },
        }

    def table(self) -> "Group":
        """Lays out the three tables, one below the other."""
        from rich.console import Group

        return Group(self._sparsity_table(), self._benchmark_table(), self._ablation_table())

    def _sparsity_table(self) -> "Table":
        table = _new_table(
            f"Table 1: sparsity of the projected sweep, mean of {self.frames:,} frames",
            ("", "measured pixels", "empty pixels", "measured"),
        )
        whole, crop = self.sparsity
        rows = (("published", PUBLISHED_SPARSITY), ("whole images", whole), ("1216x256", crop))
        for name, sparsity in rows:
            table.add_row(
                name,
                f"{sparsity.measured_pixels:,.1f}",
                f"{sparsity.empty_pixels:,.1f}",
                f"{sparsity.measured_share:.2%}",
            )
        return table

    def _benchmark_table(self) -> "Table":
        columns = ("method", *self._rmse_columns(), "s a frame")
        table = _new_table("Table 2: KITTI depth completion (times on different machines)", columns)
        for name, rmse_mm, seconds in PUBLISHED_BENCHMARK:
            cells = self._rmse_cells(f"{rmse_mm:,.2f}", "")
            table.add_row(f"{name}, published", *cells, f"{seconds:g}")
        for row, needs in ((self.classical, ""), (self.with_shift_conv, _NEEDS_WEIGHTS)):
            if row is None:
                table.add_row("Shift-Convolution, ours", *self._open_cells(needs), "")
            else:
                table.add_row(f"{row.name}, ours", *self._our_cells(row), f"{row.seconds:.3f}")
        return table

    def _ablation_table(self) -> "Table":
        columns = ("", *self._rmse_columns())
        table = _new_table("Table 3: Shift-Conv", columns)
        rows = (
            ("with", PUBLISHED_WITH_MM, self.with_shift_conv, _NEEDS_WEIGHTS),
            ("without", PUBLISHED_WITHOUT_MM, self.without_shift_conv, _NEEDS_WEIGHTS_WITHOUT),
        )
        for name, published_mm, _, _ in rows:
            table.add_row(f"{name}, published", *self._rmse_cells(f"{published_mm:,.2f}", ""))
        for name, _, row, needs in rows:
            cells = self._open_cells(needs) if row is None else self._our_cells(row)
            table.add_row(f"{name}, ours", *cells)
        return table

    def _rmse_columns(self) -> tuple[str, ...]:
        """Titles of the RMSE columns: one for the benchmark, one for another protocol."""
        if self.protocol == "benchmark":
            return ("RMSE mm",)
        where = f"{self.protocol}, {self.frames:,} frames"
        return ("RMSE mm, KITTI's 1,000 frames", f"RMSE mm, {where}")

    def _rmse_cells(self, benchmark: str, otherwise: str) -> tuple[str, ...]:
        return (benchmark,) if self.protocol == "benchmark" else (benchmark, otherwise)

    def _open_cells(self, needs: str) -> tuple[str, ...]:
        """Cells of a row without a measurement."""
        return (needs,) if self.protocol == "benchmark" else (_NEEDS_FRAMES, needs)

    def _our_cells(self, row: Measured) -> tuple[str, ...]:
        measured = f"{row.rmse_mm:,.2f}"
        if self.protocol == "benchmark":
            return (measured,)
        return (_NEEDS_FRAMES, measured)


def _new_table(title: str, columns: tuple[str, ...]) -> "Table":
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column(columns[0])
    for column in columns[1:]:
        table.add_column(column, justify="right", overflow="fold")
    return table


def _sparsity_to_json(sparsity: Sparsity) -> dict[str, float]:
    return {**asdict(sparsity), "measured_share": sparsity.measured_share}


def _to_json(row: Measured | None) -> dict[str, object] | None:
    return None if row is None else asdict(row)
