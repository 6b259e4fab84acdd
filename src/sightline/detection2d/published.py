"""Published results on KITTI's val split: cars, IoU 0.7, 11-point AP.

Kim et al. 2018, "Robust Camera Lidar Sensor Fusion Via Deep Gated Information Fusion Network",
Tables I and II; results of early and late fusion are from the same group's "Robust Deep Multi-modal
Learning Based on Gated Information Fusion Network" (arXiv:1807.06233), which repeats Table I.
"""

from typing import Final

from sightline.corruptions.suites import CLEAN
from sightline.detection2d.config import Fusion

Levels = tuple[float, float, float]
"""Results for the difficulties easy, moderate and hard, percent."""

FULL: Final = "full"
"""Row with the mean over all cases."""

TABLE_1: Final[dict[Fusion, dict[str, Levels]]] = {
    "gated": {
        FULL: (93.95, 86.70, 78.05),
        CLEAN: (98.69, 90.31, 82.16),
        "camera_blank": (88.86, 78.12, 69.68),
        "lidar_blank": (97.39, 90.29, 81.84),
        "camera_occlusion": (89.88, 88.12, 79.03),
        "lidar_occlusion": (97.72, 90.23, 81.94),
        "camera_noise": (89.33, 80.15, 71.12),
        "camera_illumination": (95.82, 89.71, 80.58),
    },
    "ones": {
        FULL: (89.86, 82.21, 72.21),  # as printed; the mean of the rows is 72.72
        CLEAN: (93.61, 87.01, 77.52),
        "camera_blank": (86.56, 74.30, 64.71),
        "lidar_blank": (91.88, 88.10, 78.68),
        "camera_occlusion": (88.12, 78.52, 68.85),
        "lidar_occlusion": (92.75, 87.10, 77.67),
        "camera_noise": (86.75, 75.13, 65.71),
        "camera_illumination": (89.37, 85.31, 75.87),
    },
    "early": {
        FULL: (91.10, 85.75, 75.83),
        CLEAN: (95.84, 89.94, 79.67),
        "camera_blank": (89.94, 78.99, 69.56),
        "lidar_blank": (90.48, 88.56, 77.92),
        "camera_occlusion": (90.22, 84.15, 73.93),
        "lidar_occlusion": (90.53, 88.91, 79.07),
        "camera_noise": (90.18, 81.29, 72.04),
        "camera_illumination": (90.48, 88.42, 78.60),
    },
    "late": {
        FULL: (89.69, 82.03, 72.96),
        CLEAN: (91.72, 87.93, 78.46),
        "camera_blank": (87.92, 77.83, 69.11),
        "lidar_blank": (93.31, 89.27, 80.03),
        "camera_occlusion": (91.78, 88.22, 78.80),
        "lidar_occlusion": (84.80, 74.88, 66.33),
        "camera_noise": (88.67, 76.12, 67.18),
        "camera_illumination": (89.69, 79.96, 70.82),
    },
}
"""Results by fusion type, then by case."""

TABLE_2: Final[dict[Fusion, tuple[str, str, Levels]]] = {
    "camera": ("SSD", "camera", (90.27, 87.87, 79.29)),
    "lidar": ("SSD", "LiDAR", (89.11, 77.92, 68.87)),
    "gated": ("DGFN", "LiDAR and camera", (98.69, 90.31, 82.16)),
}
"""Method, sensors and results of the methods that we have networks for."""

TABLE_2_PEERS: Final[tuple[tuple[str, str, Levels], ...]] = (
    ("3DOP", "stereo", (94.49, 89.65, 80.97)),
    ("Mono3D", "camera", (95.75, 90.01, 80.66)),
    ("Deep MANTA", "camera", (97.58, 90.89, 82.72)),
    ("MV3D", "LiDAR and camera", (95.01, 87.59, 79.90)),
)
"""Method, sensors and results of the other methods."""
