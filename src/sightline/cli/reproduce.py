"""Commands of `reproduce`: print a paper's tables with our own figures."""

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from sightline.cli.network_options import announce_engine
from sightline.cli.output import say, warn
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file, refuse_given
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.export.choice import choose_engine
from sightline.export.names import EngineChoice
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from sightline.detection2d.config import Fusion
    from sightline.papers.two_stage_rows import Row


def renamed(command: Callable[..., None], old: str, new: str) -> Callable[..., None]:
    """Keep a command under its old name, with a note on the new one."""

    @functools.wraps(command)
    def call(**settings: Any) -> None:  # noqa: ANN401 - those of the command
        warn(f"warning: reproduce {old} is now reproduce {new}; the old name will be removed")
        command(**settings)

    call.__doc__ = (command.__doc__ or "").replace("Print", f"Old name of {new}: print", 1)
    return call


def reproduce_gated_fusion(
    *,
    data: Path | None = None,
    gated: str | None = None,
    ones: str | None = None,
    early: str | None = None,
    late: str | None = None,
    camera: str | None = None,
    lidar: str | None = None,
    out: Path = Path("gated_fusion"),
    suite: str = "dgfn7",
    seed: int = 0,
    class_name: Literal["Car", "Pedestrian", "Cyclist"] = "Car",
    iou: float | None = None,
    bootstrap: int = 0,
    figures: Path | None = None,
    figure_frame: str | None = None,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    json: Path | None = None,
) -> None:
    """Print the tables of Kim et al. 2018 (gated fusion) with our figures on the given data.

    Published figures are beside ours. Rows of the paper hold figures of its own network alone;
    another network has a row with its name. The detections are kept in OUT: to resume an
    interrupted run, run it again; further figures take seconds.

    Args:
        data: A KITTI object tree with labels. Default: the published figures alone.
        gated: Weights of the network with gates: name of weights in Sightline, or a file
            (.safetensors, .ckpt). The same for the other five.
        ones: Weights of the same network with all gates fixed at 1.
        early: Weights of one network on the channels of both sensors together (early fusion).
        late: Weights of a detector for each sensor, with common NMS (late fusion).
        camera: Weights of a detector on the camera alone, for Table II.
        lidar: Weights of a detector on the LiDAR alone, for Table II.
        out: Folder for the detections: KITTI's result files, one folder per network and case.
        suite: Set of cases: dgfn7, the seven of the paper; dgfn7-figure, with noise as in its
            picture.
        seed: Seed of the random boxes, discs and noise.
        class_name: Class in the tables. The published figures are for cars.
        iou: IoU that a match must exceed. Default: 0.7 for cars, 0.5 for the others.
        bootstrap: Number of resamples of the frames for AP over all scores; 0: none.
        figures: Folder for two pictures of the gates: histograms of their means (Fig. 4), and maps
            of one frame (Fig. 5), in every case.
        figure_frame: Frame of the maps. Default: the first.
        engine: Engine of the networks: by default (auto) openvino on the CPU if it is installed,
            else torch.
        device: Device of the networks in PyTorch.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps. Default: velodyne, or else velodyne_reduced.
        workers: Number of processes with one thread each.
        json: File for the whole report.
    """
    if data is None:
        used = ("data", "json", "figures", "gated", "ones", "early", "late", "camera", "lidar")
        refuse_given(reproduce_gated_fusion, locals(), "without --data", used=used)
    files = [named_file(each) for each in (gated, ones, early, late, camera, lidar, sample_list)]
    check_outputs({"--json": json, "--out": out, "--figures": figures}, data=[data, *files])
    check_places({"--json": json})
    from sightline.papers.gated_fusion_cases import reproduce_gated_fusion as reproduce
    from sightline.papers.gates import GATE_MAPS, GATE_MEANS

    options: Mapping[Fusion, str | None] = {
        "gated": gated,
        "ones": ones,
        "early": early,
        "late": late,
        "camera": camera,
        "lidar": lidar,
    }
    weights = {fusion: each for fusion, each in options.items() if each is not None}
    report = reproduce(
        data,
        weights,
        out,
        suite=suite,
        seed=seed,
        class_name=class_name,
        iou=iou,
        bootstrap=bootstrap,
        figures=figures,
        figure_frame=figure_frame,
        engine=engine,
        device=device,
        sample_list=sample_list,
        velodyne=velodyne,
        workers=workers,
    )
    announce_engine(engine, choose_engine(engine, device) if weights else None, device)
    deliver(report, json)
    if figures is not None and report.gates:
        say(figures / GATE_MEANS, figures / GATE_MAPS)


