"""Simulated samples without files; the only module of the simulator that needs PyTorch."""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch.utils.data import Dataset

from sightline.data.formats.kitti_conversion import labels_from_kitti
from sightline.data.formats.pixels import crop_to_view
from sightline.geometry.arguments import sample_index
from sightline.geometry.calibration import Calibration
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import SimulatedFrame, StreetMaker, simulate_frame
from sightline.simulation.street import make_street
from sightline.structures.level import level_calibration, level_from_mount, mounted_labels
from sightline.structures.sample import CameraLidarSample


def sample_of(frame: SimulatedFrame) -> CameraLidarSample:
    """Convert a frame to a sample with labels, dense depth, pose, time and the complete sweep."""
    image = None if frame.image is None else np.ascontiguousarray(frame.image.transpose(2, 0, 1))
    calibration = Calibration(
        image_from_camera=torch.tensor(frame.calibration.image_from_camera),  # shared by frames
        camera_from_lidar=torch.tensor(frame.calibration.camera_from_lidar),
    )
    pose = frame.lidar_pose
    level_from_lidar = level_from_mount(calibration, None if pose is None else pose.tilt)
    level = level_calibration(calibration, level_from_lidar)
    return CameraLidarSample(
        sample_id=frame.sample_id,
        calibration=calibration,
        image_size=frame.image_size,
        image=None if image is None else torch.from_numpy(image),
        points=torch.from_numpy(frame.points),
        objects=mounted_labels(labels_from_kitti(frame.objects, level), level_from_lidar),
        depth=torch.from_numpy(frame.depth_m),
        world_from_lidar=torch.from_numpy(frame.world_from_lidar),
        timestamp_s=frame.time_s,
        lidar_height_m=None if pose is None else pose.height_m,
        level_from_lidar=level_from_lidar,
    )


@dataclass(frozen=True, slots=True)
class SimulatedDataset(Dataset[CameraLidarSample]):
    """Data set without files: samples are simulated on access."""

    num_frames: int
    config: SimulationConfig = field(default_factory=SimulationConfig)
    streets: StreetMaker = make_street

    def __post_init__(self) -> None:
        """Check the number of frames."""
        if self.num_frames < 0:
            raise ValueError(f"num_frames must not be negative, got {self.num_frames}")

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Sample names, in order."""
        return tuple(f"{index:06d}" for index in range(self.num_frames))

    def __len__(self) -> int:
        """Number of samples."""
        return self.num_frames

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Simulate a sample with the points in the camera's view, as in KITTI's reduced sweeps.

        Raises:
            IndexError: There is no such sample.
        """
        index = sample_index(index, self.num_frames)
        frame = simulate_frame(self.config, index, self.streets)
        seen = crop_to_view(frame.points, frame.calibration, frame.image_size)
        return sample_of(replace(frame, points=seen, sample_id=self.sample_ids[index]))
