"""Registration of 2D detection as a task of `sightline.tasks`.

The command line imports it for `--help`, so heavy modules are imported where they are used.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

from sightline.detection2d.network_task import DetectionNetworkTask
from sightline.inference.network_only_task import NetworkOnlyTask
from sightline.inference.predictor import Output

if TYPE_CHECKING:
    from sightline.detection2d.model import Detector
    from sightline.detection2d.predictor import DetectionPredictor, DetectionResult
    from sightline.export.graph import ExportGraph
    from sightline.inference.demo import DemoPart
    from sightline.inference.network import LoadedNetwork
    from sightline.robustness.object_scoring import ObjectScoring
    from sightline.structures.predictions import Perception
    from sightline.structures.sample import CameraLidarSample


def _write_results(path: Path, sample: "CameraLidarSample", result: "DetectionResult") -> None:
    from sightline.detection2d.results import write_results

    write_results(path, sample, result)


def _read_results(
    path: Path, sample: "CameraLidarSample", perception: "Perception"
) -> "Perception":
    from sightline.detection2d.results import read_results

    del sample
    return read_results(path, perception)


def _write_gates(path: Path, sample: "CameraLidarSample", result: "DetectionResult") -> None:
    from sightline.detection2d.results import write_gates

    write_gates(path, sample, result)


class Detection2DTask(DetectionNetworkTask, NetworkOnlyTask["DetectionPredictor"]):
    """`sightline.tasks.Task` by networks that use the camera, the LiDAR or both."""

    summary: Final = (
        "Detect cars, pedestrians and cyclists in the image and write KITTI's result files."
    )
    training_class: Final = "sightline.detection2d.task.Detection2D"
    trial_settings: Final = {
        "model.init_args.network.width": "0.125",
        "model.init_args.vgg_weights": "null",
        "data.init_args.preparation.init_args.settings.crop_size": "[288,320]",
        "data.init_args.preparation.init_args.settings.view.min_iou_crop": "false",
        "data.init_args.training": "[{path: ., sample_list: train}]",
        "data.init_args.validation": "[{path: ., sample_list: val}]",
    }
    default_weights: str = "detection2d-best"
    outputs: tuple[Output, ...] = (
        Output(
            name="results",
            suffix=".txt",
            summary="KITTI's result files, with 2D boxes and scores.",
            write=_write_results,
            read=_read_results,
        ),
        Output(
            name="gates",
            suffix=".png",
            summary="Openness of each sensor's gate: PNGs, the camera red, the LiDAR green.",
            write=_write_gates,
        ),
    )

    def graphs(self, loaded: "LoadedNetwork[Detector]") -> "tuple[ExportGraph, ...]":
        """Export one graph: the whole network with decoded boxes."""
        from sightline.detection2d.export_graph import export_graph

        return (export_graph(loaded),)

    def predictor_type(self) -> "type[DetectionPredictor]":
        """Class of the predictors."""
        from sightline.detection2d.predictor import DetectionPredictor

        return DetectionPredictor

    def scoring(self) -> "ObjectScoring":
        """Scoring by KITTI's evaluation of 2D boxes."""
        from sightline.detection2d.robustness import SCORING

        return SCORING

    def perception(self, prediction: "DetectionResult") -> "Perception":
        """Wrap the detections, without the gates."""
        from sightline.structures.predictions import Perception

        return Perception(detections2d=prediction.detections)

    def demo(self, frames: Path, out: Path) -> "DemoPart":
        """Run `run_detection_demo`."""
        from sightline.detection2d.demo import run_detection_demo

        return run_detection_demo(self, self.predictor(threads=1), frames, out)


TASK: Final = Detection2DTask()
