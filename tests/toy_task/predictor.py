"""How it answers: through both graphs, by any engine."""

import torch
import torch.nn.functional as F

from sightline.export.process_engine import ProcessEngine
from sightline.geometry.boxes2d import Boxes2D
from sightline.inference.network import load_network
from sightline.structures.predictions import Detections2D
from tests.toy_task.examples import inputs_of


class FinderPredictor:
    """The cells in which objects are likely, as boxes of a cell's size."""

    parts = ("image", "points")
    needs = ("points",)
    gives = ("results", "likelihood")

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
        inputs = inputs_of(sample)
        margins = [-size % self._cell_px for size in sample.image_size]
        padding = (0, margins[1], 0, margins[0])
        padded = {name: F.pad(planes, padding) for name, planes in inputs.items()}
        first, second = self._stages
        features = first(padded)["output"]
        likely = second({"features": features})["logits"][0, 0].sigmoid()
        rows, columns = (likely >= likely.max()).nonzero().unbind(dim=1)
        corner = torch.stack((columns, rows), dim=1) * self._cell_px
        boxes = torch.cat((corner, corner + self._cell_px - 1), dim=1).float()
        found = Detections2D(
            class_names=("Car",) * len(boxes), boxes=Boxes2D(boxes), scores=likely[rows, columns]
        )
        return found, likely
