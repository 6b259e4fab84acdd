"""Registration of 3D detection as a task of `sightline.tasks`.

The command line imports it for `--help`, so heavy modules are imported where they are used.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from sightline.detection3d.network_task import Detection3DNetworkTask
from sightline.inference.network_only_task import NetworkOnlyTask
from sightline.inference.predictor import Output

if TYPE_CHECKING:
    from sightline.detection3d.detector import Detector3D
    from sightline.detection3d.predictor import Detection3DPredictor
    from sightline.export.graph import ExportGraph
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


class Detection3DTask(Detection3DNetworkTask, NetworkOnlyTask["Detection3DPredictor"]):
    """`sightline.tasks.Task` by networks that use the LiDAR alone."""

    summary: Final = "Detect road users in 3D in LiDAR sweeps and write KITTI's result files."
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
    detects_around: bool = True
    outputs: tuple[Output, ...] = (
        Output(
            name="results",
            suffix=".txt",
            summary="KITTI's result files, with 3D boxes, their projections and scores.",
            write=_write_results,
            read=_read_results,
        ),
    )

    def graphs(self, loaded: "LoadedNetwork[Detector3D]") -> "tuple[ExportGraph, ...]":
        """Export one graph for each stage: proposals, and refinement if there is one."""
        from sightline.detection3d.export_graph import export_graphs

        return export_graphs(loaded)

    def predictor_type(self) -> "type[Detection3DPredictor]":
        """Class of the predictors."""
        from sightline.detection3d.predictor import Detection3DPredictor

        return Detection3DPredictor

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
