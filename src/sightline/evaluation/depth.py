"""Evaluation of depth map folders by the rules of KITTI's depth completion benchmark.

The report contains the benchmark's means, errors by distance and place, and the paired difference
to a second method (`sightline.evaluation.depth_breakdown`). The rules are in
`sightline.evaluation.depth_scores`. The score of a set is the mean of its images' scores: each
image has the same weight, independent of its number of pixels with ground truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import pairwise
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sightline.data.formats.map_png import read_depth_png
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.evaluation.depth_breakdown import (
    DepthBand,
    ErrorSums,
    LostReturns,
    PairedDifference,
    bands,
    breakdown_tables,
    error_sums,
    lost_returns,
    paired_difference,
    to_json,
)
from sightline.evaluation.depth_conventions import (
    ComparedDepths,
    compare_depths,
    doubts_about_depths,
    doubts_about_sparse_maps,
)
from sightline.evaluation.depth_files import DepthFiles, match_depth_files
from sightline.evaluation.depth_frames import (
    Contents,
    digest_contents,
    doubts_about_neighbours,
    doubts_about_repeats,
)
from sightline.evaluation.depth_scores import (
    DepthScores,
    fill_gaps,
    mean_scores,
    score_depth,
    score_predicted_pixels,
)
from sightline.evaluation.inputs import check_apart
from sightline.files.shard_path import data_path
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import MANIFEST_NAME
from sightline.jobs.progress import track
from sightline.jobs.read_ahead import map_ahead

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

_ROWS = (
    "MAE, mm",
    "RMSE, mm",
    "iMAE, 1/km",
    "iRMSE, 1/km",
    "SILog",
    "absRel",
    "sqRel",
    "coverage",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageReport:
    """Scores of one image."""

    name: str
    scores: DepthScores
    """Benchmark scores: over all pixels with ground truth, gaps of the prediction filled."""
    predicted_pixels_only: DepthScores | None
    """Scores over the pixels with a prediction; None if no pixel has both ground truth and
    prediction."""
    pixels: int
    """Number of pixels with ground truth."""
    sums: ErrorSums = field(compare=False)
    """Sums by band and place, from which the set's are computed."""
    depths: ComparedDepths = field(compare=False)
    """Numbers from which depths in another convention are recognised."""
    sparse: ComparedDepths | None = field(compare=False)
    """The same of the sparse map; None: not given."""
    contents: Contents = field(compare=False)
    """Digests of both maps."""
    files: DepthFiles = field(compare=False)
    """Files of the frame."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthReport:
    """Scores of a set of images."""

    images: tuple[ImageReport, ...]
    """Images by name."""
    unused_predictions: int
    """Number of predictions without ground truth: not scored."""
    bands: tuple[DepthBand, ...] = ()
    """Errors by distance, then by place, pooled over all images' pixels."""
    returns: LostReturns | None = None
    """Lost returns, if sparse maps are given."""
    against: tuple[PairedDifference, ...] = ()
    """Differences of this method minus the other, if one is given."""

    @property
    def mean(self) -> DepthScores:
        """Benchmark score of the set: the mean over its images."""
        return mean_scores([image.scores for image in self.images])

    @property
    def predicted_pixels_only(self) -> DepthScores:
        """Mean over images with a prediction at some pixel with ground truth."""
        scores = [image.predicted_pixels_only for image in self.images]
        return mean_scores([score for score in scores if score is not None])

    def to_json(self) -> dict[str, object]:
        """Convert the report to its file's content."""
        content: dict[str, object] = {
            "images": len(self.images),
            "mean": self.mean.to_json(),
            "per_image": {image.name: image.scores.to_json() for image in self.images},
            "predicted_pixels_only": self.predicted_pixels_only.to_json(),
        }
        returns = () if self.returns is None else (self.returns,)
        extras = {"bands": self.bands, "returns": returns, "against": self.against}
        return content | {name: to_json(rows) for name, rows in extras.items() if rows}

    def table(self) -> "RenderableType":
        """Make tables of the means, then of bands, sound returns and differences, if requested."""
        from rich.console import Group

        pixels = sum(image.pixels for image in self.images)
        more = breakdown_tables(self.bands, pixels, self.returns, self.against)
        return Group(self._means_table(), *more) if more else self._means_table()

    def _means_table(self) -> "Table":
        """Make a table of the means, a row with gaps filled and one over predicted pixels only."""
        from rich.table import Table

        title = f"depth, mean of {len(self.images):,} images"
        if self.unused_predictions:
            title += f" ({self.unused_predictions:,} predictions without ground truth left out)"
        table = Table(title=title, title_justify="left")
        table.add_column("score")
        table.add_column("all pixels, gaps filled (KITTI)", justify="right")
        table.add_column("predicted pixels only", justify="right")
        columns = (_format(self.mean), _format(self.predicted_pixels_only))
        for name, filled, predicted in zip(_ROWS, *columns, strict=True):
            table.add_row(name, filled, predicted)
        return table


