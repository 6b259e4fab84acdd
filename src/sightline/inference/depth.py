"""Depth completion of a sample by a named method."""

from dataclasses import dataclass

from sightline.depth_completion.methods import Method, complete_depth
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, slots=True)
class DepthCompleter:
    """Completes the depth that a sample's sweep gives its image, at the image's full size."""

    method: Method

    def __call__(self, sample: CameraLidarSample) -> DepthMap:
        """Projects the sweep and completes what it gives.

        Raises:
            ValueError: The sample has no sweep.
        """
        if sample.points is None:
            raise ValueError(
                f"sample {sample.sample_id} has no sweep, so there is no depth to complete; give "
                "data with LiDAR points"
            )
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        return complete_depth(sparse, self.method)
