"""Pictures of a training for its loggers, of any kind and number."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from sightline.data.image_file import write_rgb


@rank_zero_only
def log_picture(
    loggers: Iterable[Any], name: str, picture: UInt8[np.ndarray, "height width 3"], step: int
) -> None:
    """Give a picture to every logger.

    TensorBoard and loggers with `log_image`, such as Weights & Biases, show it; others, such as
    CSV files, get a file pictures/NAME/STEP.png in their folder, if they have one.

    Args:
        loggers: Loggers of the trainer, Lightning's or compatible ones.
        name: Name of the picture; the same name continues a series.
        picture: RGB picture.
        step: Number of the training step.
    """
    for logger in loggers:
        log_image: Any = getattr(logger, "log_image", None)
        if isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(name, picture, step, dataformats="HWC")
        elif log_image is not None:
            log_image(key=name, images=[picture], step=step)
        elif (folder := logger.log_dir or logger.save_dir) is not None:
            write_rgb(Path(folder) / "pictures" / name / f"{step:07}.png", picture)
