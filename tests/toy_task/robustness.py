"""Scoring of the toy task where sensors are broken."""

import numpy as np

from sightline.jobs.output_dirs import finished_names
from sightline.robustness.scoring import BenchFrame, BenchMetric, Panel
from sightline.visualization.canvas import scaled_to_width
from tests.toy_task.cells import read_cells, write_cells


class CellScoring:
    """Share of frames whose likeliest cell holds the middle of an object."""

    name = "likeliest cells"
    suffix = ".npy"
    parts = ("objects",)
    takes_results = True
    metrics = (BenchMetric(name="hits", title="hits", unit="%", highest=100.0),)

    def check(self, dataset):
        del dataset

    def notes(self, dataset):
        del dataset
        return ()

    def prepare(self, sample):
        return BenchFrame(sample, None)

    def store(self, path, prediction):
        write_cells(path, prediction.frame.sample, prediction.output)

    def finished(self, folder):
        return finished_names(folder, self.suffix)

    def read(self, path, sample):
        del sample
        return read_cells(path)

    def score(self, folder, dataset):
        hits = [
            self._is_hit(read_cells(folder / f"{name}{self.suffix}"), dataset[index])
            for index, name in enumerate(dataset.sample_ids)
        ]
        return {"hits": 100.0 * float(np.mean(hits))}

    def draw(self, prediction, width_px):
        picture = prediction.output.draw(prediction.corrupted.sample)
        return (Panel("cells", scaled_to_width(picture, width_px)),)

    @staticmethod
    def _is_hit(cells, sample):
        found = cells.to_json()
        boxes = sample.objects.boxes2d.tensor[sample.objects.has_box3d]
        cell_px = -(-sample.image_size[0] // len(cells.likelihood))
        middles = (boxes[:, :2] + boxes[:, 2:]) / 2 // cell_px
        return [found["column"], found["row"]] in middles.tolist()


SCORING = CellScoring()
