"""Writer of checkpoints: whole files beside their target, which is then replaced."""

import io
import os
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO

from sightline.files.atomic import atomic_write_bytes


class AtomicCheckpointIO(TorchCheckpointIO):
    """Plugin that writes checkpoints atomically in the folder of the run.

    Lightning's own takes room in the folder for temporary files, and may stop between there and the
    run's folder.
    """

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | os.PathLike[str],
        storage_options: Any | None = None,  # noqa: ANN401 - as base
    ) -> None:
        """Write a checkpoint; `storage_options` has no effect."""
        del storage_options
        content = io.BytesIO()
        torch.save(checkpoint, content)
        atomic_write_bytes(Path(path), content.getvalue())
