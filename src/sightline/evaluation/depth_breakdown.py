"""Depth errors by distance and by place, with their signs, and paired differences of two methods.

A mean does not show where a method fails: here errors are pooled over the pixels of all images of a
set, in bands of true depth and by the distance to a LiDAR return. Depth maps are metres with 0 =
none.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Float64
from scipy import ndimage

from sightline.evaluation.bootstrap import MIN_FRAMES, PERCENTILES, note_without_interval

if TYPE_CHECKING:
    from rich.table import Table

Place = Literal["measured", "between", "beyond"]
"""Place of a pixel: `measured`: at a LiDAR return; `between`: within 3 px of one; `beyond`: farther
from all."""
PLACES: Final[tuple[Place, ...]] = get_args(Place)

_NEAR_PX: Final = 3.0
_OFF_M: Final = 1.0
_SOUND_M: Final = 0.3
_FAR_M: Final = 40.0
_MM_PER_M: Final = 1e3


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBand:
    """Errors over the pixels of one band of distance or one place, pooled over images."""

    name: str
    pixels: int
    rmse_mm: float
    mae_mm: float
    bias_mm: float
    """Mean of prediction minus truth; negative if predictions are too near."""
    nearer_share: float
    """Share of the pixels more than 1 m too near."""
    farther_share: float
    """Share of the pixels more than 1 m too far."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LostReturns:
    """Sound LiDAR returns, within 0.3 m of the truth, and those predicted more than 1 m off."""

    sound: int
    """Number of sound returns with truth."""
    lost_share: float
    sound_beyond_40m: int
    lost_share_beyond_40m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedDifference:
    """Difference of one score between two methods, over the same images."""

    score: str
    mean: float
    low: float | None
    """Lower end of the 95 % interval over resampled images; None of fewer than `MIN_FRAMES`."""
    high: float | None
    better: int
    """Images with a lower score than the other method."""
    images: int


@dataclass(frozen=True, slots=True)
class ErrorSums:
    """Sums over pixels of one image, for bands and places; they can be added."""

    cells: Float64[np.ndarray, "num_cells 6"]
    """A row for each band, then each place: pixels, squared, absolute and signed errors [m], pixels
    too near, pixels too far."""
    returns: Float64[np.ndarray, "2 2"]
    """Numbers of sound and lost returns, for all and beyond 40 m."""

    def __add__(self, other: "ErrorSums") -> "ErrorSums":
        """Add the sums of both images' pixels."""
        return ErrorSums(self.cells + other.cells, self.returns + other.returns)


def error_sums(
    prediction_m: Float[np.ndarray, "height width"],
    truth_m: Float[np.ndarray, "height width"],
    *,
    band_ends_m: Sequence[float] = (),
    sparse_m: Float[np.ndarray, "height width"] | None = None,
) -> ErrorSums:
    """Sum the errors of one image by band and place.

    Args:
        prediction_m: Prediction with its gaps filled.
        truth_m: Ground truth; 0 = none.
        band_ends_m: Ends of the bands of true depth, ascending; each begins at the end of the
            previous one, the first at 0. The last may be infinite.
        sparse_m: The method's LiDAR returns; None omits the places.
    """
    scored = truth_m > 0
    error = (prediction_m - truth_m)[scored].astype(np.float64)
    truth = truth_m[scored]
    starts = (0.0, *band_ends_m[:-1])
    cells = [
        (truth >= start) & (truth < end) for start, end in zip(starts, band_ends_m, strict=False)
    ]
    returns = np.zeros((2, 2))
    if sparse_m is not None:
        cells += [place[scored] for place in _places(sparse_m)]
        sound = (sparse_m[scored] > 0) & (np.abs(sparse_m[scored] - truth) < _SOUND_M)
        lost = sound & (np.abs(error) > _OFF_M)
        for row, chosen in enumerate((sound, sound & (truth >= _FAR_M))):
            returns[row] = np.count_nonzero(chosen), np.count_nonzero(lost & chosen)
    columns = np.stack(
        (np.ones_like(error), error**2, np.abs(error), error, error < -_OFF_M, error > _OFF_M)
    )
    sums = [columns[:, cell].sum(axis=1) for cell in cells]
    return ErrorSums(np.array(sums).reshape(-1, 6), returns)


def bands(sums: ErrorSums, band_ends_m: Sequence[float], *, places: bool) -> tuple[DepthBand, ...]:
    """Convert summed errors to named bands; arguments as for `error_sums`."""
    starts = (0.0, *band_ends_m[:-1])
    names = [
        f"{start:g} m on" if end == np.inf else f"{start:g}-{end:g} m"
        for start, end in zip(starts, band_ends_m, strict=False)
    ]
    names += PLACES if places else ()
    return tuple(_band(name, cell) for name, cell in zip(names, sums.cells, strict=True))


def lost_returns(sums: ErrorSums) -> LostReturns:
    """Compute the share of lost returns among the sound ones."""
    (sound, lost), (far, lost_far) = sums.returns
    return LostReturns(
        sound=int(sound),
        lost_share=_ratio(lost, sound),
        sound_beyond_40m=int(far),
        lost_share_beyond_40m=_ratio(lost_far, far),
    )


