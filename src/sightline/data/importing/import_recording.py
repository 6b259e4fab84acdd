"""`sightline import`: convert drives of other formats to recordings."""

from pathlib import Path
from typing import Final

from sightline.data.formats.recording_calibration import read_recording_calibration
from sightline.data.importing.bag import is_bag
from sightline.data.importing.bag_clocks import Clock
from sightline.data.importing.bag_files import SUFFIXES, unread_bag
from sightline.data.importing.import_bag import import_bag
from sightline.data.importing.import_nuscenes import import_nuscenes
from sightline.data.importing.nuscenes import find_tables
from sightline.data.importing.writer import ImportReport
from sightline.files.byte_source import url_of
from sightline.files.problem import refuse_without_effect, shown_place
from sightline.geometry.wrong_types import named_arguments

_MAX_GAP_S: Final = 0.05


@named_arguments
def import_recording(
    source: Path | str,
    out: Path | str,
    *,
    camera_topic: str | None = None,
    lidar_topic: str | None = None,
    info_topic: str | None = None,
    calibration: Path | str | None = None,
    max_gap_s: float = _MAX_GAP_S,
    clock: Clock = "header",
    undistort: bool = False,
    max_intensity: float | None = None,
) -> ImportReport:
    """Convert a ROS bag, an MCAP file or nuScenes to a recording for all commands.

    Frames are written atomically, and existing ones are skipped: to resume a stopped import, run it
    again. A bag that was replaced, or has further files, needs another folder. If the camera points
    away from the LiDAR's x axis by more than 5 degrees, clouds are rotated about z until it looks
    ahead.

    Examples:
        >>> import pathlib, sightline
        >>> sightline.import_recording("drive.mcap", "recording")
        Traceback (most recent call last):
        ValueError: drive.mcap does not exist; name a bag or a folder of nuScenes

    Args:
        source: A ROS 2 bag (its folder, .mcap or .db3), a ROS 1 .bag, or the folder of nuScenes
            with the tables of v1.0-mini or another version.
        out: Folder for the recording.
        camera_topic: Topic of the images, or nuScenes' channel (CAM_FRONT). None: the only one.
        lidar_topic: Topic of the clouds, or channel (LIDAR_TOP). None: the only one.
        info_topic: Topic of CameraInfo. None: the one beside the images.
        calibration: A recording's calibration file instead of a bag's CameraInfo and TF.
        max_gap_s: Largest time difference of an image and a sweep of a bag.
        clock: Clock for pairing in a bag; see `choose_clock`.
        undistort: Whether to undistort images of a distorting lens when they are read.
        max_intensity: Intensity of a reflectance of 1. None: 1, 255, 1023, 4095 or 65535, guessed
            from some sweeps.

    Raises:
        ValueError: The source cannot be read, is incomplete or ambiguous; an option has no effect
            on it; or `out` contains another import.
    """
    source, out = Path(source), Path(out)
    if url_of(source) is not None:
        raise ValueError(
            f"{shown_place(source)} is an address, and import reads files of this machine; copy it"
        )
    if not source.exists():
        raise ValueError(f"{source} does not exist; name a bag or a folder of nuScenes")
    _check_numbers(max_gap_s, max_intensity)
    if is_bag(source):
        refuse_without_effect(
            "with --calibration, which has the camera's matrix and lens",
            info_topic=calibration is not None and info_topic is not None,
            undistort=calibration is not None
            and undistort
            and read_recording_calibration(calibration).lens is None,
        )
        return import_bag(
            source,
            out,
            camera_topic=camera_topic,
            lidar_topic=lidar_topic,
            info_topic=info_topic,
            calibration=None if calibration is None else Path(calibration),
            max_gap_s=max_gap_s,
            clock=clock,
            undistort=undistort,
            max_intensity=max_intensity,
        )
    tables = find_tables(source)
    if tables is None and (fault := unread_bag(source)) is not None:
        raise fault
    bags = sorted(each for each in source.iterdir() if is_bag(each)) if source.is_dir() else []
    if tables is None and bags:
        more = f", and {len(bags) - 1} more" if len(bags) > 1 else ""
        raise ValueError(
            f"{source} is no bag itself, but {bags[0]} in it is one{more}; import that, or put the "
            "files of one drive's recorders into one folder without metadata.yaml"
        )
    if tables is None:
        raise ValueError(
            f"{source} is neither a bag (a folder with metadata.yaml, or a file that ends in "
            f"{', '.join(SUFFIXES)}) nor nuScenes (a folder with v1.0-mini/sample.json); a folder "
            "of images and clouds needs no import, see docs/recordings.md"
        )
    refuse_without_effect(
        "on nuScenes, whose tables have calibrations and pairs",
        calibration=calibration is not None,
        info_topic=info_topic is not None,
        clock=clock != "header",
        max_gap_s=max_gap_s != _MAX_GAP_S,
    )
    return import_nuscenes(
        tables,
        out,
        camera=camera_topic or "CAM_FRONT",
        lidar=lidar_topic or "LIDAR_TOP",
        max_intensity=max_intensity or 255.0,
        undistort=undistort,
    )


def _check_numbers(max_gap_s: float, max_intensity: float | None) -> None:
    """Refuse numbers out of range."""
    if not 0 <= max_gap_s < 10:
        raise ValueError(f"max_gap_s must be between 0 and 10, got {max_gap_s}; often it is 0.05")
    if max_intensity is not None and not 0 < max_intensity < 1e9:
        raise ValueError(f"max_intensity must be positive, got {max_intensity}; often it is 255")
