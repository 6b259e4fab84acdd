"""The commands that measure: `evaluate`.

Their functions are not called as those that `import sightline` gives: jsonargparse looks each up
there, and would import what measures to answer `--help`.
"""

from pathlib import Path
from typing import Literal

from sightline.cli.engine import tell_engine
from sightline.cli.object_plots import write_object_plots
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import check_places, check_writable_folder, deliver, named_file
from sightline.data.jobs import check_outputs
from sightline.data.object_tree import Velodyne
from sightline.depth_completion.method_names import Method
from sightline.export.names import EngineChoice

_COMPARED_RESAMPLES = 1000  # of frames, where differences are told and no number is given


def objects_command(
    results: Path,
    labels: Path,
    *,
    sample_list: str | None = None,
    overlaps: str = "strict",
    bootstrap: int = 0,
    seed: int = 0,
    by_distance: tuple[float, ...] = (),
    missing_as_empty: bool = False,
    against: Path | None = None,
    json: Path | None = None,
    csv: Path | None = None,
    markdown: Path | None = None,
    plots: Path | None = None,
) -> None:
    """Scores result files exactly as KITTI's official object evaluation does.

    With --against a second folder of results is scored on the same frames, and the differences are
    told with intervals.

    Args:
        results: Folder with one result file a frame (16 fields a line).
        labels: Folder with one label file a frame (15 fields a line).
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all that have labels.
        overlaps: strict, loose, or per class e.g. car=0.7,0.5,0.5 (image, bird's eye, 3D).
        bootstrap: Resamples of the frames for the interval of AP_all_points; 0 leaves it out. With
            --against for the interval of each difference; there 0 stands for 1000.
        seed: Of the resamples.
        by_distance: Distances from the camera [m] at which bands end that are scored by themselves,
            e.g. 20 40.
        missing_as_empty: Takes a frame without a result file as one in which nothing was found.
        against: Folder of other results of the same frames, to compare with.
        json: File for the whole report.
        csv: File for the scores, a line for each class, metric, difficulty and band.
        markdown: File for the same as a table.
        plots: Folder for pictures of precision over recall, one for each class, metric and band,
            with a curve for each difficulty.
    """
    if against is not None and (by_distance or csv or markdown or plots):
        raise ValueError(
            "--against gives differences as a table and as --json; leave --by-distance, --csv, "
            "--markdown and --plots out"
        )
    places = {"--json": json, "--csv": csv, "--markdown": markdown}
    read = [results, *([against] if against else [])]
    only_read = [labels, named_file(sample_list)]
    check_outputs(places | {"--plots": plots}, data=only_read, results=read)
    check_places(places)
    check_writable_folder(plots)
    from sightline.evaluation.kitti_object import compare_objects, evaluate_objects
    from sightline.evaluation.kitti_object_rules import parse_overlaps
    from sightline.evaluation.object_rows import write_object_rows

    if against is not None:
        comparison = compare_objects(
            results,
            labels,
            against,
            sample_list=sample_list,
            overlaps=parse_overlaps(overlaps),
            bootstrap=bootstrap or _COMPARED_RESAMPLES,
            seed=seed,
            missing_as_empty=missing_as_empty,
            progress=True,
        )
        deliver(comparison, json)
        return
    report = evaluate_objects(
        results,
        labels,
        sample_list=sample_list,
        overlaps=parse_overlaps(overlaps),
        bootstrap=bootstrap,
        seed=seed,
        by_distance=by_distance,
        missing_as_empty=missing_as_empty,
        progress=True,
    )
    deliver(report, json)
    write_object_rows(report, csv=csv, markdown=markdown)
    if plots is not None:
        say(f"{plots}: {write_object_plots(report, plots)} pictures")


def proposals_command(
    results: Path,
    labels: Path,
    *,
    sample_list: str | None = None,
    ious: tuple[float, ...] = (0.5, 0.7),
    max_proposals: int | None = None,
    json: Path | None = None,
) -> None:
    """Recall of proposals: how many labelled objects a first stage finds.

    Args:
        results: Folder with one result file a frame (16 fields a line).
        labels: Folder with one label file a frame (15 fields a line).
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all that have labels.
        ious: Overlaps from which an object is found, one or several numbers.
        max_proposals: Only so many of a frame, those of the highest score.
        json: File for the whole report.
    """
    check_places({"--json": json}, data=[labels, named_file(sample_list)], results=[results])
    from sightline.evaluation.kitti_object_proposals import evaluate_proposals

    report = evaluate_proposals(
        results,
        labels,
        sample_list=sample_list,
        ious=ious,
        max_proposals=max_proposals,
        progress=True,
    )
    deliver(report, json)


