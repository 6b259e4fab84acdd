"""Declaration of the toy task."""

from dataclasses import replace
from functools import partial
from typing import Final

from sightline.inference.predictor import Output

_KEY: Final = "likely_cells"


def _write_cells(path, sample, prediction):
    from tests.toy_task.cells import write_cells

    write_cells(path, sample, prediction)


def _read_cells(path, sample, perception):
    from tests.toy_task.cells import read_cells

    del sample
    return replace(perception, further={**perception.further, _KEY: read_cells(path)})


def _write_highest(path, sample, prediction):
    from tests.toy_task.cells import write_highest

    write_highest(path, sample, prediction)


def _cases(names, channels, stride):
    import torch

    generator = torch.Generator().manual_seed(0)
    size = (3 * stride, 5 * stride)
    planes = {
        name: torch.rand(1, count, *size, generator=generator)
        for name, count in zip(names, channels, strict=True)
    }
    return {f"{size[0]}x{size[1]}": planes}


class FinderTask:
    name = "toy-finder"
    summary = "Finds image cells that contain objects."
    training_class = "tests.toy_task.task.Finder"
    trial_settings: Final = {"data.init_args.batch_size": "2"}
    default_weights = None
    methods = ()
    outputs = (
        Output(
            name="cells",
            suffix=".npy",
            summary="Likelihood of cells.",
            write=_write_cells,
            read=_read_cells,
            further=_KEY,
        ),
        Output(name="highest", suffix=".json", summary="The likeliest.", write=_write_highest),
    )
    switches = ()
    detects_around = False

    def config_type(self):
        from tests.toy_task.config import FinderConfig

        return FinderConfig

    def build(self, config):
        from tests.toy_task.model import FinderNet

        return FinderNet(config)

    def graphs(self, loaded):
        from sightline.export.graph import ExportGraph
        from sightline.export.metadata import ExportMetadata

        config = loaded.network.config
        stages = (
            ("features", loaded.network.features, ("image", "sparse_depth_m"), (3, 1)),
            ("likelihood", loaded.network.likelihood, ("features",), (config.channels,)),
        )
        graphs = []
        for name, module, names, channels in stages:
            stride = config.cell_px if name == "features" else 1
            cases = partial(_cases, names, channels, stride)
            (example,) = _cases(names, channels, 2 * stride).values()
            metadata = ExportMetadata(
                task=self.name,
                config=loaded.weights.config,
                stride=stride,
                provenance=loaded.provenance,
            )
            graphs.append(
                ExportGraph(
                    name=name,
                    module=module,
                    example_inputs=example,
                    metadata=metadata,
                    cases=cases,
                    max_difference=1e-4,
                )
            )
        return tuple(graphs)

    def predictor(self, *, method=None, weights=None, engine="torch", device="cpu", threads=None):
        from tests.toy_task.predictor import FinderPredictor

        if method is not None or weights is None:
            raise ValueError("toy-finder needs a network: give its weights")
        return FinderPredictor(self, weights, engine, device, threads)

    def scoring(self):
        from tests.toy_task.robustness import SCORING

        return SCORING

    def perception(self, prediction):
        from sightline.structures.predictions import Perception

        return Perception(further={_KEY: prediction})

    def demo(self, frames, out):
        del frames, out


TASK = FinderTask()
