"""Commands of `evaluate`.

Their names differ from the functions of `import sightline`: jsonargparse looks names up there, and
would import the evaluation for `--help`.
"""

from pathlib import Path
from typing import Literal

from sightline.cli.network_options import announce_engine, refuse_engine
from sightline.cli.object_plots import write_object_plots
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import check_places, check_writable_folder, deliver, named_file
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.depth_completion.method_names import Method
from sightline.export.names import EngineChoice
from sightline.files.problem import refuse_without_effect
from sightline.jobs.output_dirs import check_outputs

_COMPARED_RESAMPLES = 1000  # default number of resamples of frames for differences


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
    """Score result files exactly as KITTI's official object evaluation does.

    3D boxes are also scored by nuScenes' centre distance ("centre" in the table).

    With --against a second folder of results is scored on the same frames, and the differences are
    printed, with intervals from 10 frames on.

    Args:
        results: Folder with one result file per frame (16 fields per line).
        labels: Folder with one label file per frame (15 fields per line).
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all that have labels.
        overlaps: strict, loose, or per class e.g. car=0.7,0.5,0.5 (image, bird's eye, 3D).
        bootstrap: Number of resamples of the frames for the intervals of AP_all_points and of AP by
            centre distance, from 10 frames on; 0: no interval. With --against, for the interval of
            each difference; there 0 means 1000.
        seed: Seed of the resamples.
        by_distance: End distances from the camera [m] of bands that are scored separately, e.g. 20
            40.
        missing_as_empty: Counts a frame without a result file as a frame without detections.
        against: Folder of other results of the same frames, for comparison.
        json: File for the whole report.
        csv: File for the scores, a line for each class, metric, difficulty and band.
        markdown: File for the scores as a table.
        plots: Folder for precision-recall pictures, one for each class, metric and band, with a
            curve for each difficulty.
    """
    if against is not None and (by_distance or csv or markdown or plots):
        raise ValueError(
            "--against gives differences as a table and as --json; leave --by-distance, --csv, "
            "--markdown and --plots out"
        )
    is_resampled = bootstrap > 0 or against is not None
    refuse_without_effect("without --bootstrap or --against", seed=seed != 0 and not is_resampled)
    places = {"--json": json, "--csv": csv, "--markdown": markdown}
    read = [results, *([against] if against else [])]
    only_read = [labels, named_file(sample_list)]
    check_outputs(places | {"--plots": plots}, data=only_read, results=read)
    check_places(places)
    check_writable_folder(plots)
    from sightline.evaluation.kitti_object import compare_objects, evaluate_objects
    from sightline.evaluation.kitti_object_rules import parse_overlaps
    from sightline.evaluation.object_report import write_object_rows

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
    # Before the table, whose reader may be gone.
    write_object_rows(report, csv=csv, markdown=markdown)
    num_plots = 0 if plots is None else write_object_plots(report, plots)
    deliver(report, json)
    if plots is not None:
        say(f"{plots}: {num_plots} pictures")


def proposals_command(
    results: Path,
    labels: Path,
    *,
    sample_list: str | None = None,
    ious: tuple[float, ...] = (0.5, 0.7),
    max_proposals: int | None = None,
    json: Path | None = None,
) -> None:
    """Measure the recall of proposals: the share of labelled objects that a first stage finds.

    Args:
        results: Folder with one result file per frame (16 fields per line).
        labels: Folder with one label file per frame (15 fields per line).
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all that have labels.
        ious: IoU thresholds at which an object counts as found, one or several numbers.
        max_proposals: Largest number of proposals per frame, those with the highest scores.
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
    """Score depth maps exactly as KITTI's depth completion evaluation does.

    Args:
        predictions: A 16-bit depth PNG or a folder of them.
        truth: Ground truth, a PNG or a folder; matched by name.
        by_distance: End distances [m] of bands of true depth, e.g. 10 20 40 80, and from the last
            on: adds RMSE, MAE, bias and the share of errors above 1 m for each, pooled over pixels.
        sparse: Sparse depth maps, a 16-bit depth PNG or a folder of them (velodyne_raw of KITTI's
            depth benchmark, not sweeps in .bin files): adds the same metrics at LiDAR returns,
            within 3 px of one and beyond, and the share of sound returns that predictions deviate
            from.
        against: Predictions of another method: adds the difference to it, image by image, with its
            95 % interval from 10 images on.
        seed: Seed of that interval's resampling.
        workers: Number of threads that read and score.
        json: File for the whole report.
    """
    refuse_without_effect("without --against", seed=seed != 0 and against is None)
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
    """Score depth completion without ground truth, on held-out LiDAR rings.

    Args:
        data: A recording, or a KITTI object tree or raw drive, with sweeps of a spinning LiDAR:
            whole ones in any order, or ones of 64 beams that are cut to the image.
        method: Depth completion method without a network.
        weights: Weights of the network: name of weights in Sightline (depth-best, depth-fast-cpu)
            or a file (.safetensors, .ckpt). Default: depth-best.
        engine: Engine of the network: by default (auto) openvino on the CPU if it is installed,
            else torch.
        device: Device of the network in PyTorch.
        beams: Number of the sensor's beams in the input, one or several numbers. Default: all,
            half, a quarter and an eighth of them.
        truth: rings, or for simulated frames their dense depth up to 80 m: all of it (depth), or
            the part below the highest ring (depth_in_reach).
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        json: File for the whole report.
    """
    check_places({"--json": json}, data=[data, named_file(weights), named_file(sample_list)])
    from sightline.data.open import open_dataset
    from sightline.depth_completion.predictor import choose_completer
    from sightline.evaluation.held_out import evaluate_held_out
    from sightline.evaluation.held_out_frame import check_for_sweeps

    if method is not None:
        refuse_engine(engine, device)
    completer = choose_completer(method=method, weights=weights, engine=engine, device=device)
    announce_engine(engine, completer.made_by.get("engine"), device)
    parts = {*completer.parts, *(() if truth == "rings" else ("depth",))}
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=parts)
    check_for_sweeps(dataset)
    samples = (dataset[index] for index in range(len(dataset)))
    report = evaluate_held_out(samples, completer, beams=beams, truth=truth, total=len(dataset))
    deliver(report, json)


def realism_command(
    simulated: Path, real: Path, *, labels: Path | None = None, json: Path | None = None
) -> None:
    """Compare simulated frames with real ones: points, boxes, ground, traffic, light.

    Args:
        simulated: KITTI object tree from `simulate`.
        real: KITTI object tree of real frames.
        labels: Folder of more real label files, whose objects are compared instead of those of
            REAL.
        json: File for the whole table.
    """
    check_places({"--json": json}, data=[simulated, real, labels])
    from sightline.evaluation.realism import evaluate_realism

    deliver(evaluate_realism(simulated, real, real_labels=labels), json)
