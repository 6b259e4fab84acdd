"""Registration of 3D detection as a task of `sightline.tasks`.

The command line imports it for `--help`, so heavy modules are imported where they are used.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from sightline.detection3d.network_task import Detection3DNetworkTask
from sightline.inference.predictor import Output, OutputFilter

if TYPE_CHECKING:
    from sightline.detection3d.detector import Detector3D
    from sightline.detection3d.predictor import Detection3DPredictor
    from sightline.export.graph import ExportGraph
    from sightline.export.names import EngineChoice
    from sightline.inference.demo import DemoPart
    from sightline.inference.network import LoadedNetwork
    from sightline.robustness.object_scoring import ObjectScoring
    from sightline.structures.predictions import Detections3D, Perception
    from sightline.structures.sample import CameraLidarSample


def _write_results(path: Path, sample: "CameraLidarSample", detections: "Detections3D") -> None:
    from sightline.detection3d.files import write_results

    write_results(path, sample, detections)


def _read_results(
    path: Path, sample: "CameraLidarSample", perception: "Perception"
) -> "Perception":
    from sightline.detection3d.files import read_results

    return read_results(path, sample, perception)


class Detection3DTask(Detection3DNetworkTask):
    """`sightline.tasks.Task` by networks that use the LiDAR alone."""

    summary: Final = "Detects road users in 3D in LiDAR sweeps and writes KITTI's result files."
    training_class: Final = "sightline.detection3d.task.Detection3D"
    trial_settings: Final = {
        "model.init_args.stages": "both",
        "model.init_args.network.input.num_points": "256",
        "model.init_args.network.pooling.num_points": "16",
        "model.init_args.loss.sampling.num_samples": "8",
        "model.init_args.loss.sampling.max_foreground": "4",
        "data.init_args.training": "[{path: ., sample_list: train}]",
        "data.init_args.validation": "[{path: ., sample_list: val}]",
    }
    default_weights: str = "detection3d-best"
    methods: tuple[str, ...] = ()
    outputs: tuple[Output, ...] = (
        Output(
            name="results",
            suffix=".txt",
            summary="KITTI's result files, with 3D boxes, their projections and scores.",
            write=_write_results,
            read=_read_results,
        ),
    )
    switches: tuple[OutputFilter, ...] = ()

    def graphs(self, loaded: "LoadedNetwork[Detector3D]") -> "tuple[ExportGraph, ...]":
        """Export one graph for each stage: proposals, and refinement if there is one."""
        from sightline.detection3d.export_graph import export_graphs

        return export_graphs(loaded)

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: "EngineChoice" = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Detection3DPredictor":
        """Load a predictor with the named or default weights.

        Raises:
            ValueError: A method is named, or as `Detection3DPredictor.load`.
        """
        from sightline.detection3d.predictor import Detection3DPredictor
        from sightline.files.plain_text import shortened

        if method is not None:
            raise ValueError(
                f"detection3d has no method '{shortened(method)}': it predicts by a network; leave "
                "the method out, or name weights instead"
            )
        return Detection3DPredictor.load(
            self.default_weights if weights is None else weights,
            engine=engine,
            device=device,
            threads=threads,
        )

    def scoring(self) -> "ObjectScoring":
        """Scoring by KITTI's evaluation of 3D boxes."""
        from sightline.detection3d.robustness import SCORING

        return SCORING

    def perception(self, prediction: "Detections3D") -> "Perception":
        """Wrap the detections."""
        from sightline.structures.predictions import Perception

        return Perception(detections3d=prediction)

    def demo(self, frames: Path, out: Path) -> "DemoPart":
        """Run `run_detection3d_demo`."""
        from sightline.detection3d.demo import run_detection3d_demo

        return run_detection3d_demo(self, self.predictor(threads=1), frames, out)


TASK: Final = Detection3DTask()
