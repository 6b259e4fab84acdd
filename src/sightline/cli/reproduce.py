"""Commands of `reproduce`: print a paper's tables with our own figures."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sightline.cli.engine import tell_engine
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file
from sightline.data.kitti_trees import Velodyne
from sightline.export.choice import choose_engine
from sightline.export.names import EngineChoice
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from sightline.detection2d.config import Fusion


def reproduce_shiftconv(
    *,
    data: Path | None = None,
    weights: str | None = None,
    weights_without: str | None = None,
    engine: EngineChoice = "auto",
    device: Device = "cpu",
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    json: Path | None = None,
) -> None:
    """Prints the tables of Yu and Kee 2021 (Shift-Convolution) with our figures on the given data.

    A cell that cannot be measured with the data or weights names its requirements.

    Args:
        data: KITTI's depth completion tree with val_selection_cropped, for the benchmark's own
            figures; or any other data set, which is scored on held-out LiDAR rings.
        weights: Weights of the paper's network: name of weights in Sightline, or a file.
        weights_without: Weights of the same network trained without Shift-Conv.
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
        raise ValueError("reproduce shiftconv measures on data; name a data set with --data")
    files = [named_file(each) for each in (weights, weights_without, sample_list)]
    check_places({"--json": json}, data=[data, *files])
    from sightline.depth_completion.reproduce import reproduce_shiftconv as reproduce

    report = reproduce(
        data,
        weights=weights,
        weights_without=weights_without,
        engine=engine,
        device=device,
        sample_list=sample_list,
        velodyne=velodyne,
    )
    tell_engine(engine, choose_engine(engine, device), device)
    deliver(report, json)


def reproduce_dgfn(
    *,
    data: Path | None = None,
    gated: str | None = None,
    ones: str | None = None,
    early: str | None = None,
    late: str | None = None,
    camera: str | None = None,
    lidar: str | None = None,
    out: Path = Path("dgfn"),
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
    """Prints the tables of Kim et al. 2018 (gated fusion) with our figures on the given data.

    Published figures are beside ours; a cell without a measurement names its requirements. The
    networks' detections are kept in OUT: to resume an interrupted run, run it again; further
    figures take seconds.

    Args:
        data: A KITTI object tree with labels.
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
        raise ValueError("reproduce dgfn measures on data; name a data set with --data")
    files = [named_file(each) for each in (gated, ones, early, late, camera, lidar, sample_list)]
    check_outputs({"--json": json, "--out": out, "--figures": figures}, data=[data, *files])
    check_places({"--json": json})
    from sightline.detection2d.dgfn.gates import GATE_MAPS, GATE_MEANS
    from sightline.detection2d.dgfn.reproduce import reproduce_dgfn as reproduce

    given: dict[Fusion, str | None]
    given = {
        "gated": gated,
        "ones": ones,
        "early": early,
        "late": late,
        "camera": camera,
        "lidar": lidar,
    }
    report = reproduce(
        data,
        {fusion: weights for fusion, weights in given.items() if weights is not None},
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
    tell_engine(engine, choose_engine(engine, device), device)
    deliver(report, json)
    if figures is not None:
        say(figures / GATE_MEANS, figures / GATE_MAPS)
