"""The commands that print a paper's tables beside our own figures: `reproduce`."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sightline.cli.engine import tell_engine
from sightline.cli.output import say
from sightline.cli.parser import Device
from sightline.cli.report import check_places, deliver, named_file
from sightline.data.jobs import check_outputs
from sightline.data.object_tree import Velodyne
from sightline.export.choice import choose_engine
from sightline.export.names import EngineChoice

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
    """Prints the tables of Yu and Kee 2021 (Shift-Convolution), with our figures on the data given.

    A cell that cannot be measured on the data, or without weights, says what it needs.

    Args:
        data: KITTI's depth completion tree with val_selection_cropped, for the benchmark's own
            figures; or any other data set, which is scored on held-out LiDAR rings.
        weights: The paper's network: name of weights that come with Sightline, or a file.
        weights_without: The same network trained without Shift-Conv.
        engine: What runs the networks: by default (auto) openvino where it is installed, on the
            CPU, and else torch.
        device: Where PyTorch runs the networks.
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all.
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
    """Prints the tables of Kim et al. 2018 (gated fusion), with our figures on the data given.

    Published figures stand beside ours; a cell that was not measured says what it needs. What the
    networks find is kept in OUT, so an interrupted run is finished by running it again, and other
    figures take seconds.

    Args:
        data: A KITTI object tree with labels.
        gated: The network with gates: name of weights that come with Sightline, or a file
            (.safetensors, .ckpt). The same for the other five.
        ones: The same network with all gates fixed at 1.
        early: One network on the channels of both sensors together (early fusion).
        late: A detector for each sensor, their boxes suppressed together (late fusion).
        camera: A detector on the camera alone, for Table II.
        lidar: A detector on the LiDAR alone, for Table II.
        out: Folder for what the networks find: KITTI's result files, one folder a network and case.
        suite: Which cases there are: dgfn7, the seven of the paper; dgfn7-figure, with noise as its
            picture shows it.
        seed: Another seed draws other boxes, discs and noise.
        class_name: The class in the tables. The published figures are of cars.
        iou: Overlap that a match must exceed. Default: 0.7 for cars, 0.5 for the others.
        bootstrap: Resamples of the frames for AP over all scores; 0 leaves it out.
        figures: Folder for two pictures of the gates: histograms of their means (Fig. 4), and maps
            of one frame (Fig. 5), in every case.
        figure_frame: The frame of the maps. Default: the first.
        engine: What runs the networks: by default (auto) openvino where it is installed, on the
            CPU, and else torch.
        device: Where PyTorch runs the networks.
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all.
        velodyne: Folder of the sweeps. Default: velodyne, or else velodyne_reduced.
        workers: Processes, each of one thread.
        json: File for the whole report.
    """
    if data is None:
        raise ValueError("reproduce dgfn measures on data; name a data set with --data")
    files = [named_file(each) for each in (gated, ones, early, late, camera, lidar, sample_list)]
    check_outputs({"--json": json, "--out": out, "--figures": figures}, data=[data, *files])
    check_places({"--json": json})
    from sightline.detection2d.gate_figures import GATE_MAPS, GATE_MEANS
    from sightline.detection2d.reproduce import reproduce_dgfn as reproduce

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
