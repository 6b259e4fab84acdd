"""Predictor for 3D detection in sweeps."""

import warnings
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.object_tree import Part
from sightline.detection3d.alignment import align
from sightline.detection3d.detector_config import SweepConfig
from sightline.detection3d.model import Detector3D
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.runners import StageRunners
from sightline.detection3d.stages import Sweep
from sightline.detection3d.sweeps import (
    at_kitti_height,
    cut_to_view,
    draw_points,
    in_own_frame,
    points_in_range,
)
from sightline.export.names import EngineChoice, EngineName
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.network import LoadedNetwork, load_network
from sightline.inference.sample_predictor import SamplePredictor
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample

_SEED: Final = 0  # for drawing points: results are reproducible
_MANY_POINTS, _LEAST_SHARE = 1000, 0.01  # of many points, the least share in range


class Detection3DPredictor(SamplePredictor[Detections3D]):
    """Detect road users in LiDAR sweeps with a trained network.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> found = sightline.Detection3DPredictor.load("detection3d-best")(sample)
        >>> found.class_names[:2], found.boxes.tensor.shape[1]  # by descending score; see Boxes3D
        (('Car', 'Car'), 7)

    Takes sweeps with any number of points and beams, from LiDARs mounted at any height above the
    road, tilted or turned, if the sample contains the mount. Boxes are in the LiDAR's own frame. A
    sweep without points in range has no objects. May be pickled, and called in a forked process.
    """

    parts: tuple[Part, ...] = ("points",)
    needs: tuple[Part, ...] = ("points",)
    gives: tuple[str, ...] = ("results",)

    @named_arguments
    def __init__(
        self,
        loaded: LoadedNetwork[Detector3D],
        *,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        """Take a network; `load` takes the name of its weights.

        Args:
            loaded: The network.
            engine: Inference engine.
            device: cpu or cuda.
            threads: CPU threads; None: the engine's own choice.

        Raises:
            ValueError: The engine is not installed or cannot run on the device.
        """
        self.name = loaded.name
        self.sha256 = loaded.sha256
        self._config = loaded.network.config
        self._stages = StageRunners(loaded, engine=engine, device=device, threads=threads)
        self.engine: EngineName = self._stages.engine

    @classmethod
    def load(
        cls,
        weights: str | Path,
        *,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Detection3DPredictor":
        """Load weights by name or from a file, and make a predictor.

        Raises:
            ValueError: See `load_network` and the constructor.
        """
        return cls(
            load_network(NETWORK_TASK, weights), engine=engine, device=device, threads=threads
        )

    @property
    def made_by(self) -> dict[str, str]:
        """Entries of a manifest besides the name."""
        return {"weights_sha256": self.sha256, "engine": self.engine}

    def predict(self, sample: CameraLidarSample) -> Detections3D:
        """Detect in a sample's sweep; warn if its axes seem wrong for the LiDAR frame.

        Raises:
            ValueError: The sample has no sweep, or points that are not finite.
        """
        return self.both_stages(sample)[1]

    def both_stages(self, sample: CameraLidarSample) -> tuple[Detections3D, Detections3D]:
        """Compute proposals and detections of a sample; see `predict`.

        Raises:
            ValueError: See `predict`.
        """
        sweep = network_sweep(at_kitti_height(sample), self._config.input)
        proposed = self._stages.propose(sweep)
        answers = self._stages.proposals(proposed), self._stages.refine(sweep, proposed)
        first, second = (
            in_own_frame(align(each, self._config.alignment), sample) for each in answers
        )
        return first, second


def network_sweep(sample: CameraLidarSample, settings: SweepConfig) -> Sweep:
    """Prepare a sample's sweep for a network at inference; warn as `predict` does.

    Raises:
        ValueError: See `predict`.
    """
    shown = cut_to_view(sample, settings).points
    assert shown is not None, "checked when it was cut"
    assert sample.points is not None, "likewise"
    seen = points_in_range(shown, settings)
    if len(sample.points) >= _MANY_POINTS and len(seen) < _LEAST_SHARE * len(sample.points):
        warnings.warn(
            f"of the {len(sample.points)} points of sample {sample.sample_id} only {len(seen)} lie "
            "where the network looks: are its axes x forward, y left, z up, in metres from the "
            "LiDAR?",
            stacklevel=2,
        )
    return draw_points(seen, settings, np.random.default_rng(_SEED))
