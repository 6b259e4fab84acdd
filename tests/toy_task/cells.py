"""Prediction of the toy task, of a kind that the package does not know, and its files."""

import json
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from sightline.files.atomic import atomic_path, atomic_write_text
from sightline.structures.predictions import FurtherPrediction


@dataclass(frozen=True, slots=True)
class LikelyCells(FurtherPrediction):
    """Likelihood of an object's middle in each cell of the image."""

    title: ClassVar[str] = "Likely cells"
    likelihood: Tensor

    def to_json(self):
        row, column = divmod(int(self.likelihood.argmax()), self.likelihood.shape[1])
        return {"row": row, "column": column, "likelihood": float(self.likelihood.max())}

    def draw(self, sample):
        del sample
        grey = (255 * self.likelihood).round().to(torch.uint8).numpy()
        return np.repeat(grey[..., None], 3, axis=2)


def write_cells(path, sample, cells):
    """Write the likelihoods as a NumPy file."""
    del sample
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.save(file, cells.likelihood.numpy())


def read_cells(path):
    """Read the file of `write_cells`."""
    return LikelyCells(torch.from_numpy(np.load(path)))


def write_highest(path, sample, cells):
    """Write the summary."""
    del sample
    atomic_write_text(path, json.dumps(cells.to_json()))
