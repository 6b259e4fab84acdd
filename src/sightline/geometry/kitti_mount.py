"""LiDAR mount of KITTI's car; a separate module, since others need PyTorch."""

from typing import Final

KITTI_LIDAR_HEIGHT_M: Final = 1.73
"""Height of KITTI's LiDAR above the road (Geiger et al. 2013, Fig. 3)."""
