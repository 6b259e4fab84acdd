"""Lists the files of the depth completion benchmark's tree without reading them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.data.object_tree import list_files

DriveSplit = Literal["train", "val"]
SelectedSplit = Literal["val_selection_cropped", "test_depth_completion_anonymous"]
Camera = Literal["image_02", "image_03"]

_DATE_LENGTH = len("2011_09_26")


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthFrame:
    """Files of one frame; None: missing."""

    sample_id: str
    image: Path | None
    sparse: Path | None
    """Sparse depth map, the projected sweep."""
    truth: Path | None
    intrinsics: Path | None
    """File of nine numbers; or a `calib_cam_to_cam.txt` if `camera` is given."""
    camera: Camera | None = None


def list_drive_frames(
    root: Path, split: DriveSplit, raw_root: Path, cameras: Sequence[Camera]
) -> list[DepthFrame]:
    """List all frames of `train` or `val` with a sparse map or a ground truth, in order.

    Searches DRIVE/proj_depth/{groundtruth,velodyne_raw}/CAMERA/N.png below `root`/SPLIT and below
    that folder in `data_depth_annotated` and `data_depth_velodyne`; images and calibration in
    `raw_root` as DATE/DRIVE/CAMERA/data/N.png and DATE/calib_cam_to_cam.txt.
    """
    bases = drive_bases(root, split)
    drives = sorted(
        {path.parent.name for base in bases for path in base.glob("*/proj_depth") if path.is_dir()}
    )
    return [
        frame
        for drive in drives
        for camera in cameras
        for frame in _frames_of_drive(drive, bases, raw_root / drive[:_DATE_LENGTH], camera)
    ]


def drive_bases(root: Path, split: DriveSplit) -> list[Path]:
    """List the possible parent folders of drives."""
    return [
        root / archive / split for archive in ("", "data_depth_annotated", "data_depth_velodyne")
    ]


def selection_folder(root: Path, split: SelectedSplit) -> Path:
    """Folder of a selection: in `root`, in its folder depth_selection, or `root` itself."""
    candidates = (root / split, root / "depth_selection" / split, root)
    return next((base for base in candidates if (base / "velodyne_raw").is_dir()), candidates[0])


def list_selected_frames(root: Path, split: SelectedSplit) -> list[DepthFrame]:
    """List all frames of a selection, in order.

    The files are image/N.png, velodyne_raw/N.png, intrinsics/N.txt and, for validation,
    groundtruth_depth/N.png. N of the cropped selection contains the kind of file:
    DRIVE_image_FRAME_CAMERA, DRIVE_velodyne_raw_FRAME_CAMERA, DRIVE_groundtruth_depth_FRAME_CAMERA.
    """
    folder = selection_folder(root, split)
    images = list_files(folder / "image", IMAGE_SUFFIXES)
    intrinsics = list_files(folder / "intrinsics", (".txt",))
    sparse = _renamed(list_files(folder / "velodyne_raw", (".png",)), "_velodyne_raw_")
    truth = _renamed(list_files(folder / "groundtruth_depth", (".png",)), "_groundtruth_depth_")
    return [
        DepthFrame(
            sample_id=name,
            image=images.get(name),
            sparse=sparse.get(name),
            truth=truth.get(name),
            intrinsics=intrinsics.get(name),
        )
        for name in sorted({*images, *sparse, *truth})
    ]


def _frames_of_drive(
    drive: str, bases: Sequence[Path], day: Path, camera: Camera
) -> list[DepthFrame]:
    sparse: dict[str, Path] = {}
    truth: dict[str, Path] = {}
    for base in bases:
        maps = base / drive / "proj_depth"
        sparse |= list_files(maps / "velodyne_raw" / camera, (".png",))
        truth |= list_files(maps / "groundtruth" / camera, (".png",))
    images = list_files(day / drive / camera / "data", IMAGE_SUFFIXES)
    calibration = day / "calib_cam_to_cam.txt"
    return [
        DepthFrame(
            sample_id=f"{drive}_image_{number}_{camera}",
            image=images.get(number),
            sparse=sparse.get(number),
            truth=truth.get(number),
            intrinsics=calibration if calibration.is_file() else None,
            camera=camera,
        )
        for number in sorted({*sparse, *truth})
    ]


def _renamed(files: dict[str, Path], kind: str) -> dict[str, Path]:
    return {name.replace(kind, "_image_"): path for name, path in files.items()}
