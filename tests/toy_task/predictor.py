"""Predictor of the toy task: through both graphs, by any engine."""

import torch.nn.functional as F

from sightline.export.process_engine import ProcessEngine
from sightline.inference.network import load_network
from tests.toy_task.cells import LikelyCells
from tests.toy_task.examples import network_inputs


class FinderPredictor:
    """Likelihood of an object's middle in each cell."""

    parts = ("image", "points")
    needs = ("points",)
    gives = ("cells", "highest")

    def __init__(self, task, weights, engine, device, threads) -> None:
        loaded = load_network(task, weights)
        self.name = loaded.name
        self.made_by = {"weights_sha256": loaded.sha256, "engine": engine}
        self._cell_px = loaded.network.config.cell_px
        self._stages = [
            ProcessEngine(graph, name=engine, device=device, threads=threads)
            for graph in task.graphs(loaded)
        ]

    def __call__(self, sample):
        inputs = network_inputs(sample)
        margins = [-size % self._cell_px for size in sample.image_size]
        padding = (0, margins[1], 0, margins[0])
        padded = {name: F.pad(planes, padding) for name, planes in inputs.items()}
        first, second = self._stages
        features = first(padded)["output"]
        return LikelyCells(second({"features": features})["logits"][0, 0].sigmoid())
