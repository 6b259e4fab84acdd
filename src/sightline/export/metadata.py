"""Metadata of an exported file."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version

from sightline.geometry.wrong_types import named_arguments, named_fields

PREFIX = "sightline."
"""Prefix of Sightline's keys in a file, to distinguish them from other tools' keys."""

_REQUIRED = tuple(PREFIX + name for name in ("task", "config", "version", "stride", "provenance"))
PROCESSING_KEY = PREFIX + "processing"
"""Key of the steps around the network, as JSON; older files lack it."""
KEYS = (*_REQUIRED, PROCESSING_KEY)
"""Keys of the metadata in a file."""


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class ExportMetadata:
    """Metadata that make a file sufficient to run its network."""

    task: str
    """Name of the task, e.g. depth-completion."""
    config: Mapping[str, object]
    """The network's configuration as plain JSON values."""
    stride: int
    """Number that must divide height and width of the images."""
    provenance: Mapping[str, str] = field(default_factory=dict)
    """Origin of the weights."""
    processing: Mapping[str, object] = field(default_factory=dict)
    """Inputs, outputs and the steps before and after the network, with all their numbers, as plain
    JSON values. docs/guides/export.md lists the steps in order."""
    sightline_version: str = field(default_factory=lambda: version("sightline"))
    """Version that wrote the file."""

    def __post_init__(self) -> None:
        """Check the stride."""
        if self.stride < 1:
            raise ValueError(f"stride must be at least 1, got {self.stride}")

    def to_properties(self) -> dict[str, str]:
        """Text for each key of a file."""
        values = (
            self.task,
            json.dumps(self.config, sort_keys=True),
            self.sightline_version,
            str(self.stride),
            json.dumps(dict(self.provenance), sort_keys=True),
            json.dumps(self.processing, sort_keys=True),
        )
        return dict(zip(KEYS, values, strict=True))


@named_arguments
def parse_metadata(properties: Mapping[str, str], source: str) -> ExportMetadata:
    """Parse metadata; the inverse of `ExportMetadata.to_properties`.

    Args:
        properties: Text of each key; foreign keys are ignored.
        source: Name of the source in errors.

    Raises:
        ValueError: A key is missing or its text is invalid.
    """
    missing = [key for key in _REQUIRED if key not in properties]
    if missing:
        raise ValueError(
            f"{source} lacks the metadata {', '.join(missing)}, so sightline did not write it; "
            "export the weights again"
        )
    task, config, written_by, stride, provenance = (properties[key] for key in _REQUIRED)
    try:
        return ExportMetadata(
            task=task,
            config=json.loads(config),
            stride=int(stride),
            provenance=json.loads(provenance),
            sightline_version=written_by,
            processing=json.loads(properties.get(PROCESSING_KEY, "{}")),
        )
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{source} holds damaged metadata ({error}); export the weights again"
        ) from error
