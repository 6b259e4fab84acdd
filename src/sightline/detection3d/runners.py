"""Runners of a detector's stages on an engine, for jobs with several processes."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, Final

import torch
from torch import Tensor

from sightline.detection3d.detect import as_detections, nothing_proposed, propose, refine
from sightline.detection3d.export_graph import export_graphs, region_portions
from sightline.detection3d.model import Detector3D
from sightline.detection3d.stages import Proposed, Sweep
from sightline.export.names import EngineChoice, EngineName
from sightline.export.process_engine import ProcessEngine
from sightline.inference.network import LoadedNetwork
from sightline.structures.predictions import Detections3D

_REGIONS_AT_ONCE: Final = (
    10  # for PyTorch on a CPU: 100 take 1.5 times as long, and five times the memory
)


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
        self._at_once = _REGIONS_AT_ONCE if device == "cpu" else None

    def propose(self, sweep: Sweep) -> Proposed:
        """Compute the first stage's proposals for a sweep; none for an empty one."""
        if not len(sweep):
            return nothing_proposed(sweep)
        return propose(self.detector, sweep, self._first)[0]

    def propose_both(self, sweep: Sweep) -> tuple[Proposed, Proposed]:
        """Compute proposals for scoring and for training a second stage."""
        if not len(sweep):
            return nothing_proposed(sweep), nothing_proposed(sweep)
        in_use, in_training = propose(
            self.detector, sweep, self._first, training=(False, True), in_use=False
        )
        return in_use, in_training

    def refine(self, sweep: Sweep, proposed: Proposed) -> Detections3D:
        """Refine proposals to detections."""
        return refine(self.detector, sweep, proposed, self._second)

    def proposals(self, proposed: Proposed) -> Detections3D:
        """Convert proposals to detections without refinement."""
        return as_detections(self.detector, *proposed[:3])

    def _first(self, inputs: Mapping[str, Tensor]) -> Any:  # noqa: ANN401 - the stage's own
        found = self._engines[0](inputs)
        return self.detector.first.output_type(**{name: each.cpu() for name, each in found.items()})

    def _second(self, inputs: Mapping[str, Tensor]) -> Any:  # noqa: ANN401 - the stage's own
        second = self.detector.second
        assert second is not None, "there is something to run"
        run = self._engines[1]
        count = len(next(iter(inputs.values())))
        portions = region_portions(inputs) if self._is_fixed else self._split(inputs)
        found = [run(each) for each in portions]
        return second.output_type(
            **{name: torch.cat([each[name].cpu() for each in found])[:count] for name in found[0]}
        )

    def _split(self, inputs: Mapping[str, Tensor]) -> Iterator[dict[str, Tensor]]:
        """Split inputs into portions of regions that PyTorch runs at once."""
        count = len(next(iter(inputs.values())))
        at_once = self._at_once or count
        for start in range(0, count, at_once):
            yield {name: values[start : start + at_once] for name, values in inputs.items()}
