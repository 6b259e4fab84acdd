"""Data set of the depth completion benchmark: sparse depth maps, images, denser ground truth."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, Float64
from torch import Tensor
from torch.utils.data import Dataset

from sightline.data.checks.calibration_judge import CalibrationJudge
from sightline.data.checks.entry_checks import select_spread
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    check_intrinsics,
    read_intrinsics,
    read_rectified_intrinsics,
)
from sightline.data.formats.kitti_files import read_depth, read_image
from sightline.data.layouts.frame_lists import GapsError
from sightline.data.layouts.kitti_trees import (
    RAW_CALIBRATION,
    Camera,
    DepthFrame,
    DriveSplit,
    SelectedSplit,
    describe_absent,
    list_drive_frames,
    list_selected_frames,
)
from sightline.files.problem import FileError, read_or_note
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import sample_index
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import unproject_pixels
from sightline.jobs.worker import keep_opencv_to_one_thread_in_workers
from sightline.structures.sample import CameraLidarSample

_NOMINAL_CAMERA_FROM_LIDAR = (
    (0.0, -1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0, 0.0),
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
)


class KittiDepthDataset(Dataset[CameraLidarSample]):
    """Frames of KITTI's depth completion benchmark (Uhrig et al. 2017, arXiv:1708.06500).

    The benchmark contains the sweeps only as projected, sparse depth maps. A sample's `points` are
    their unprojected pixels, with reflectance 0, in a LiDAR frame with nominal axes at the camera's
    centre: `sparse_depth_map` restores the same map exactly. `depth` is the ground truth; None in
    the test split.

    `list_drive_frames` (train, val) and `list_selected_frames` (the other two) document the layout.
    """

    def __init__(
        self,
        root: Path | str,
        split: DriveSplit | SelectedSplit = "val_selection_cropped",
        *,
        raw_root: Path | str | None = None,
        cameras: Sequence[Camera] = ("image_02",),
        load_images: bool = True,
        allow_gaps: bool = False,
    ) -> None:
        """List the files.

        Args:
            root: Folder of the benchmark's extracted archives.
            split: Split of the frames.
            raw_root: Folder of the raw recordings, with one folder per day; None: `root`. Source of
                images and intrinsics of `train` and `val`.
            cameras: Left and right colour camera, for `train` and `val`; the other two splits are
                used completely.
            load_images: Whether samples contain an image.
            allow_gaps: Whether a frame may lack its image or its truth, which is then None.

        Raises:
            ValueError: There are no frames, or some lack a part.
        """
        self.root = data_path(root)
        self.split = split
        self.load_images = load_images
        if split == "train" or split == "val":  # mypy narrows by `==` only
            raw = self.root if raw_root is None else data_path(raw_root)
            frames = list_drive_frames(self.root, split, raw, cameras)
        else:
            frames = list_selected_frames(self.root, split)
        if not frames:
            raise ValueError(
                f"{self.root} holds no frames of {split}, expected the tree of KITTI's depth "
                "completion benchmark; give the folder of its extracted archives"
            )
        source = f" ({RAW_CALIBRATION[0]})" if frames[0].camera is not None else ""
        needed = {"sparse": "velodyne_raw", "intrinsics": f"intrinsics{source}"}
        if load_images and not allow_gaps:
            needed["image"] = "image"
        if split != "test_depth_completion_anonymous" and not allow_gaps:
            needed["truth"] = "groundtruth"
        _check_complete(self.root, frames, needed)
        self.frames = tuple(frames)
        self._judge = CalibrationJudge()
        for frame in select_spread(self.frames):
            intrinsics = read_or_note(partial(_read_intrinsics, frame), frame.intrinsics, [])
            if intrinsics is not None:
                self._judge.skip(intrinsics, read_or_note(read_image_size, frame.sparse, []))

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the frames, e.g. "2011_09_26_drive_0002_sync_image_0000000005_image_02"."""
        return tuple(frame.sample_id for frame in self.frames)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a frame.

        Raises:
            IndexError: There is no such frame.
            FileError: A file is invalid, or the sizes of its maps and its image differ; the error
                names it.
        """
        keep_opencv_to_one_thread_in_workers()
        index = sample_index(index, len(self))
        frame = self.frames[index]
        assert frame.sparse is not None, f"{frame.sample_id} passed the check without a sparse map"
        sparse = read_depth(frame.sparse)
        height, width = sparse.shape
        image = read_image(frame.image) if frame.image is not None and self.load_images else None
        truth = None if frame.truth is None else read_depth(frame.truth)
        for picture, path in ((image, frame.image), (truth, frame.truth)):
            if picture is not None and path is not None and picture.shape[-2:] != sparse.shape:
                raise FileError(
                    path,
                    f"is {picture.shape[-2]}x{picture.shape[-1]} (height x width), expected "
                    f"{height}x{width} like {frame.sparse}",
                    "extract both again",
                )
        path = frame.intrinsics
        assert path is not None, f"{frame.sample_id} passed the check without intrinsics"
        intrinsics, size = _read_intrinsics(frame, path), (height, width)
        self._judge.judge(
            intrinsics,
            size,
            lambda: check_intrinsics(intrinsics, size, path, picture=frame.image),
        )
        calibration = _calibration_of(intrinsics)
        return CameraLidarSample(
            sample_id=frame.sample_id,
            calibration=calibration,
            image_size=(height, width),
            image=image,
            points=points_from_depth_map(sparse, calibration),
            depth=truth,
        )


def points_from_depth_map(
    depth_m: Float32[Tensor, "height width"], calibration: Calibration
) -> Float32[Tensor, "num_points 4"]:
    """Unproject pixels with a depth [m] to LiDAR-frame points with reflectance 0, row by row."""
    rows, columns = depth_m.nonzero(as_tuple=True)
    pixels = torch.stack((columns, rows), dim=-1).double()
    points = unproject_pixels(pixels, depth_m[rows, columns].double(), calibration)
    return torch.nn.functional.pad(points.float(), (0, 1))


def _read_intrinsics(frame: DepthFrame, path: Path) -> Float64[np.ndarray, "3 3"]:
    if frame.camera is None:
        return read_intrinsics(path)
    return read_rectified_intrinsics(path, int(frame.camera[-2:]))


def _calibration_of(intrinsics: Float64[np.ndarray, "3 3"]) -> Calibration:
    return Calibration(
        # The maps are relative to their own camera, so the rectified baseline is not used.
        image_from_camera=torch.from_numpy(np.hstack((intrinsics, np.zeros((3, 1))))),
        camera_from_lidar=torch.tensor(_NOMINAL_CAMERA_FROM_LIDAR, dtype=torch.float64),
    )


def _check_complete(root: Path, frames: Sequence[DepthFrame], needed: dict[str, str]) -> None:
    for part, folder in needed.items():
        absent = [frame.sample_id for frame in frames if getattr(frame, part) is None]
        if absent:
            may_lack = part in ("image", "truth")
            or_list = ", or name a list of the complete frames" if may_lack else ""
            raise GapsError(
                f"{root} is incomplete: {folder} lacks {len(absent)} of {len(frames)} frames "
                f"({describe_absent(absent)})",
                f"extract the missing archive{or_list}",
            )
