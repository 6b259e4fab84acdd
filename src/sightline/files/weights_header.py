"""Reader of weights files' descriptions without PyTorch, whose import takes seconds."""

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.files.plain_file import check_no_pointer
from sightline.files.problem import error_text
from sightline.geometry.arguments import nearest, plain_path

RUN_WEIGHTS: Final = "weights.safetensors"
"""Name of the weights in the folder of a training run."""
WEIGHTS_FOLDER: Final = Path(__file__).parents[1] / "weights"
"""Folder of the weights in the package."""

METADATA_KEY: Final = "sightline"
"""Key of the description in a safetensors file's metadata; only one key, because safetensors
writes several in random order."""

WEIGHTS_REMEDY: Final = (
    "name a weights file that sightline wrote, or export it again from the run's checkpoint"
)

_LENGTH = struct.Struct("<Q")  # a safetensors file begins with its header's length in bytes
_MAX_HEADER_BYTES = 2**24  # enough for some hundred thousand tensors
_MAX_DESCRIPTION_BYTES = 2**16


@dataclass(frozen=True, kw_only=True, slots=True)
class WeightsDescription:
    """Description of the network of weights."""

    task: str
    """Task of the network."""
    config: dict[str, object]
    """The network's settings as plain JSON values."""
    provenance: dict[str, str]
    """Origin of the weights, for people: version, seed, steps, .."""


def shipped_names() -> tuple[str, ...]:
    """List the names of the weights in the package."""
    return tuple(sorted(path.stem for path in WEIGHTS_FOLDER.glob("*.safetensors")))


def has_weights(weights: Path | str) -> bool:
    """Whether weights of this name, or such a file, exist."""
    return str(weights) in shipped_names() or Path(weights).is_file()


def find_weights(weights: Path | str) -> Path:
    """Find the file of weights, given by path or by their name in the package.

    Raises:
        TypeError: The argument is neither a name nor a path.
        ValueError: There are no such weights, or the file is an exported network.
    """
    named = ", ".join(shipped_names()) or "none do"
    path = plain_path("weights", weights, f"a file or the name of weights; name one of {named}")
    if str(weights) in shipped_names():
        return WEIGHTS_FOLDER / f"{weights}.safetensors"
    if path.suffix in (".onnx", ".xml"):
        raise ValueError(
            f"{path} is a network exported for other programs; give the weights that it was "
            "exported from (.safetensors, .ckpt), which --engine runs by the same libraries"
        )
    if (path / RUN_WEIGHTS).is_file():
        raise ValueError(f"{path} is the folder of a run; give {path / RUN_WEIGHTS}")
    if not path.is_file():
        fault = f"there are no weights {str(weights)!r}"
        if path.is_dir():
            fault = f"{path} is a folder without {RUN_WEIGHTS}, as a run of training has it"
        raise ValueError(
            f"{fault}; {nearest(str(weights), shipped_names())}"
            "give a file (.safetensors, .ckpt) or the name of weights that come with sightline "
            f"({named})"
        )
    check_no_pointer(path)
    return path


def read_description(path: Path) -> WeightsDescription:
    """Read the description in Sightline's safetensors file, without its tensors.

    Raises:
        ValueError: The file is no safetensors file, or has no description of its network.
    """
    try:
        with path.open("rb") as file:
            (length,) = _LENGTH.unpack(file.read(_LENGTH.size))
            if length > _MAX_HEADER_BYTES:
                raise ValueError(f"its header claims {length} bytes")
            header = json.loads(file.read(length))
    except PermissionError as error:
        raise ValueError(error_text(error)) from error
    except (OSError, struct.error, ValueError, RecursionError) as error:
        raise ValueError(
            f"{path} cannot be read as safetensors; it is cut short, damaged or of another kind: "
            f"{WEIGHTS_REMEDY}"
        ) from error
    match header:
        case {"__metadata__": {"sightline": str(text)}}:
            return parse_description(path, text)
    raise ValueError(f"{path} does not say which network its weights are for; {WEIGHTS_REMEDY}")


def parse_description(path: Path, text: str) -> WeightsDescription:
    """Parse the description from JSON in a file's metadata.

    Raises:
        ValueError: The text is no description; the error names the file.
    """
    description: object = None
    if len(text) <= _MAX_DESCRIPTION_BYTES:
        try:
            description = json.loads(text)
        except (ValueError, RecursionError):
            description = None  # refused below, like any other invalid value
    return check_description(path, description)


def check_description(path: Path, description: object) -> WeightsDescription:
    """Convert plain values to a description.

    Raises:
        ValueError: The values are no description; the error names the file.
    """
    match description:
        case {"task": str(task), "config": dict(config), "provenance": dict(provenance)}:
            is_text = all(isinstance(each, str) for pair in provenance.items() for each in pair)
            if is_text and all(isinstance(name, str) for name in config):
                return WeightsDescription(task=task, config=config, provenance=provenance)
    raise ValueError(f"{path} describes its weights in an unknown way; {WEIGHTS_REMEDY}")