@named_arguments
def evaluate_depth(
    predictions: Path | str,
    truth: Path | str,
    *,
    band_ends_m: Sequence[float] = (),
    sparse: Path | str | None = None,
    against: Path | str | None = None,
    seed: int = 0,
    workers: int = 2,
    progress: bool = True,
) -> DepthReport:
    """Score predicted depth maps against ground truth, file by file.

    Both are 16-bit depth PNGs, or folders of them (subfolders too), matched by name: the path
    inside the folder without its suffix. The benchmark's own names match as well:
    `groundtruth_depth`, `velodyne_raw` and `image` in its files, and the folders of its annotated
    drives, are names of the same frame. Of such drives `groundtruth` is the truth, `velodyne_raw`
    are the sparse maps. Only scores are kept in memory.

    Examples:
        >>> import sightline, tempfile
        >>> from sightline.data.formats.map_png import read_depth_png, write_depth_png
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> truth = PACKAGED_FRAMES / "training" / "depth"
        >>> with tempfile.TemporaryDirectory() as results:
        ...     for path in truth.iterdir():  # each depth half a metre too large
        ...         depth_m = read_depth_png(path)
        ...         write_depth_png(f"{results}/{path.name}", depth_m + 0.5 * (depth_m > 0))
        ...     round(sightline.evaluate_depth(results, truth).mean.rmse_mm)
        500

    Args:
        predictions: Prediction file or folder.
        truth: Ground-truth file or folder. All of it must be predicted; predictions for other
            images are counted but not scored.
        band_ends_m: Ends of bands of true depth [m], ascending; their pooled errors are added to
            the means, with those of a last band without an end.
        sparse: Sparse depth maps, matched by name, too: adds the errors at returns, within 3 px of
            one and beyond, and the share of sound returns lost by predictions.
        against: Predictions of another method: adds paired differences with their intervals.
        seed: Seed of the resampling of the intervals.
        workers: Number of threads for reading and scoring.
        progress: Whether to show the progress, if standard error is a terminal.

    Raises:
        ValueError: A file is missing, not a 16-bit depth PNG, of another size than its ground
            truth, or without any ground truth (the message contains its name); both are one file or
            folder; or bands do not ascend, or the seed is negative.
    """
    band_ends_m = tuple(band_ends_m)
    ends = (0.0, *band_ends_m)
    if any(not before < end < np.inf for before, end in pairwise(ends)):
        raise ValueError(
            f"bands must end at ascending distances above 0 m, got {', '.join(map(str, ends[1:]))}"
        )
    ends = (*ends, np.inf) if band_ends_m else ends
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")
    check_apart(predictions, truth, "the ground truth")
    predictions, truth = data_path(predictions), data_path(truth)
    score = partial(_score_files, truth=truth, workers=workers, progress=progress)
    images, unused = score(
        predictions, sparse=None if sparse is None else data_path(sparse), ends=ends
    )
    _warn_of_empty(images, predictions)
    if (truth / MANIFEST_NAME).is_file():
        warn_user(
            f"{truth}: a command wrote it ({MANIFEST_NAME}), so it probably holds results, not "
            "ground truth: name the results first",
        )
    doubts = _doubts_about_predictions(images, predictions, truth)
    if sparse is not None:
        measured = [each.sparse for each in images if each.sparse is not None]
        doubts += doubts_about_sparse_maps(measured, data_path(sparse), truth)
    for doubt in doubts:
        warn_user(doubt)
    report = DepthReport(
        images=images,
        unused_predictions=unused,
        bands=bands(_summed(images), ends[1:], places=sparse is not None),
        returns=None if sparse is None else lost_returns(_summed(images)),
    )
    if against is None:
        return report
    others, _ = score(data_path(against), sparse=None, ends=(0.0,))
    for doubt in _doubts_about_predictions(others, data_path(against), truth):
        warn_user(doubt)
    if _compared(images) == _compared(others):
        warn_user(
            f"{predictions} and {against} have the same scores in all {len(images)} images, so "
            "every difference is 0: name the predictions of another method",
        )
    return replace(report, against=_differences(images, others, seed))


