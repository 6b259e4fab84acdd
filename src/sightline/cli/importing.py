"""`sightline import`: convert drives of other formats to recordings."""

from pathlib import Path
from typing import Literal

from sightline.cli.output import say
from sightline.jobs.output_dirs import check_outputs


def import_command(
    source: Path,
    out: Path,
    *,
    camera_topic: str | None = None,
    lidar_topic: str | None = None,
    info_topic: str | None = None,
    calibration: Path | None = None,
    max_gap_s: float = 0.05,
    clock: Literal["header", "received"] = "header",
    undistort: bool = False,
    max_intensity: float | None = None,
) -> None:
    """Convert a ROS 2 bag, an MCAP file or nuScenes to a recording for all other commands.

    Reports pairs, dropped data, and the share of the points inside the image. To resume an
    interrupted run, run it again. Bags need `pip install '.[ros]'`.

    Args:
        source: A bag (its folder, .mcap, .db3 or ROS 1's .bag), or the folder of nuScenes with the
            tables of v1.0-mini or another version.
        out: Folder for the recording.
        camera_topic: Topic of the images, or nuScenes' channel. Default: the only one; CAM_FRONT.
        lidar_topic: Topic of the clouds, or nuScenes' channel. Default: the only one; LIDAR_TOP.
        info_topic: Topic of CameraInfo in a bag. Default: the one beside the images.
        calibration: A calibration file (docs/recordings.md) instead of a bag's CameraInfo and TF.
        max_gap_s: Largest time difference of an image and a sweep of a bag.
        clock: Clock for pairing in a bag: the header's time of measurement, or the time of receipt.
        undistort: Undistorts the images of a distorting lens whenever they are read.
        max_intensity: Intensity of a reflectance of 1. Default: 1, 255, 1023, 4095 or 65535,
            guessed from some sweeps.
    """
    check_outputs({"OUT": out}, data=[source, calibration])
    from sightline.data.importing.import_recording import import_recording

    report = import_recording(
        source,
        out,
        camera_topic=camera_topic,
        lidar_topic=lidar_topic,
        info_topic=info_topic,
        calibration=calibration,
        max_gap_s=max_gap_s,
        clock=clock,
        undistort=undistort,
        max_intensity=max_intensity,
    )
    say(*str(report).split("\n"))
