"""`sightline health`: which sensor cannot be trusted, frame by frame."""

import warnings
from pathlib import Path

from sightline.cli.output import say
from sightline.cli.report import check_places, deliver
from sightline.data.object_tree import Part, Velodyne


def health(
    data: Path,
    *,
    sample_list: str | None = None,
    velodyne: Velodyne | None = None,
    limits: Path | None = None,
    picture: Path | None = None,
    json: Path | None = None,
) -> None:
    """Judges camera, LiDAR and their alignment along a drive, without a model of the sensors.

    Prints the time line: scores from 1 (nothing is wrong) to 0 (nothing was delivered), below 0.5
    as bad as one sound frame in a hundred; alarms, which take two bad frames in a row to be raised
    (one, if nothing was delivered) and five good ones to be taken back; the LiDAR's turn about z
    [degrees].

    Args:
        data: A recording, KITTI object tree, depth completion tree or raw drive; its frames in
            their order.
        sample_list: Which frames: kitti-object-train, kitti-object-val, a list in ImageSets or a
            text file with one name a line. Default: all.
        velodyne: Folder of the sweeps in an object tree. Default: velodyne, or else
            velodyne_reduced.
        limits: What is usual of these sensors, by `health-limits`. Default: of simulated ones.
        picture: PNG for the time line and for where sensors were bad.
        json: File for all scores, the worst checks, alarms and regions.
    """
    check_places({"--json": json, "--picture": picture}, data=[data, limits])
    from sightline.data.image_file import write_rgb
    from sightline.data.open import open_dataset
    from sightline.data.progress import track
    from sightline.health.limits import SHIPPED, read_limits
    from sightline.health.monitor import HealthMonitor
    from sightline.health.report import HealthReport
    from sightline.health.sequence import DriveMonitor
    from sightline.visualization.health_timeline import draw_health

    monitor = DriveMonitor(HealthMonitor(read_limits(limits or SHIPPED)))
    sensors: tuple[Part, ...] = ("image", "points")
    dataset = open_dataset(
        data, sample_list=sample_list, velodyne=velodyne, parts=sensors, needs=()
    )
    samples = (dataset[index] for index in range(len(dataset)))
    shown = track(samples, description="looking at sensors", total=len(dataset))
    report = HealthReport(frames=tuple(monitor(sample) for sample in shown))
    if picture is not None:
        write_rgb(picture, draw_health(report.frames))
        say(picture)
    deliver(report, json)
    if limits is None and report.is_short_of_rings:
        warnings.warn(
            "every sweep has fewer rings than 64 beams make, which the limits are for; if that "
            "is how your LiDAR is, its scores say nothing: fit limits of your own by "
            "sightline health-limits and give them by --limits",
            stacklevel=2,
        )
    if limits is None and report.is_short_of_noise:
        warnings.warn(
            "most images lack a sensor's noise, by which dirt is told; where your camera saves "
            "JPEG, which takes it away, its scores say nothing: fit limits of your own by "
            "sightline health-limits and give them by --limits",
            stacklevel=2,
        )


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
    """Fits what is usual of sound sensors: limits that one clean frame in a hundred goes beyond.

    Args:
        data: A recording, KITTI object tree or raw drive of sound sensors like those to be judged.
        out: JSON file to write, for `sightline health --limits`.
        sample_list: Which frames it is drawn from. Default: all.
        velodyne: Folder of the sweeps: whole ones, where whole ones are to be judged. Default:
            velodyne, or else velodyne_reduced.
        frames: How many are looked at, at most.
        seed: Of the drawing.
        transfer: Widens the limits so that they serve sensors of other makes, too, as those that
            come with Sightline.
    """
    check_places({"OUT": out}, data=[data])
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