def _score_files(
    predictions: Path,
    *,
    truth: Path,
    sparse: Path | None,
    ends: Sequence[float],
    workers: int,
    progress: bool,
) -> tuple[tuple[ImageReport, ...], int]:
    """Score each image, and count the predictions without ground truth."""
    if predictions.is_file() and truth.is_file():
        pairs, unused = [DepthFiles(truth.stem, predictions, truth, sparse)], 0
    else:
        pairs, unused = match_depth_files(predictions, truth, sparse)
    # Threads, because decoding and numpy release the lock.
    images = map_ahead(partial(_score_file, band_ends_m=ends[1:]), pairs, workers=workers)
    if progress:
        images = track(images, description="scoring", total=len(pairs))
    return tuple(images), unused


def _warn_of_empty(images: Sequence[ImageReport], predictions: Path) -> None:
    """Warn of images without a predicted pixel, which only one of both means includes."""
    empty = [image.name for image in images if not image.depths.pixels]
    if empty:
        warn_user(
            f"{predictions}: {len(empty):,} of {len(images):,} images have no predicted depth at a "
            f"pixel with ground truth ({describe_absent(empty)}): over all pixels they are wholly "
            "wrong, 'predicted pixels only' leaves them out; predict them, or score the others",
        )


def _doubts_about_predictions(
    images: Sequence[ImageReport], predictions: Path, truth: Path
) -> list[str]:
    """List the doubts about a method's maps: their convention, or else their frames."""
    depths = [each.depths for each in images]
    doubts = [*doubts_about_depths(depths, predictions, truth)]
    contents = {each.name: each.contents for each in images}
    doubts = doubts or [*doubts_about_repeats(contents, predictions)]
    files, error = [each.files for each in images], reduce(add, depths).mean_error
    return doubts or [*doubts_about_neighbours(files, error, predictions, truth)]


def _compared(images: Sequence[ImageReport]) -> list[dict[str, float | None]]:
    """Scores by which methods are told apart; unlike NaN, None equals None."""
    return [each.scores.to_json() for each in images]


def _summed(images: Sequence[ImageReport]) -> ErrorSums:
    return reduce(add, (image.sums for image in images))


def _differences(
    images: Sequence[ImageReport], others: Sequence[ImageReport], seed: int
) -> tuple[PairedDifference, ...]:
    return tuple(
        paired_difference(
            label,
            [getattr(image.scores, score) for image in images],
            [getattr(image.scores, score) for image in others],
            seed=seed,
        )
        for label, score in (("RMSE", "rmse_mm"), ("MAE", "mae_mm"))
    )


def _score_file(pair: DepthFiles, *, band_ends_m: Sequence[float]) -> ImageReport:
    name, prediction, truth, sparse = pair
    prediction_m, truth_m = read_depth_png(prediction), read_depth_png(truth)
    sparse_m = None if sparse is None else read_depth_png(sparse)
    if sparse_m is not None and sparse_m.shape != truth_m.shape:
        raise ValueError(f"{sparse} is not of the size of {truth}: give the maps of these images")
    try:
        scores = score_depth(prediction_m, truth_m)
        filled_m = prediction_m if scores.coverage == 1 else fill_gaps(prediction_m)
        return ImageReport(
            name=name,
            scores=scores,
            predicted_pixels_only=score_predicted_pixels(prediction_m, truth_m),
            pixels=int((truth_m > 0).sum()),
            sums=error_sums(filled_m, truth_m, band_ends_m=band_ends_m, sparse_m=sparse_m),
            depths=compare_depths(prediction_m, truth_m),
            sparse=None if sparse_m is None else compare_depths(sparse_m, truth_m),
            contents=digest_contents(prediction_m, truth_m),
            files=pair,
        )
    except ValueError as error:
        raise ValueError(f"{prediction} against {truth}: {error}") from error


def _format(scores: DepthScores) -> list[str]:
    return [
        f"{scores.mae_mm:.2f}",
        f"{scores.rmse_mm:.2f}",
        f"{scores.imae_per_km:.4f}",
        f"{scores.irmse_per_km:.4f}",
        f"{scores.silog:.4f}",
        f"{scores.abs_rel:.5f}",
        f"{scores.sq_rel:.5f}",
        f"{scores.coverage:.2%}",
    ]