def depth_command(
    predictions: Path,
    truth: Path,
    *,
    by_distance: tuple[float, ...] = (),
    sparse: Path | None = None,
    against: Path | None = None,
    seed: int = 0,
    workers: int = 2,
    json: Path | None = None,
) -> None:
    """Scores depth maps exactly as KITTI's depth completion evaluation does.

    Args:
        predictions: A 16-bit depth PNG or a folder of them.
        truth: Ground truth likewise; matched by name.
        by_distance: Distances [m] at which bands of true depth end, e.g. 10 20 40 80: adds RMSE,
            MAE, bias and the shares off by more than 1 m of each band, pooled over pixels.
        sparse: Sparse depth maps likewise (velodyne_raw): adds the same at LiDAR returns, within 3
            px of one and beyond, and the share of sound returns that predictions leave.
        against: Predictions of another method: adds the difference to it, image by image, with its
            95 % interval.
        seed: Seed of that interval's resampling.
        workers: Threads that read and score.
        json: File for the whole report.
    """
    data = [truth, *([] if sparse is None else [sparse])]
    results = [predictions, *([] if against is None else [against])]
    check_places({"--json": json}, data=data, results=results)
    from sightline.evaluation.depth import evaluate_depth

    report = evaluate_depth(
        predictions,
        truth,
        band_ends_m=by_distance,
        sparse=sparse,
        against=against,
        seed=seed,
        workers=workers,
    )
    deliver(report, json)


def held_out_command(
    data: Path,
    *,
    method: Method | None = None,
    weights: str | None = None,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    beams: tuple[int, ...] | None = None,
    truth: Literal["rings", "depth", "depth_in_reach"] = "rings",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    json: Path | None = None,
) -> None:
    """Scores depth completion without ground truth, on LiDAR rings that the method never sees.

    Args:
        data: A KITTI object tree or raw drive with sweeps in KITTI's order.
        method: How depth is completed without a network.
        weights: The network: name of weights that come with Sightline (depth-best,
            depth-fast-cpu) or a file (.safetensors, .ckpt). Default: depth-best.
        engine: What runs the network: by default (auto) openvino where it is installed, on the CPU,
            and else torch.
        device: Where PyTorch runs the network.
        beams: How many of the sensor's beams the method gets, one or several numbers. Default:
            all, half, a quarter and an eighth of them.
        truth: rings, or of simulated frames their dense depth up to 80 m: all of it (depth), or
            what lies below the highest ring (depth_in_reach).
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        json: File for the whole report.
    """
    check_places({"--json": json}, data=[data, named_file(weights), named_file(sample_list)])
    from sightline.data.open import open_dataset
    from sightline.depth_completion.predictor import choose_completer
    from sightline.evaluation.held_out import evaluate_held_out

    completer = choose_completer(method=method, weights=weights, engine=engine, device=device)
    tell_engine(engine, completer.made_by.get("engine"), device)
    parts = {*completer.parts, *(() if truth == "rings" else ("depth",))}
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    samples = (dataset[index] for index in range(len(dataset)))
    report = evaluate_held_out(samples, completer, beams=beams, truth=truth, total=len(dataset))
    deliver(report, json)


def realism_command(
    simulated: Path, real: Path, *, labels: Path | None = None, json: Path | None = None
) -> None:
    """Compares simulated frames with real ones: points, boxes, ground, traffic, light.

    Args:
        simulated: KITTI object tree that `simulate` wrote.
        real: KITTI object tree of real frames.
        labels: Folder of more real label files, whose objects are compared instead of those of
            REAL.
        json: File for the whole table.
    """
    check_places({"--json": json}, data=[simulated, real, labels])
    from sightline.evaluation.realism import evaluate_realism

    deliver(evaluate_realism(simulated, real, real_labels=labels), json)
