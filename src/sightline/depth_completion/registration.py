"""Registration of depth completion in `sightline.tasks`.

The command line imports it for `--help`, so everything else is imported where it is used.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final, get_args

from sightline.depth_completion.method_names import Method
from sightline.depth_completion.network_task import DepthNetworkTask
from sightline.inference.predictor import Output, OutputFilter

if TYPE_CHECKING:
    from sightline.depth_completion.model import DepthCompletionNet
    from sightline.depth_completion.predictor import Completer
    from sightline.depth_completion.robustness import HeldOutScoring
    from sightline.export.graph import ExportGraph
    from sightline.export.names import EngineChoice
    from sightline.inference.demo import DemoPart
    from sightline.inference.network import LoadedNetwork
    from sightline.structures.predictions import DepthMap, Perception
    from sightline.structures.sample import CameraLidarSample


def _write_depth(path: Path, sample: "CameraLidarSample", depth_map: "DepthMap") -> None:
    from sightline.depth_completion.files import write_depth

    write_depth(path, sample, depth_map)


def _write_uncertainty(path: Path, sample: "CameraLidarSample", depth_map: "DepthMap") -> None:
    from sightline.depth_completion.files import write_uncertainty

    write_uncertainty(path, sample, depth_map)


def _describe_guess(depth_map: "DepthMap") -> str:
    from sightline.depth_completion.files import describe_guess

    return describe_guess(depth_map)


def _only_valid(depth_map: "DepthMap") -> "DepthMap":
    from sightline.depth_completion.postprocess import only_valid

    return only_valid(depth_map)


def _read_depth(path: Path, sample: "CameraLidarSample", perception: "Perception") -> "Perception":
    from sightline.depth_completion.files import read_depth

    return read_depth(path, sample, perception)


def _read_uncertainty(
    path: Path, sample: "CameraLidarSample", perception: "Perception"
) -> "Perception":
    from sightline.depth_completion.files import read_uncertainty

    return read_uncertainty(path, sample, perception)


class DepthCompletionTask(DepthNetworkTask):
    """`sightline.tasks.Task` by networks, or by methods without training."""

    summary: Final = (
        "Complete the depth of every frame and write 16-bit depth PNGs (metres times 256)."
    )
    training_class: Final = "sightline.depth_completion.task.DepthCompletion"
    trial_settings: Final = {"data.init_args.preparation.init_args.settings.crop_size": "[64,128]"}
    methods: tuple[str, ...] = get_args(Method)
    outputs: tuple[Output, ...] = (
        Output(
            name="depth",
            suffix=".png",
            summary="Depth maps.",
            write=_write_depth,
            read=_read_depth,
            remark=_describe_guess,
        ),
        Output(
            name="uncertainty",
            suffix=".png",
            summary="The network's expected errors, as PNGs in the same format.",
            write=_write_uncertainty,
            read=_read_uncertainty,
        ),
    )

    detects_around: bool = False
    switches: tuple[OutputFilter, ...] = (
        OutputFilter(
            name="valid_only",
            summary="Write only valid depths, and 0 (no value) elsewhere.",
            change=_only_valid,
        ),
    )

    def graphs(self, loaded: "LoadedNetwork[DepthCompletionNet]") -> "tuple[ExportGraph, ...]":
        """Export graph of the whole network, as the only one."""
        from sightline.depth_completion.export_graph import export_graph

        return (export_graph(loaded),)

    def predictor(
        self,
        *,
        method: str | None = None,
        weights: str | Path | None = None,
        engine: "EngineChoice" = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> "Completer":
        """Create a completer; see `choose_completer`."""
        from sightline.depth_completion.predictor import choose_completer

        return choose_completer(
            method=method, weights=weights, engine=engine, device=device, threads=threads
        )

    def scoring(self) -> "HeldOutScoring":
        """Scoring on held-out LiDAR rings."""
        from sightline.depth_completion.robustness import HeldOutScoring

        return HeldOutScoring()

    def perception(self, prediction: "DepthMap") -> "Perception":
        """Wrap the depth map."""
        from sightline.structures.predictions import Perception

        return Perception(depth=prediction)

    def demo(self, frames: Path, out: Path) -> "DemoPart":
        """Run the demo; see `run_depth_demo`."""
        from sightline.depth_completion.demo import run_depth_demo

        return run_depth_demo(self, frames, out)


TASK: Final = DepthCompletionTask()
