"""How KITTI's car carries its LiDAR; apart from the rest, which needs PyTorch."""

from typing import Final

KITTI_LIDAR_HEIGHT_M: Final = 1.73
"""Height of KITTI's LiDAR above the road (Geiger et al. 2013, Fig. 3)."""
