"""Export of joined objects: a folder with the graphs of both detectors and the fitted models."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from sightline.detection2d.registration import TASK as DETECTION_2D
from sightline.detection3d.registration import TASK as DETECTION_3D
from sightline.export.names import SUFFIXES, Format
from sightline.export.parity import ParityReport
from sightline.export.write import export_graphs
from sightline.files.atomic import atomic_write_text
from sightline.inference.network import load_network
from sightline.joining.config import JoinConfig
from sightline.joining.models import SHIPPED, read_models
from sightline.joining.ranges import read_ranges

MODELS_NAME: Final = "joined.json"
"""File of the models and of the settings of joining, in the folder."""


def export_joined(
    out: Path,
    format: Format,  # noqa: A002 - the flag is --format
) -> dict[Path, ParityReport]:
    """Write detection2d, detection3d-proposals and detection3d-refinement, and joined.json.

    Args:
        out: The folder.
        format: Format of the graphs.

    Returns:
        The differences to PyTorch, by file of a graph.

    Raises:
        ValueError: As for `export_graphs`.
    """
    weights: dict[str, str] = read_models().provenance["weights"]
    in_image, in_sweep = (weights[task.name] for task in (DETECTION_2D, DETECTION_3D))
    graphs = {
        DETECTION_2D.name: DETECTION_2D.graphs(load_network(DETECTION_2D, in_image)),
        DETECTION_3D.name: DETECTION_3D.graphs(load_network(DETECTION_3D, in_sweep)),
    }
    reports: dict[Path, ParityReport] = {}
    for name, each in graphs.items():
        reports |= export_graphs(each, out / f"{name}{SUFFIXES[format]}", format)
    atomic_write_text(out / MODELS_NAME, json.dumps(joined_content(), indent=1) + "\n")
    return reports


def joined_content() -> dict[str, Any]:
    """Collect the content of joined.json: the models as they ship, and the settings of joining."""
    content: dict[str, Any] = json.loads(SHIPPED.read_text())
    return {"settings": asdict(JoinConfig()), "ranges": read_ranges(), **content}
