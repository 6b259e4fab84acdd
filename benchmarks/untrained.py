"""Networks of recipes whose weights do not come with the package, to be timed all the same."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
import yaml
from torch import nn

from sightline.files.settings import parse_settings
from sightline.files.weights import write_weights
from sightline.files.weights_header import shipped_names
from sightline.inference.network import NetworkTask
from sightline.tasks import PACKAGE_RECIPES


def shipped_or_untrained(recipe: str, task: NetworkTask[nn.Module], folder: Path) -> str | Path:
    """The name of the weights that come with the package, or a file of the recipe's untrained ones.

    Args:
        recipe: Its name, which is that of the weights, too.
        task: Whose network it is.
        folder: Where the file is written.
    """
    if recipe in shipped_names():
        return recipe
    plain = yaml.safe_load((PACKAGE_RECIPES / f"{recipe}.yaml").read_text())
    config: Any = parse_settings(task.config_type(), plain["model"]["init_args"]["network"])
    torch.manual_seed(0)
    tensors = dict(task.build(config).state_dict())
    path = folder / f"{recipe}.safetensors"
    settings = json.loads(json.dumps(asdict(config)))
    write_weights(path, tensors, task=task.name, config=settings, provenance={})
    return path
