"""`sightline show`: draw frames with predictions as a picture."""

from pathlib import Path

from sightline.cli.output import say, warn
from sightline.cli.report import check_places, named_file
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.files.problem import refuse_without_effect
from sightline.tasks import choose_task

_MIN_SCORE = 0.3


def show(
    data: Path,
    frames: list[str],
    *,
    out: Path | None = None,
    results: tuple[str, ...] = (),
    task: str | None = None,
    method: str | None = None,
    weights: str | None = None,
    min_score: float = _MIN_SCORE,
    velodyne: Velodyne | None = None,
) -> None:
    """Draw a frame: boxes on the image, LiDAR on the image, bird's-eye view, depth.

    Draws the prediction of one task, or result files. Of a predicted depth map it also draws the
    expected error, if the method has one, and the error, if the data has ground-truth depth. For
    several frames it draws a page with camera, depth and bird's-eye view of each, without errors.

    Args:
        data: A recording, or a KITTI object tree, depth completion tree or raw drive.
        frames: Names of the frames, e.g. 000008 000010.
        out: PNG or JPEG file to write. Default: FRAME.png in the current folder, or FIRST-LAST.png.
        results: Folders of result files to draw instead of running a task: from perceive or
            predict, packed or not, or other files in KITTI's formats.
        task: Task whose prediction is drawn; `sightline tasks` lists them. Default: the task of the
            weights, or depth-completion.
        method: Method without a network.
        weights: Weights of the network: name of weights in Sightline (`sightline tasks` lists them)
            or a file (.safetensors, .ckpt). Default: the task's own.
        min_score: Score threshold of drawn detections.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
    """
    name = frames[0] if len(frames) == 1 else f"{frames[0]}-{frames[-1]}"
    path = out or Path(f"{name}.png")
    folders = [Path(folder) for folder in results]
    check_places({"--out": path}, data=[data, named_file(weights)], results=folders)
    from sightline.data.open import existing_folder
    from sightline.perception.show import PredictorSource, ResultSource, write_frames_picture

    existing_folder(data)  # before a network is loaded
    if results and (task or method or weights):
        raise ValueError("--results needs no task, method or weights; leave these out")
    source: PredictorSource | ResultSource
    if results:
        source = ResultSource(folders)
    else:
        chosen = choose_task(task, weights)
        source = PredictorSource(chosen, chosen.predictor(method=method, weights=weights))
    refuse_without_effect(
        "on depth maps", min_score=min_score != _MIN_SCORE and not source.has_scores
    )
    picture = write_frames_picture(
        data, frames, path, source=source, min_score=min_score, velodyne=velodyne
    )
    say(picture)
    for line in source.counts if isinstance(source, ResultSource) else ():
        warn(line)
