"""Depth completion's part of the demo: depth completed, scored two ways, drawn."""

import html
import io
from functools import partial
from pathlib import Path
from typing import get_args

from rich.console import Console

from sightline.data.open import SampleDataset, open_dataset
from sightline.depth_completion.frame_picture import draw_completed
from sightline.depth_completion.method_names import Method
from sightline.depth_completion.predictor import Completer, DepthCompleter, choose_completer
from sightline.evaluation.depth import DepthReport, evaluate_depth
from sightline.evaluation.held_out import HeldOutReport, evaluate_held_out
from sightline.inference.demo import DemoPart
from sightline.inference.pictures import write_frame_picture
from sightline.inference.predict import predict
from sightline.inference.predictor import AnsweringTask

_HTML = """<h2>Depth completion</h2>
<p>Dense depth from a LiDAR sweep by <b>{name}</b>. The depth maps are 16-bit PNGs (metres times
256), in <code>depth/</code>.</p>
<h3>Against true depth</h3>
<p>KITTI's rules. True depth is known here for every pixel, so this counts the regions above the
highest beam too, where any method can only guess.</p>
<pre>{depth_table}</pre>
<h3>Against LiDAR rings that no method saw</h3>
<p>RMSE in mm, by the number of beams of the sensor.</p>
<pre>{held_out_table}</pre>
{pictures}"""


def run_depth_demo(task: AnsweringTask, frames: Path, out: Path) -> DemoPart:
    """Completes the depth of frames with the default weights, scores it and draws it.

    Args:
        task: Depth completion, whose files are written.
        frames: A simulated object tree, with true depth.
        out: Folder for all of it; a second run makes only what is missing of the depth maps.

    Raises:
        ValueError: `out` cannot be written to.
    """
    depth = out / "depth"
    completer = choose_completer()
    predict(task, completer, frames, depth, workers=1)
    against_truth = evaluate_depth(depth, frames / "training" / "depth")
    dataset = open_dataset(frames, parts=completer.parts)
    completers: list[Completer] = [DepthCompleter(method) for method in get_args(Method)]
    by_name = {each.name: each for each in (*completers, completer)}
    held_out = {name: _score_held_out(dataset, each) for name, each in by_name.items()}
    draw = partial(draw_completed, completer=completer)
    pictures = [
        write_frame_picture(frames, name, out / f"{name}.png", draw=draw)
        for name in dataset.sample_ids
    ]
    score = held_out[completer.name].scores[0]
    return DemoPart(
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
    figures = "\n".join(
        f'<h3>Frame {picture.stem}</h3>\n<img src="{picture.name}" alt="frame {picture.stem}">'
        for picture in pictures
    )
    return _HTML.format(
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
