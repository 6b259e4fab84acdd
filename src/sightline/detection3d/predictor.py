"""Predictor for 3D detection in sweeps, on any engine."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Final

import torch
from torch import Tensor

from sightline.data.layouts.kitti_trees import Part
from sightline.detection3d.all_around import (
    join_quarters,
    quarter_sweeps,
    search_range_m,
    wide_network,
)
from sightline.detection3d.detector import Detector3D, propose, refine
from sightline.detection3d.export_graph import REGIONS_A_RUN, export_graphs, region_portions
from sightline.detection3d.network_task import NETWORK_TASK
from sightline.detection3d.stages import Proposed
from sightline.detection3d.suppression import align
from sightline.detection3d.sweeps import (
    Sweep,
    cut_to_view,
    from_kitti_frame,
    network_sweep,
    to_kitti_boxes,
    to_kitti_frame,
)
from sightline.export.names import EngineChoice, EngineName
from sightline.export.process_engine import ProcessEngine
from sightline.geometry.wrong_types import named_arguments
from sightline.inference.network import LoadedNetwork
from sightline.inference.network_predictor import NetworkPredictor
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample

# For PyTorch on a CPU: 100 take 1.5 times as long, and five times the memory.
_REGIONS_AT_ONCE: Final = 10


class StageRunners:
    """Runner of both stages; may be pickled, and used in a forked process."""

    def __init__(
        self,
        loaded: LoadedNetwork[Detector3D],
        *,
        engine: EngineChoice = "torch",
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        """Export the stages if the engine needs it.

        Raises:
            ValueError: The engine is not installed or cannot run on the device.
        """
        self.detector = loaded.network
        graphs = export_graphs(loaded)
        make = partial(ProcessEngine, device=device, threads=threads)
        self._engines = [make(graph, name=engine) for graph in graphs]
        if len({each.name for each in self._engines}) > 1:  # if one stage could not be exported
            self._engines = [make(graph, name="torch") for graph in graphs]
        self.engine: EngineName = self._engines[0].name
        self._is_fixed = self.engine != "torch"  # files take a fixed number of regions
        self._portion = _REGIONS_AT_ONCE if device == "cpu" else None
        if self._is_fixed:
            self._portion = REGIONS_A_RUN

    def propose(self, sweep: Sweep) -> Proposed:
        """Compute the first stage's proposals for a sweep."""
        return propose(self.detector, sweep, self._first)[0]

    def propose_both(self, sweep: Sweep) -> tuple[Proposed, Proposed]:
        """Compute proposals for scoring and for training a second stage."""
        both = propose(self.detector, sweep, self._first, training=(False, True), in_use=False)
        return both[0], both[1]

    def refine(self, sweep: Sweep, proposed: Proposed) -> Detections3D:
        """Refine proposals to detections."""
        return refine(self.detector, sweep, proposed, self._second)

    def _first(self, inputs: Mapping[str, Tensor]) -> Any:  # noqa: ANN401 - the stage's own
        found = self._engines[0](inputs)
        return self.detector.first.output_type(**{name: each.cpu() for name, each in found.items()})

    def _second(self, inputs: Mapping[str, Tensor]) -> Any:  # noqa: ANN401 - the stage's own
        second, count = self.detector.second, len(next(iter(inputs.values())))
        assert second is not None, "there is something to run"
        size = self._portion or count
        found = [
            self._engines[1](each) for each in region_portions(inputs, size, fill=self._is_fixed)
        ]
        return second.output_type(
            **{name: torch.cat([each[name].cpu() for each in found])[:count] for name in found[0]}
        )


