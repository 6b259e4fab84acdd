"""Depth completion's part of the demo: complete depth, score it in two ways, draw it."""

import html
from pathlib import Path
from typing import get_args

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.formats.image_file import write_rgb
from sightline.data.open import open_dataset
from sightline.depth_completion.method_names import Method
from sightline.depth_completion.predictor import Completer, DepthCompleter, choose_completer
from sightline.evaluation.depth import DepthReport, evaluate_depth
from sightline.evaluation.held_out import HeldOutReport, evaluate_held_out
from sightline.inference.demo import DemoPart
from sightline.inference.demo_page import picture_html
from sightline.inference.predict import predict
from sightline.inference.predictor import PredictingTask
from sightline.robustness.page import plain_table
from sightline.robustness.texts import TextTable
from sightline.visualization.sheet import frame_sheet

_HTML = """<p>Dense depth from a LiDAR sweep and an image by <b>{name}</b>. The depth maps are
16-bit PNGs (metres times 256), in <code>depth/</code>.</p>
<h3>Against LiDAR rings that no method saw</h3>
<p>RMSE in mm, by the number of beams of the sensor.</p>
{held_out_table}
<h3>Against true depth</h3>
<p>KITTI's rules. True depth is known here for every pixel, so this counts the regions above the
highest beam too, where any method can only guess.</p>
{depth_table}
{pictures}"""


def run_depth_demo(task: PredictingTask, frames: Path, out: Path) -> DemoPart:
    """Complete the depth of frames with the default weights, score it and draw it.

    Args:
        task: The depth completion task; it writes the files.
        frames: A simulated object tree, with true depth.
        out: Folder of the results; a second run computes only the missing depth maps.

    Raises:
        ValueError: `out` cannot be written to.
    """
    depth = out / "depth"
    completer = choose_completer()
    remedy = f"to make them anew, remove {depth}"
    predict(task, completer, frames, depth, workers=1, remedy=remedy)
    against_truth = evaluate_depth(depth, frames / "training" / "depth")
    dataset = open_dataset(frames, parts=completer.parts)
    completers: list[Completer] = [DepthCompleter(method) for method in get_args(Method)]
    by_name = {each.name: each for each in (*completers, completer)}
    held_out = {name: _score_held_out(dataset, each) for name, each in by_name.items()}
    pictures = [out / f"{name}.png" for name in dataset.sample_ids]
    whole = open_dataset(frames)  # with the labels, which the pictures show
    for index, picture in enumerate(pictures):
        sample = whole[index]
        write_rgb(picture, frame_sheet(sample, completer(sample), dense_name=completer.name))
    score = held_out[completer.name].scores[0]
    return DemoPart(
        title="Depth completion",
        result=(
            f"depth by {completer.name}: on LiDAR rings that it never saw, RMSE "
            f"{score.rmse_mm:.0f} mm and MAE {score.mae_mm:.0f} mm"
        ),
        files=(("depth", depth), *(("picture", picture) for picture in pictures)),
        html=_html(completer.name, against_truth, held_out, pictures),
    )


def _score_held_out(dataset: SampleDataset, completer: Completer) -> HeldOutReport:
    samples = (dataset[index] for index in range(len(dataset)))
    return evaluate_held_out(samples, completer)


def _html(
    name: str,
    against_truth: DepthReport,
    held_out: dict[str, HeldOutReport],
    pictures: list[Path],
) -> str:
    figures = (
        picture_html(
            picture,
            f"Frame {picture.stem}: labels, the sweep on the image, what it measures of the depth, "
            "the valid completed depth, and the frame from above.",
            is_wide=True,
        )
        for picture in pictures
    )
    return _HTML.format(
        name=html.escape(name),
        held_out_table=plain_table(_held_out_table(held_out)),
        depth_table=plain_table(_depth_table(against_truth)),
        pictures="\n".join(figures),
    )


def _depth_table(report: DepthReport) -> TextTable:
    scores = report.mean
    rows = (
        ("MAE, mm", f"{scores.mae_mm:.0f}"),
        ("RMSE, mm", f"{scores.rmse_mm:.0f}"),
        ("iMAE, 1/km", f"{scores.imae_per_km:.2f}"),
        ("iRMSE, 1/km", f"{scores.irmse_per_km:.2f}"),
    )
    return TextTable(title="", header=("score", f"mean of {len(report.images)} frames"), rows=rows)


def _held_out_table(reports: dict[str, HeldOutReport]) -> TextTable:
    beams = [score.beams for score in next(iter(reports.values())).scores]
    return TextTable(
        title="",
        header=("method", *(f"{number} beams" for number in beams)),
        rows=tuple(
            (name, *(f"{score.rmse_mm:.0f}" for score in report.scores))
            for name, report in reports.items()
        ),
    )