def reproduce_two_stage(
    *,
    data: Path | None = None,
    first: str | None = None,
    baseline: str | None = None,
    improved: str | None = None,
    out: Path = Path("two_stage"),
    figures: Path | None = None,
    figure_frame: str | None = None,
    training_frame: str | None = None,
    run: Path | None = None,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    workers: int = 2,
    json: Path | None = None,
) -> None:
    """Print the table of the course on two-stage 3D detection with our figures on the given data.

    Average precision of cars at 11 recall positions, at a 3D IoU of 0.5 (the course's) and 0.7.
    Rows of the course hold figures of its own networks alone; another network has a row with its
    name. The detections of weights are kept in OUT: to resume an interrupted run, run it again.

    Args:
        data: A KITTI object tree with labels. Default: the published figures alone.
        first: Weights whose first stage is scored alone: name of weights in Sightline, or a file
            (.safetensors, .ckpt); or a folder of result files. The same for the other two.
        baseline: Weights of the plain second stage of problem 1, with its first stage.
        improved: Weights of an improved second stage, problem 2.
        out: Folder for the detections of weights: KITTI's result files, one folder per row.
        figures: Folder for pictures: three regions of interest; a training scene with all proposals
            and pooled points; loss and precision of a training, and three validation scenes at its
            beginning, middle and end; precision over recall at both IoUs; one frame with the boxes
            of every row.
        figure_frame: Frame of the last picture. Default: the first.
        training_frame: Frame of the training scene, of all in the data. Default: the first that is
            not scored.
        run: Run folder of `sightline fit`, or a folder of its logs (TensorBoard or CSV), for the
            pictures of the training.
        engine: Engine of the networks: by default (auto) openvino on the CPU if it is installed,
            else torch.
        device: Device of the networks in PyTorch.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps. Default: velodyne, or else velodyne_reduced.
        workers: Number of processes with one thread each.
        json: File for the whole report.
    """
    if data is None:
        refused = ("figures", "training_frame", "run", "first", "baseline", "improved")
        used = ("data", "json", *refused)
        refuse_given(reproduce_two_stage, locals(), "without --data", used=used)
    options: Mapping[Row, str | None] = {"first": first, "baseline": baseline, "improved": improved}
    given = {row: each for row, each in options.items() if each is not None}
    folders = [Path(each) for each in given.values() if Path(each).is_dir()]
    only_read = [*folders, *([] if run is None else [run])]
    files = [named_file(each) for each in (*given.values(), sample_list)]
    places = {"--json": json, "--out": out, "--figures": figures}
    check_outputs(places, data=[data, *files], results=only_read)
    check_places({"--json": json})
    from sightline.papers.two_stage import reproduce_two_stage as reproduce

    report = reproduce(
        data,
        given,
        out,
        figures=figures,
        figure_frame=figure_frame,
        training_frame=training_frame,
        run=run,
        engine=engine,
        device=device,
        sample_list=sample_list,
        velodyne=velodyne,
        workers=workers,
    )
    has_networks = len(folders) < len(given)
    announce_engine(engine, choose_engine(engine, device) if has_networks else None, device)
    deliver(report, json)
    if report.figures.paths:
        say(*report.figures.paths)


def reproduce_shift_conv(
    *,
    data: Path | None = None,
    weights: str | None = None,
    weights_without: str | None = None,
    figures: Path | None = None,
    figure_frame: str | None = None,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    json: Path | None = None,
) -> None:
    """Print the tables of Yu and Kee 2021 (Shift-Convolution) with our figures on the given data.

    Published figures are beside ours. Rows of the paper hold figures of its own network alone;
    another network has a row with its name.

    Args:
        data: KITTI's depth completion tree with val_selection_cropped, for the benchmark's own
            figures; or any other data set, which is scored on held-out LiDAR rings. Default: the
            published figures alone.
        weights: Weights of the paper's network: name of weights in Sightline, or a file.
        weights_without: Weights of the same network trained without Shift-Conv.
        figures: Folder for a picture of one frame: projected sweep, ground truth and its expansion,
            E-Point, completed depth (Fig. 4, 5, 7, 10).
        figure_frame: Frame of that picture. Default: the first.
        engine: Engine of the networks: by default (auto) openvino on the CPU if it is installed,
            else torch.
        device: Device of the networks in PyTorch.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        json: File for the whole report.
    """
    if data is None:
        used = ("data", "json", "figures", "weights", "weights_without")
        refuse_given(reproduce_shift_conv, locals(), "without --data", used=used)
    files = [named_file(each) for each in (weights, weights_without, sample_list)]
    check_outputs({"--json": json, "--figures": figures}, data=[data, *files])
    check_places({"--json": json})
    from sightline.papers.shift_conv import FIGURES
    from sightline.papers.shift_conv import reproduce_shift_conv as reproduce

    report = reproduce(
        data,
        weights=weights,
        weights_without=weights_without,
        figures=figures,
        figure_frame=figure_frame,
        engine=engine,
        device=device,
        sample_list=sample_list,
        velodyne=velodyne,
    )
    has_networks = weights is not None or weights_without is not None
    announce_engine(engine, choose_engine(engine, device) if has_networks else None, device)
    deliver(report, json)
    if figures is not None:
        say(figures / FIGURES)
