"""`sightline health`: detect untrustworthy sensors, frame by frame."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sightline.cli.output import say
from sightline.cli.report import check_places, deliver, named_file
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.geometry.user_warning import warn_user

if TYPE_CHECKING:
    from sightline.data.datasets.sample_dataset import SampleDataset
    from sightline.health.shipped import ChosenLimits

ImageKind = Literal["png", "jpeg"]


def health(
    data: Path,
    *,
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    limits: Path | None = None,
    images: ImageKind | None = None,
    lidar_beams: int | None = None,
    fit_first: int | None = None,
    picture: Path | None = None,
    json: Path | None = None,
) -> None:
    """Rate camera, LiDAR and their alignment along a drive, without a model of the sensors.

    Prints the time line: scores from 1 (no fault) to 0 (no data), below 0.5 as bad as one sound
    frame in a hundred; alarms, raised after two consecutive bad frames (one without data) and
    cleared after five good ones; the LiDAR's rotation about z [degrees]. Also prints the limits
    used, and reasons for doubt about the scores.

    Args:
        data: A recording, KITTI object tree, depth completion tree or raw drive; its frames in
            their order.
        sample_list: List of frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name per line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        limits: Limits of these sensors from `health-limits`. Default: Sightline's limits for this
            kind of pictures and number of beams.
        images: Format in which the pictures were saved, png or jpeg. Default: recognised.
        lidar_beams: Number of the LiDAR's beams, 64, 32 or 16. Default: recognised.
        fit_first: Number of first frames of the drive, at least 10, to fit the limits to; they must
            be sound. For sensors without suitable limits. 30 are enough.
        picture: PNG for the time line and the faulty regions of sensors.
        json: File for all scores, the worst checks, alarms and regions.
    """
    only_read = [data, limits, named_file(sample_list)]
    check_places({"--json": json, "--picture": picture}, data=only_read)
    from sightline.data.datasets.sample_files import describe_sparse_maps
    from sightline.data.formats.image_file import write_rgb
    from sightline.data.open import open_dataset
    from sightline.health.monitor import HealthMonitor
    from sightline.health.report import HealthReport, doubts, doubts_of_origin
    from sightline.health.sequence import DriveMonitor
    from sightline.health.shipped import check_first
    from sightline.jobs.progress import track
    from sightline.visualization.health_timeline import draw_health

    check_first(fit_first)
    if limits is not None and (images or lidar_beams or fit_first):
        raise ValueError(
            "--limits replaces --images, --lidar-beams and --fit-first; leave these out"
        )
    sensors: tuple[Part, ...] = ("image", "points")
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=sensors, needs=()
    )
    if sample_list is not None and list(dataset.sample_ids) != sorted(dataset.sample_ids):
        warn_user(
            f"{sample_list} is not sorted: alarms and alignment follow its order, as if it were "
            "that of the drive",
        )
    chosen = _limits(dataset, limits, images, lidar_beams, fit_first)
    monitor = DriveMonitor(HealthMonitor(chosen.limits))
    samples = (dataset[index] for index in range(len(dataset)))
    tracked = track(samples, description="checking sensors", total=len(dataset))
    frames = tuple(monitor(sample) for sample in tracked)
    own_limits = limits is not None or fit_first is not None
    size = None if own_limits or not len(dataset) else dataset[0].image_size
    sparse_maps = describe_sparse_maps(dataset, data)
    doubtful = doubts(
        frames, size, has_sweeps=sparse_maps is None, are_own_limits=limits is not None
    )
    report = HealthReport(
        frames=frames,
        limits={"camera": chosen.camera, "lidar": chosen.lidar},
        warnings=(
            *chosen.warnings,
            *(doubts_of_origin(dataset[0]) if len(dataset) else ()),
            *(() if sparse_maps is None else (f"{sparse_maps}; the LiDAR's scores mean nothing",)),
            *doubtful,
        ),
    )
    if picture is not None:
        write_rgb(picture, draw_health(report.frames, report.notes))
        say(picture)
    deliver(report, json)
    for sensor, origin in report.limits.items():
        say(f"{sensor}: limits {origin}")
    for warning in report.warnings:
        warn_user(warning)


def _limits(
    dataset: "SampleDataset",
    limits: Path | None,
    images: ImageKind | None,
    beams: int | None,
    fit_first: int | None,
) -> "ChosenLimits":
    """Choose the given limits, else Sightline's, or fit them to the first frames."""
    from sightline.health.limits import read_limits
    from sightline.health.shipped import (
        ChosenLimits,
        check_frames,
        choose_for_dataset,
        fit_to_first,
    )

    if limits is not None:
        return ChosenLimits(limits=read_limits(limits), camera=str(limits), lidar=str(limits))
    chosen = choose_for_dataset(dataset, images=images, beams=beams)
    if fit_first is None:
        return chosen
    first = check_frames(dataset[index] for index in range(min(fit_first, len(dataset))))
    return fit_to_first(chosen, first)


def health_limits(
    data: Path,
    out: Path,
    *,
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    frames: int = 400,
    seed: int = 0,
    transfer: bool = False,
) -> None:
    """Fit limits to sound sensors: one clean frame in a hundred exceeds them.

    Args:
        data: A recording, KITTI object tree or raw drive of sound sensors like those to be rated.
        out: JSON file to write, for `sightline health --limits`.
        sample_list: List of the frames to draw from. Default: all.
        velodyne: Folder of the sweeps: whole sweeps, if whole sweeps are to be rated. Default:
            velodyne, or else velodyne_reduced.
        frames: Largest number of frames to use.
        seed: Seed of the random selection.
        transfer: Widens the limits for sensors of other makes, like Sightline's own limits.
    """
    check_places({"OUT": out}, data=[data, named_file(sample_list)])
    from sightline.health.fitting import fit_on_dataset
    from sightline.health.limits import write_limits

    limits = fit_on_dataset(
        data,
        sample_list=sample_list,
        velodyne=velodyne,
        frames=frames,
        seed=seed,
        transfer=transfer,
    )
    write_limits(out, limits)
    say(f"{out}: limits of {limits.provenance['frames']} frames")
