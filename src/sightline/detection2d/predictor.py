"""Predictor for 2D detection."""

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float32
from torch import Tensor

from sightline.data.layouts.kitti_trees import Part
from sightline.detection2d.config import Fusion
from sightline.detection2d.export_graph import export_graph
from sightline.detection2d.model import Detector
from sightline.detection2d.network_task import NETWORK_TASK
from sightline.detection2d.placement import candidates, suppressed
from sightline.detection2d.views import gate_over_frame, views_of
from sightline.export.names import EngineChoice, EngineName
from sightline.export.process_engine import ProcessEngine
from sightline.geometry.checked import checked
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.network import LoadedNetwork
from sightline.inference.network_predictor import NetworkPredictor
from sightline.structures.predictions import Detections2D
from sightline.structures.sample import CameraLidarSample, check_points


@checked()
@dataclass(frozen=True, kw_only=True, slots=True)
class DetectionResult:
    """Detections and gates of a frame."""

    detections: Detections2D
    """Detections in the frame's pixels, by descending score."""
    camera_gate: Float32[Tensor, "rows columns"] | None = None
    """Camera gate over the frame, from 0 (the camera's features are not used) to 1, at the
    resolution of the network's finest map: that of the finest view, and 0 in rows that no view
    shows (`detection2d.views`); None for a network without gates."""
    lidar_gate: Float32[Tensor, "rows columns"] | None = None


def __getattr__(name: str) -> type[DetectionResult]:
    if name == "DetectorAnswer":
        warn_user("DetectorAnswer is now DetectionResult", DeprecationWarning)
        return DetectionResult
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class DetectionPredictor(NetworkPredictor[Detector, DetectionResult]):
    """Detect cars, pedestrians and cyclists with a trained network.

    Examples:
        >>> import dataclasses, sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> sample = sightline.open_dataset(PACKAGED_FRAMES)[0]
        >>> predictor = sightline.DetectionPredictor.load("detection2d-fast-cpu")
        >>> result = predictor(dataclasses.replace(sample, image=None))  # the camera is dead
        >>> "Car" in result.detections.class_names, float(result.camera_gate.max()) < 0.5
        (True, True)

    Takes images of any size and sweeps with any number of beams; of taller views than KITTI's, two
    bands along the horizon (`detection2d.views`). Either sensor may be missing; a
    black image or an empty sweep counts as missing. A network trained with faults can handle this.
    May be pickled, and called in a forked process.
    """

    network_task = NETWORK_TASK

    def _start(
        self,
        loaded: LoadedNetwork[Detector],
        engine: EngineChoice,
        device: str,
        threads: int | None,
    ) -> EngineName:
        self._config = loaded.network.config
        self._stride = loaded.network.stride
        self._smallest_px = loaded.network.smallest_px
        self._input_names = loaded.network.input_names
        self._run = ProcessEngine(export_graph(loaded), name=engine, device=device, threads=threads)
        return self._run.name

    @property
    def fusion(self) -> Fusion:
        """Fusion type of the network."""
        return self._config.fusion

    _PARTS: ClassVar[dict[str, Part]] = {"image": "image", "lidar": "points"}

    @property
    def parts(self) -> tuple[Part, ...]:
        """Parts of a sample that the network takes."""
        return tuple(self._PARTS[name] for name in self._input_names)

    @property
    def needs(self) -> tuple[Part, ...]:
        """Required parts: the sensor of a one-sensor network; networks of both need neither."""
        return self.parts if len(self.parts) == 1 else ()

    @property
    def gives(self) -> tuple[str, ...]:
        """Names of the task's outputs that the predictions contain."""
        return ("results", "gates") if self._config.fusion == "gated" else ("results",)

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> DetectionResult:
        """Detect in a sample.

        Raises:
            ValueError: The sample lacks all parts that the network takes, or has points that
                `check_points` refuses.
        """
        if all(getattr(sample, part) is None for part in self.parts):
            needed = " nor ".join(
                {"image": "image", "points": "sweep"}[part] for part in self.parts
            )
            raise ValueError(
                f"sample {sample.sample_id} has no {needed}, so nothing can be detected; give "
                "data with a sensor that the network takes"
            )
        check_points(sample)
        views = views_of(
            sample, self._config.input, stride=self._stride, smallest_px=self._smallest_px
        )
        found, gates = [], []
        for view in views:
            outputs = self._run(view.inputs(self._input_names, self._config.input, self._stride))
            on_cpu = {name: tensor[0].cpu() for name, tensor in outputs.items()}
            postprocess = self._config.postprocess
            best = candidates(on_cpu["scores"], on_cpu["boxes"], view.placement, postprocess)
            found.append(view.own(best))
            gates.append(on_cpu)
        laid = {
            name: gate_over_frame([each[name] for each in gates], views, self._stride)
            for name in ("camera_gate", "lidar_gate")
            if name in gates[0]
        }
        detections = suppressed(found, sample.image_size, self._config.postprocess)
        return DetectionResult(detections=detections, **laid)
