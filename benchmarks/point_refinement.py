"""Times a training step of the plain second stage: `python -m benchmarks.point_refinement`.

One thread, processor time. 64 regions of 512 points of each simulated frame that comes with
Sightline, in the published sizes: inputs, forward and backward pass. "every neighbour" computes
all 64 of each centre, mostly copies; "sightline" only the distinct ones. The largest
difference of the boxes is printed, too. The last line is JSON.
"""

import statistics
import time

import jsonargparse
import torch
from torch import Tensor
from torch.nn.functional import linear

from benchmarks.record import print_record
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.points.config import RefinementConfig, RoiPoolingConfig
from sightline.detection3d.points.layers import Neighbourhood
from sightline.detection3d.points.refinement import PointRefinement
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig, make_truth, network_sweep
from sightline.ops.group_points import group_points
from sightline.simulation.packaged import PACKAGED_FRAMES

POINTS, PROPOSALS, SPREAD_M = 16_384, 300, 0.7


class EveryNeighbour(Neighbourhood):
    """Set abstraction that computes repeated neighbours, too."""

    def forward(
        self, points: Tensor, features: Tensor, centers: Tensor, neighbours: Tensor
    ) -> Tensor:
        """Compute the features of the centres."""
        offset = group_points(points, neighbours) - centers[:, :, None]
        hidden = linear(offset, self.first.weight[:, :3], self.first.bias)
        hidden = hidden + group_points(linear(features, self.first.weight[:, 3:]), neighbours)
        values: Tensor = self.rest(self.activate(hidden))
        return values.amax(dim=2)


def stage_of(neighbourhood: type[Neighbourhood]) -> PointRefinement:
    """A second stage with weights drawn by one seed."""
    torch.manual_seed(0)
    stage = PointRefinement(RefinementConfig(), RoiPoolingConfig())
    for module in stage.modules():
        if isinstance(module, Neighbourhood):
            module.__class__ = neighbourhood
    return stage


def main(repeats: int = 3) -> None:
    """Print a table, then one line of JSON."""
    torch.set_num_threads(1)
    stages = {"every neighbour": stage_of(EveryNeighbour), "sightline": stage_of(Neighbourhood)}
    dataset = KittiObjectDataset(PACKAGED_FRAMES, parts=("points", "objects"))
    times: dict[str, list[float]] = {name: [] for name in stages}
    boxes: dict[str, list[Tensor]] = {name: [] for name in stages}
    for number in range(len(dataset)):
        sample, settings = dataset[number], SweepConfig(num_points=POINTS)
        sweep, names = network_sweep(sample, settings), ("Car",)
        assert sample.objects is not None, "simulated frames have labels"
        truth = make_truth(sample.objects, sweep, names, settings, SweepTruthConfig())
        generator = torch.Generator().manual_seed(number)
        near = truth.boxes[torch.randint(len(truth.boxes), (PROPOSALS,), generator=generator)]
        near = (near + SPREAD_M * torch.randn(near.shape, generator=generator).clamp(-1, 1)).float()
        features = torch.randn(len(sweep), RefinementConfig().in_channels, generator=generator)
        classes = torch.zeros(PROPOSALS, dtype=torch.int64)
        proposed = Proposed(near, classes, torch.ones(PROPOSALS), features)
        for turn in range(repeats + 1):  # in turns; the first warms up
            for name, stage in stages.items():
                start = time.process_time()
                loss = Detection3DLossConfig()
                regions, targets = stage.examples(sweep, proposed, truth, loss, seed=number)
                output = stage(**regions.inputs)
                torch.autograd.backward(stage.losses(output, regions, targets, loss).total)
                if turn:
                    times[name].append(1000 * (time.process_time() - start))
                    boxes[name].append(output.boxes.detach())
    own_median = statistics.median(times["sightline"])
    results = []
    for name, measured in times.items():
        pairs = zip(boxes[name], boxes["sightline"], strict=True)
        error = max(float((one - other).abs().max()) for one, other in pairs)
        median = statistics.median(measured)
        results.append(
            {"method": name, "median_ms": median, "times_sightline": median / own_median}
        )
        print(f"{name:<16} {median:9.1f} ms  {median / own_median:5.1f} x  difference {error:.1e}")
    setting = {"regions": 64, "points": 512, "repeats": repeats, "threads": 1}
    print_record({**setting, "results": results}, seed=0)


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)
