"""What the commands that run networks tell of the engine."""

import sys

from sightline.export.choice import has_openvino
from sightline.export.names import EngineChoice


def tell_engine(choice: EngineChoice, taken: str | None) -> None:
    """Says, where none was named, which engine runs the network, and what else there would be.

    Args:
        choice: What was asked for.
        taken: The engine's name; None where no network runs.
    """
    if choice != "auto" or taken is None:
        return
    hint = "--engine torch for PyTorch" if taken != "torch" else ""
    if taken == "torch" and not has_openvino():
        hint = 'for openvino, about three times as fast: pip install "sightline[export]"'
    print(f"sightline: engine {taken}{f' ({hint})' if hint else ''}", file=sys.stderr)
