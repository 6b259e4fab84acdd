"""The main job from end to end on the embedded frames: what a newcomer runs first."""

import html
import io
from pathlib import Path
from typing import get_args

from rich.console import Console

from sightline.data.atomic import atomic_write_text
from sightline.data.check import check_tree
from sightline.data.open import SampleDataset, open_dataset
from sightline.depth_completion.methods import Method
from sightline.evaluation.depth import DepthReport, evaluate_depth
from sightline.evaluation.held_out import HeldOutReport, evaluate_held_out
from sightline.inference.batch import predict_depth_completion
from sightline.inference.depth import Completer, DepthCompleter, choose_completer
from sightline.inference.pictures import write_frame_picture
from sightline.simulation.packaged import PACKAGED_FRAMES

_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Sightline demo</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 1400px; margin: 2em auto; padding: 0 1em;
  color: #1c2530; }}
img {{ width: 100%; border-radius: 6px; margin: .5em 0 2em; }}
pre {{ background: #f2f4f7; padding: 1em; border-radius: 6px; overflow-x: auto; }}
</style>
<h1>Sightline demo</h1>
<p>Dense depth from a LiDAR sweep by <b>{name}</b>, on street frames that come with Sightline and
were made by its simulator (<code>sightline simulate</code> makes more). The depth maps are 16-bit
PNGs (metres times 256), in <code>depth/</code>.</p>
<h2>Against true depth</h2>
<p>KITTI's rules. True depth is known here for every pixel, so this counts the regions above the
highest beam too, where any method can only guess.</p>
<pre>{depth_table}</pre>
<h2>Against LiDAR rings that no method saw</h2>
<p>RMSE in mm, by the number of beams of the sensor.</p>
<pre>{held_out_table}</pre>
{pictures}
</html>
"""


def run_demo(out: Path) -> str:
    """Checks the embedded frames, completes their depth, scores it and draws it.

    Args:
        out: Folder for all of it; a second run makes only what is missing of the depth maps.

    Returns:
        What was written, for a person.

    Raises:
        ValueError: `out` cannot be written to.
    """
    frames, depth = PACKAGED_FRAMES, out / "depth"
    problems = list(check_tree(frames))
    if problems:
        raise ValueError(f"the embedded frames are damaged: {problems[0]}")
    completer = choose_completer()
    predict_depth_completion(frames, depth, workers=1)
    against_truth = evaluate_depth(depth, frames / "training" / "depth")
    dataset = open_dataset(frames, parts=completer.parts)
    completers: list[Completer] = [DepthCompleter(method) for method in get_args(Method)]
    by_name = {each.name: each for each in (*completers, completer)}
    held_out = {name: _score_held_out(dataset, each) for name, each in by_name.items()}
    pictures = [
        write_frame_picture(frames, name, out / f"{name}.png", completer=completer)
        for name in dataset.sample_ids
    ]
    report = out / "report.html"
    atomic_write_text(report, _page(completer.name, against_truth, held_out, pictures))
    score = held_out[completer.name].scores[0]
    return "\n".join(
        (
            f"depth by {completer.name}: on LiDAR rings that it never saw, RMSE "
            f"{score.rmse_mm:.0f} mm and MAE {score.mae_mm:.0f} mm",
            f"frames    {frames}",
            f"depth     {depth}",
            *(f"picture   {picture}" for picture in pictures),
            f"report    {report}",
        )
    )


def _score_held_out(dataset: SampleDataset, completer: Completer) -> HeldOutReport:
    samples = (dataset[index] for index in range(len(dataset)))
    return evaluate_held_out(samples, completer)


def _page(
    name: str,
    against_truth: DepthReport,
    held_out: dict[str, HeldOutReport],
    pictures: list[Path],
) -> str:
    figures = "\n".join(
        f'<h2>Frame {picture.stem}</h2>\n<img src="{picture.name}" alt="frame {picture.stem}">'
        for picture in pictures
    )
    return _PAGE.format(
        name=name,
        depth_table=html.escape(_text(against_truth)),
        held_out_table=html.escape(_held_out_table(held_out)),
        pictures=figures,
    )


def _text(report: DepthReport) -> str:
    file = io.StringIO()
    Console(file=file, width=100).print(report.table())
    return file.getvalue()


def _held_out_table(reports: dict[str, HeldOutReport]) -> str:
    beams = [score.beams for score in next(iter(reports.values())).scores]
    lines = [f"{'beams':<12}" + "".join(f"{number:>8}" for number in beams)]
    for name, report in reports.items():
        lines.append(f"{name:<12}" + "".join(f"{score.rmse_mm:8.0f}" for score in report.scores))
    return "\n".join(lines)
