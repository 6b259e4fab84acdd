"""Message about the engine in commands that run networks."""

import os

from sightline.cli.output import warn
from sightline.export.choice import VARIABLE, has_openvino
from sightline.export.names import EngineChoice
from sightline.files.problem import install_command


def announce_engine(choice: EngineChoice, taken: str | None, device: str) -> None:
    """Print the engine that runs the network, unless the arguments determine it.

    Args:
        choice: The requested engine.
        taken: Name of the engine; None: no network runs.
        device: The requested device; only the CPU has several engines.
    """
    if choice != "auto" or taken is None or device != "cpu" or VARIABLE in os.environ:
        return
    hint = "--engine torch for PyTorch" if taken != "torch" else ""
    if taken == "torch" and not has_openvino():
        hint = f"for openvino, usually two to three times as fast: {install_command('export')}"
    warn(f"engine {taken}{f' ({hint})' if hint else ''}")
