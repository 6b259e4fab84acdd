"""Reader of small YAML and JSON files of plain values with limits on time and memory."""

import re
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import Final

import yaml

from sightline.files.plain_text import read_text, shortened
from sightline.files.problem import FileError

_MAX_BYTES: Final = 2**17
"""Largest size of a file: a handwritten matrix takes some hundred bytes."""
_MAX_DEPTH: Final = 12
"""Deepest nesting of lists and mappings."""
_MAX_VALUES: Final = 2**16
"""Largest number of values, with aliases expanded."""


_OPENCV_HEADER: Final = "%YAML:"
"""How OpenCV's FileStorage begins; YAML has a space in place of the colon."""
_WRONG_TAGS: Final = (ValueError, OverflowError, LookupError, AttributeError, TypeError)
"""Errors of YAML's constructors where a value does not fit its tag, as in `!!bool x`."""


class _RefusedError(ValueError):
    """Feature of YAML that files of plain values do not need."""


class _PlainLoader(yaml.SafeLoader):  # type: ignore[misc]
    """Loader of YAML without merges, duplicate keys, deep nesting and multiplying aliases."""

    depth = 0

    def compose_node(self, parent: yaml.Node | None, index: object) -> yaml.Node | None:
        """Read a value with its contents."""
        is_alias = self.check_event(yaml.AliasEvent)
        line = self.peek_event().start_mark.line + 1
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise _RefusedError(f"is nested more than {_MAX_DEPTH} deep, expected plain values")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if is_alias:
            if not hasattr(node, "num_values"):
                raise _RefusedError(f"line {line} has an alias (*) of a value that contains it")
            return node
        if isinstance(node, yaml.MappingNode):
            _check_keys(node)
        elif node.tag in _NUMBERS and not _PLAIN_NUMBER.fullmatch(node.value):
            problem = f"line {line} has the number {shortened(node.value, 40)}"
            raise _RefusedError(f"{problem}, expected decimal digits without leading zeros or _")
        node.num_values = 1 + sum(each.num_values for each in _parts(node))
        if node.num_values > _MAX_VALUES:
            problem = f"line {line} stands for more than {_MAX_VALUES} values by its aliases (*)"
            raise _RefusedError(problem)
        return node


_NUMBERS: Final = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_PLAIN_NUMBER: Final = re.compile(
    r"[-+]?(0|[1-9][0-9]*|[0-9]*\.[0-9]*|\.(inf|Inf|INF)|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?|\.(nan|NaN|NAN)"
)
"""Decimal numbers; YAML's other forms have base 2, 8 (0700) or 16, or grouped digits (7_00)."""
_EXPONENT: Final = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+")
"""JSON numbers that are text in YAML 1.1, where an exponent requires a point and a sign."""
# YAML 1.1 has numbers of base 60 (1:30:00); parsing takes quadratic time.
_PlainLoader.yaml_implicit_resolvers = {
    first: [
        (tag, re.compile(f"(?!.*:)(?:{form.pattern})", form.flags) if tag in _NUMBERS else form)
        for tag, form in resolvers
    ]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
for _first in "-+.0123456789":
    _PlainLoader.yaml_implicit_resolvers[_first].append((_NUMBERS[1], _EXPONENT))


def _parts(node: yaml.Node) -> Iterator[yaml.Node]:
    for each in () if isinstance(node, yaml.ScalarNode) else node.value:
        yield from each if isinstance(each, tuple) else (each,)


def _check_keys(node: yaml.MappingNode) -> None:
    known: set[Hashable] = set()
    for key, _ in node.value:
        name = key.value if isinstance(key, yaml.ScalarNode) else None
        line = key.start_mark.line + 1
        if name is None or key.tag == "tag:yaml.org,2002:merge":
            raise _RefusedError(f"line {line} has a merge or no key, expected NAME: VALUE")
        if name in known:
            raise _RefusedError(f"line {line} has {shortened(name, 40)!r} a second time")
        known.add(name)


def read_yaml(path: Path | str, remedy: str, *, max_bytes: int = _MAX_BYTES) -> object:
    """Read a YAML or JSON file of plain values.

    Args:
        path: The file.
        remedy: Remedy for errors.
        max_bytes: Largest size of the file.

    Raises:
        FileError: The file cannot be read, is neither YAML nor JSON, is too large, or has merges,
            duplicate keys, deep nesting or multiplying aliases.
    """
    text = read_text(path, max_bytes=max_bytes)
    try:
        # JSON allows tabs between words, YAML allows none at the start of a line.
        content: object = yaml.load(text.expandtabs(), Loader=_PlainLoader)  # noqa: S506 - a safe one
    except _RefusedError as error:
        raise FileError(path, str(error), remedy) from error
    except (yaml.YAMLError, RecursionError, *_WRONG_TAGS) as error:
        if text.startswith(_OPENCV_HEADER):
            problem = f"begins with OpenCV's header {_OPENCV_HEADER}.., which is not of YAML"
            raise FileError(path, problem, f"remove the line; {remedy}") from error
        problem = "is neither YAML nor JSON"
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f": line {mark.line + 1}, column {mark.column + 1}"
        if isinstance(error, yaml.reader.ReaderError):
            where = f": it holds the control character {chr(error.character)!a}"
        raise FileError(path, f"{problem}{where}", remedy) from error
    return content
