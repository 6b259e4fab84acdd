"""Scores folders of depth maps by the rules of KITTI's depth completion benchmark.

The rules are in `sightline.evaluation.depth_scores`. The score of a set is the mean of its images'
scores: each image counts the same, however many of its pixels have ground truth.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sightline.data.depth_png import read_depth_png
from sightline.data.object_tree import describe_absent
from sightline.data.progress import track
from sightline.data.threads import map_ahead
from sightline.evaluation.depth_scores import (
    DepthScores,
    mean_scores,
    score_depth,
    score_predicted_pixels,
)

if TYPE_CHECKING:
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


class _Pair(NamedTuple):
    name: str
    prediction: Path
    truth: Path


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageReport:
    """Scores of one image."""

    name: str
    scores: DepthScores
    """The benchmark's: over all pixels with ground truth, gaps of the prediction filled."""
    predicted_pixels_only: DepthScores | None
    """Over the pixels with a prediction; None where ground truth and prediction never meet."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthReport:
    """Scores of a set of images."""

    images: tuple[ImageReport, ...]
    """By name."""
    unused_predictions: int
    """Predictions without ground truth: not scored."""

    @property
    def mean(self) -> DepthScores:
        """The benchmark's score of the set: the mean over its images."""
        return mean_scores([image.scores for image in self.images])

    @property
    def predicted_pixels_only(self) -> DepthScores:
        """Mean over the images that have a prediction where they have ground truth."""
        scores = [image.predicted_pixels_only for image in self.images]
        return mean_scores([score for score in scores if score is not None])

    def to_json(self) -> dict[str, object]:
        """What the report file holds."""
        return {
            "images": len(self.images),
            "mean": self.mean.to_json(),
            "per_image": {image.name: image.scores.to_json() for image in self.images},
            "predicted_pixels_only": self.predicted_pixels_only.to_json(),
        }

    def table(self) -> "Table":
        """The means, with gaps filled and over predicted pixels only, one row each."""
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


def evaluate_depth(
    predictions: Path | str, truth: Path | str, *, workers: int = 2, progress: bool = True
) -> DepthReport:
    """Scores predicted depth maps against ground truth, file by file.

    Both are 16-bit depth PNGs, or folders of them (subfolders too), matched by name: the path
    inside the folder without its suffix. The benchmark's own names match as well: what its files
    call `groundtruth_depth`, `velodyne_raw` or `image`, and the folders of its annotated drives,
    stand for one and the same frame. Only scores are kept in memory.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> truth = PACKAGED_FRAMES / "training" / "depth"
        >>> sightline.evaluate_depth(truth, truth).mean.rmse_mm
        0.0

    Args:
        predictions: Prediction file or folder.
        truth: Ground-truth file or folder. All of it must be predicted; predictions for other
            images are counted but not scored.
        workers: Threads that read and score.
        progress: Whether to show how far it is, where standard error is a terminal.

    Raises:
        ValueError: Names the file that is missing, no 16-bit depth PNG, of another size than its
            ground truth, or without any ground truth.
    """
    predictions, truth = Path(predictions), Path(truth)
    if predictions.is_file() and truth.is_file():
        pairs, unused = [_Pair(truth.stem, predictions, truth)], 0
    else:
        pairs, unused = _match(predictions, truth)
    # Threads: decoding and numpy release the lock.
    images = map_ahead(_score_file, pairs, workers=workers)
    if progress:
        images = track(images, description="scoring", total=len(pairs))
    return DepthReport(images=tuple(images), unused_predictions=unused)


def _match(predictions: Path, truth: Path) -> tuple[list[_Pair], int]:
    """Name, prediction and ground truth of each image; and the number of other predictions."""
    predicted, true = _depth_files(predictions), _depth_files(truth)
    missing = sorted(true.keys() - predicted.keys())
    if missing:
        raise ValueError(
            f"{predictions} lacks predictions for {len(missing)} of the {len(true)} images with "
            f"ground truth in {truth} ({describe_absent(missing)}): predict them, or score against "
            "a folder that has only the ground truth wanted"
        )
    pairs = [_Pair(name, predicted[name], true[name]) for name in sorted(true)]
    return pairs, len(predicted) - len(true)


def _depth_files(folder: Path) -> dict[str, Path]:
    if not folder.is_dir():
        what = "is a file where the other is a folder" if folder.exists() else "does not exist"
        raise ValueError(f"{folder} {what}: give two folders of depth PNGs, or two files")
    files: dict[str, Path] = {}
    for path in sorted(folder.rglob("*.png")):
        place = path.relative_to(folder)
        if any(part.startswith(".") for part in place.parts):
            continue  # hidden: files that are still being written stand aside in such folders
        name = _frame_name(place.with_suffix("").as_posix())
        if name in files:
            raise ValueError(
                f"{folder} holds {files[name].relative_to(folder)} and {place}, which both stand "
                f"for frame {name}: remove one of them"
            )
        files[name] = path
    if not files:
        raise ValueError(f"{folder} holds no PNG: name the folder with the depth maps")
    return files


def _frame_name(name: str) -> str:
    """One name for what the benchmark's archives name by kind of file; other names stay."""
    annotated = r"(?:.+/)?([^/]+)/proj_depth/(?:groundtruth|velodyne_raw)/(image_0\d)/(\d+)"
    name = re.sub(rf"^{annotated}$", r"\1_image_\3_\2", name)
    return re.sub(r"_(?:groundtruth_depth|velodyne_raw)_(\d+_image_0\d)$", r"_image_\1", name)


def _score_file(pair: _Pair) -> ImageReport:
    name, prediction, truth = pair
    prediction_m, truth_m = read_depth_png(prediction), read_depth_png(truth)
    try:
        return ImageReport(
            name=name,
            scores=score_depth(prediction_m, truth_m),
            predicted_pixels_only=score_predicted_pixels(prediction_m, truth_m),
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