class Detection3DPredictor(NetworkPredictor[Detector3D, Detections3D]):
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

    Detections are those in the camera's view, or all around the LiDAR for samples with
    `all_around`, which networks of points do not support.
    """

    parts: tuple[Part, ...] = ("points",)
    needs: tuple[Part, ...] = ("points",)
    gives: tuple[str, ...] = ("results",)

    network_task = NETWORK_TASK

    def _start(
        self,
        loaded: LoadedNetwork[Detector3D],
        engine: EngineChoice,
        device: str,
        threads: int | None,
    ) -> EngineName:
        self._config = loaded.network.config
        self._loaded = loaded
        self._start_stages = partial(StageRunners, engine=engine, device=device, threads=threads)
        self._stages = self._start_stages(loaded)
        self._wide_stages: dict[float, StageRunners] = {}  # by their range
        return self._stages.engine

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> Detections3D:
        """Detect in a sample's sweep; warn if its axes seem wrong for the LiDAR frame.

        Raises:
            ValueError: The sample has no sweep, or points that `check_points` refuses.
        """
        if sample.all_around and self._config.pillars is not None:
            return self._align(self._detect_around(sample), sample)
        return self.both_stages(sample)[1]

    def _detect_around(self, sample: CameraLidarSample) -> Detections3D:
        """Detect in the quarters of a sweep, in a frame like KITTI's."""
        level = cut_to_view(to_kitti_frame(sample), replace(self._config.input, in_view=False))
        points = level.points
        assert points is not None, "checked when it was cut"
        range_m = search_range_m(points)
        if range_m not in self._wide_stages:  # made when first needed: exports take seconds
            wide = wide_network(self._loaded, range_m)
            self._wide_stages[range_m] = self._start_stages(wide)
        stages = self._wide_stages[range_m]
        sweeps = quarter_sweeps(points, stages.detector.config)
        found = [stages.refine(sweep, stages.propose(sweep)) for sweep in sweeps]
        return join_quarters(found, self._config)

    @named_arguments
    def both_stages(self, sample: CameraLidarSample) -> tuple[Detections3D, Detections3D]:
        """Compute proposals and detections of a sample; see `predict`.

        Raises:
            ValueError: See `predict`.
        """
        sweep = self._sweep(sample)
        proposed = self._stages.propose(sweep)
        refined = self._stages.refine(sweep, proposed)
        return self._unrefined(proposed, sample), self._align(refined, sample)

    @named_arguments
    def propose(self, sample: CameraLidarSample) -> Detections3D:
        """Compute the first stage's proposals of a sample, without refinement or suppression.

        Raises:
            ValueError: See `predict`.
        """
        return self._unrefined(self._stages.propose(self._sweep(sample)), sample)

    @named_arguments
    def refine_boxes(self, sample: CameraLidarSample, boxes: Detections3D) -> Detections3D:
        """Refine boxes of a sample by the second stage, as if the first one had proposed them.

        Args:
            sample: Sample with a sweep.
            boxes: Boxes in the LiDAR's own frame, and their scores. Those of unknown classes, or
                with centres outside the network's range, are left out.

        Returns:
            Refined boxes, by descending score, without doubtful and overlapping ones; none if the
            network has no second stage.

        Raises:
            ValueError: See `predict`.
        """
        detector, config = self._stages.detector, self._config
        raised = to_kitti_boxes(boxes, sample).boxes.tensor.float()
        raised[:, 2] += config.input.height_offset_m
        low, high = (
            raised.new_tensor(each[:2]) for each in (config.input.lowest_m, config.input.highest_m)
        )
        is_near = ((raised[:, :2] >= low) & (raised[:, :2] <= high)).all(dim=1)
        places = {name: place for place, name in enumerate(detector.class_names)}
        classes = torch.tensor([places.get(name, -1) for name in boxes.class_names]).long()
        taken = is_near & (classes >= 0) & (detector.second is not None)
        proposed = Proposed(raised[taken], classes[taken], boxes.scores[taken].float())
        return self._align(self._stages.refine(self._sweep(sample), proposed), sample)

    def _sweep(self, sample: CameraLidarSample) -> Sweep:
        return network_sweep(to_kitti_frame(sample), self._config.input)

    def _unrefined(self, proposed: Proposed, sample: CameraLidarSample) -> Detections3D:
        return self._align(self._stages.detector.as_detections(*proposed[:3]), sample)

    def _align(self, detections: Detections3D, sample: CameraLidarSample) -> Detections3D:
        return from_kitti_frame(align(detections, self._config.alignment), sample)


class ProposalPredictor(Detection3DPredictor):
    """Predictor of the first stage's proposals; see `Detection3DPredictor.propose`."""

    @property
    def made_by(self) -> dict[str, str]:
        """Entries of a manifest besides the name."""
        return super().made_by | {"stage": "first"}

    @named_arguments
    def predict(self, sample: CameraLidarSample) -> Detections3D:
        """Compute the proposals of a sample.

        Raises:
            ValueError: See `Detection3DPredictor.predict`.
        """
        return self.propose(sample)
