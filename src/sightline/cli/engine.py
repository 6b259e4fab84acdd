"""What the commands that run networks tell of the engine."""

import os

from sightline.cli.output import warn
from sightline.data.problem import install_command
from sightline.export.choice import VARIABLE, has_openvino
from sightline.export.names import EngineChoice


def tell_engine(choice: EngineChoice, taken: str | None, device: str) -> None:
    """Says which engine runs the network, where nothing that was asked for tells.

    Args:
        choice: What was asked for.
        taken: The engine's name; None where no network runs.
        device: What was asked for; on others than the CPU there is one engine.
    """
    if choice != "auto" or taken is None or device != "cpu" or VARIABLE in os.environ:
        return
    hint = "--engine torch for PyTorch" if taken != "torch" else ""
    if taken == "torch" and not has_openvino():
        hint = f"for openvino, mostly two to three times as fast: {install_command('export')}"
    warn(f"engine {taken}{f' ({hint})' if hint else ''}")