def paired_difference(
    score: str,
    scores: Sequence[float],
    others: Sequence[float],
    *,
    resamples: int = 2000,
    seed: int = 0,
) -> PairedDifference:
    """Compare two methods image by image: mean difference and its bootstrap interval.

    Images are drawn with replacement (Efron's percentile interval). Neighbouring frames of a drive
    are similar, so the true interval is somewhat wider.

    Args:
        score: Name of the score; lower is better.
        scores: The first method's values, one per image.
        others: The other's, in the same order.
        resamples: Number of resampled sets.
        seed: Seed of the resampling.
    """
    differences = np.asarray(scores, dtype=np.float64) - np.asarray(others, dtype=np.float64)
    low, high = None, None
    if len(differences) >= MIN_FRAMES:
        drawn = np.random.default_rng(seed).integers(
            len(differences), size=(resamples, len(differences))
        )
        low, high = np.percentile(differences[drawn].mean(axis=1), PERCENTILES).tolist()
    return PairedDifference(
        score=score,
        mean=float(differences.mean()),
        low=low,
        high=high,
        better=int(np.count_nonzero(differences < 0)),
        images=len(differences),
    )


def breakdown_tables(
    bands: Sequence[DepthBand],
    pixels: int,
    returns: LostReturns | None,
    against: Sequence[PairedDifference],
) -> list["Table"]:
    """Make tables of bands, sound returns and differences, if there are any.

    Args:
        bands: Bands of distance and place.
        pixels: Number of pixels with truth, for the bands' shares.
        returns: Sound returns.
        against: Differences from another method.
    """
    from rich.table import Table

    def table(title: str, *columns: str) -> Table:
        empty = Table(title=title, title_justify="left")
        for column in columns:
            empty.add_column(column, justify="right", no_wrap=True)
        return empty

    tables = []
    if bands:
        errors = ("RMSE mm", "MAE mm", "bias mm", "> 1 m nearer", "> 1 m farther")
        title = "by distance and place, pooled over pixels, gaps filled"
        tables.append(table(title, "pixels", "share", *errors))
        for band in bands:
            tables[-1].add_row(band.name, f"{band.pixels / pixels:.1%}", *_cells(band))
    if returns is not None:
        title = "sound returns (within 0.3 m of the truth) that the prediction misses by > 1 m"
        tables.append(table(title, "returns", "number", "lost"))
        far = (returns.sound_beyond_40m, returns.lost_share_beyond_40m)
        for name, number, lost in (
            ("all", returns.sound, returns.lost_share),
            ("> 40 m", *far),
        ):
            tables[-1].add_row(name, f"{number:,}", f"{lost:.2%}" if number else "-")
    if against:
        title = "this method less the other, mean over images"
        columns = ("score", "difference mm", "95 % interval", "images better")
        tables.append(table(title, *columns))
        for row in against:
            if row.low is None or row.high is None:
                interval = "-"
                tables[-1].caption = note_without_interval(row.images, "images")
            else:
                interval = f"{row.low:+.1f} to {row.high:+.1f}"
            better = f"{row.better} of {row.images}"
            tables[-1].add_row(row.score, f"{row.mean:+.1f}", interval, better)
    return tables


def to_json(rows: Sequence[DepthBand | PairedDifference | LostReturns]) -> list[dict[str, object]]:
    """Convert rows to plain values; undefined values become None, as JSON has no NaN."""
    return [
        {name: None if value != value else value for name, value in asdict(row).items()}
        for row in rows
    ]


def _places(
    sparse_m: Float[np.ndarray, "height width"],
) -> tuple[Bool[np.ndarray, "height width"], ...]:
    """Make the masks of `PLACES`, in their order."""
    measured = sparse_m > 0
    if not measured.any():
        return measured, measured, ~measured
    near = ndimage.distance_transform_edt(~measured) <= _NEAR_PX
    return measured, near & ~measured, ~near


def _band(name: str, cell: Float64[np.ndarray, "6"]) -> DepthBand:
    pixels, squared, absolute, signed, nearer, farther = cell.tolist()
    return DepthBand(
        name=name,
        pixels=int(pixels),
        rmse_mm=_MM_PER_M * float(np.sqrt(_ratio(squared, pixels))),
        mae_mm=_MM_PER_M * _ratio(absolute, pixels),
        bias_mm=_MM_PER_M * _ratio(signed, pixels),
        nearer_share=_ratio(nearer, pixels),
        farther_share=_ratio(farther, pixels),
    )


def _cells(band: DepthBand) -> list[str]:
    if not band.pixels:
        return ["-"] * 5
    errors = (f"{value:.0f}" for value in (band.rmse_mm, band.mae_mm))
    shares = (f"{share:.2%}" for share in (band.nearer_share, band.farther_share))
    return [*errors, f"{band.bias_mm:+.0f}", *shares]


def _ratio(part: float, whole: float) -> float:
    return float(part / whole) if whole else float("nan")
