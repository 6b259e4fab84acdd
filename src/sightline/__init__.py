"""Sightline: camera-LiDAR perception that keeps seeing when a sensor fails.

The names that most work needs, each imported when it is first used (PEP 562), so that
`import sightline` costs nothing:

    import sightline

    dataset = sightline.open_dataset("recording")
    depth = sightline.load("depth-best")(dataset[0])
"""

import importlib
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from sightline.data.check import check_tree as check_tree
    from sightline.data.formats.image_file import write_rgb as write_rgb
    from sightline.data.formats.undistortion import undistort as undistort
    from sightline.data.importing.import_recording import import_recording as import_recording
    from sightline.data.open import open_dataset as open_dataset
    from sightline.depth_completion.predictor import DepthPredictor as DepthPredictor
    from sightline.detection2d.predictor import DetectionPredictor as DetectionPredictor
    from sightline.detection3d.predictor import Detection3DPredictor as Detection3DPredictor
    from sightline.evaluation.depth import evaluate_depth as evaluate_depth
    from sightline.evaluation.held_out import evaluate_held_out as evaluate_held_out
    from sightline.evaluation.kitti_object import evaluate_objects as evaluate_objects
    from sightline.evaluation.kitti_object_proposals import evaluate_proposals as evaluate_proposals
    from sightline.evaluation.realism import evaluate_realism as evaluate_realism
    from sightline.geometry.boxes2d import Boxes2D as Boxes2D
    from sightline.geometry.boxes3d import Boxes3D as Boxes3D
    from sightline.geometry.calibration import Calibration as Calibration
    from sightline.geometry.projection import project_points as project_points
    from sightline.geometry.projection import sparse_depth_map as sparse_depth_map
    from sightline.joining.predictor import JoinedPredictor as JoinedPredictor
    from sightline.perception.perceive import perceive as perceive
    from sightline.perception.perceiver import MultiTaskPredictor as MultiTaskPredictor
    from sightline.structures.labels import ObjectLabels as ObjectLabels
    from sightline.structures.objects import Objects as Objects
    from sightline.structures.predictions import DepthMap as DepthMap
    from sightline.structures.predictions import Detections2D as Detections2D
    from sightline.structures.predictions import Detections3D as Detections3D
    from sightline.structures.predictions import Perception as Perception
    from sightline.structures.sample import CameraLidarSample as CameraLidarSample
    from sightline.tasks import load as load
    from sightline.visualization.sheet import frame_sheet as frame_sheet

    __version__: str

_MODULES: Final = {
    "Boxes2D": "geometry.boxes2d",
    "Boxes3D": "geometry.boxes3d",
    "Calibration": "geometry.calibration",
    "CameraLidarSample": "structures.sample",
    "DepthMap": "structures.predictions",
    "DepthPredictor": "depth_completion.predictor",
    "Detection3DPredictor": "detection3d.predictor",
    "DetectionPredictor": "detection2d.predictor",
    "Detections2D": "structures.predictions",
    "Detections3D": "structures.predictions",
    "ObjectLabels": "structures.labels",
    "JoinedPredictor": "joining.predictor",
    "MultiTaskPredictor": "perception.perceiver",
    "Objects": "structures.objects",
    "Perception": "structures.predictions",
    "check_tree": "data.check",
    "evaluate_depth": "evaluation.depth",
    "evaluate_held_out": "evaluation.held_out",
    "evaluate_objects": "evaluation.kitti_object",
    "evaluate_proposals": "evaluation.kitti_object_proposals",
    "evaluate_realism": "evaluation.realism",
    "frame_sheet": "visualization.sheet",
    "import_recording": "data.importing.import_recording",
    "load": "tasks",
    "open_dataset": "data.open",
    "perceive": "perception.perceive",
    "project_points": "geometry.projection",
    "sparse_depth_map": "geometry.projection",
    "undistort": "data.formats.undistortion",
    "write_rgb": "data.formats.image_file",
}
"""Where each name is defined, below this package."""

_RENAMED: Final = {"Perceiver": "MultiTaskPredictor"}
"""Names of earlier versions, and what they are called now."""

__all__ = ["__version__", *_MODULES]  # noqa: PLE0604 - strings, all of them


def __getattr__(name: str) -> Any:  # noqa: ANN401 - what was asked for
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("sightline")
    elif name in _MODULES:
        value = getattr(importlib.import_module(f"sightline.{_MODULES[name]}"), name)
    elif name in _RENAMED:
        from sightline.geometry.user_warning import warn_user

        warn_user(f"sightline.{name} is now sightline.{_RENAMED[name]}", DeprecationWarning)
        return __getattr__(_RENAMED[name])
    else:
        raise AttributeError(f"module 'sightline' has no attribute {name!r}")
    globals()[name] = value  # the next time it is found without this function
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
