"""How the command line reads its arguments and refuses them."""

import argparse
import sys
from collections.abc import Sequence
from typing import Any, Literal, NoReturn

import jsonargparse

from sightline.cli.refusal import plain_refusal
from sightline.data.plain_text import shortened
from sightline.data.problem import one_line

Device = Literal["cpu", "cuda"]

REFUSED = 2
"""Exit status."""

_LISTS: dict[str, tuple[type[int] | type[float] | type[str], int | None]] = {
    "--beams": (int, None),
    "--by-distance": (float, None),
    "--ious": (float, None),
    "--image-size": (int, 2),
    "--cases": (str, None),
    "--results": (str, None),
    "--healthy": (str, None),
    "--compare": (str, 2),
}
"""Options that take several values: of which type, and how many where that is fixed."""

_MAY_BE_LEFT_OUT = ("--out-folder",)
"""Arguments without dashes that are not always needed: the command refuses where they are."""
_SEVERAL = ("frames",)
"""Arguments without dashes of which there may be several, one at least."""
_SHORT = {"--page": "-o"}


class OneLineParser(jsonargparse.ArgumentParser):
    """Refuses arguments in one line, and writes options with dashes."""

    def __init__(self, *args: Any, **settings: Any) -> None:  # noqa: ANN401 - as jsonargparse
        # An abbreviation would mean something else as soon as there is another option.
        super().__init__(*args, **{"allow_abbrev": False, **settings})

    def add_argument(self, *names: str, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        """Adds an argument; a Boolean one becomes a flag without a value."""
        dashed = [
            name.replace("_", "-") if name.startswith("--") and name != "--print_config" else name
            for name in names
        ]
        if settings.get("type") is bool:  # `--overwrite`, not `--overwrite true`
            del settings["type"]
            settings["action"] = jsonargparse.ActionYesNo(no_prefix="no-")
        if dashed[0] in _LISTS:
            settings["action"] = _ValueList
        if dashed[0] in _MAY_BE_LEFT_OUT:
            dashed, settings["nargs"] = ["out_folder"], "?"
        if dashed[0] in _SEVERAL:
            settings |= {"action": "store", "type": str, "nargs": "+"}
        if dashed[0] in _SHORT:
            dashed.append(_SHORT[dashed[0]])
        return super().add_argument(*dashed, **settings)

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Ends the program."""
        del ex  # its text is in the message
        sys.exit(fail(plain_refusal(message, str(self.prog)), REFUSED))


class _ValueList(argparse.Action):
    """Takes `--beams 64 32` and `--beams 64,32`, where jsonargparse knows `--beams=[64,32]`."""

    def __init__(self, **settings: Any) -> None:  # noqa: ANN401 - as argparse
        value_type, _ = _LISTS[settings["option_strings"][0]]
        metavar = "NAME" if value_type is str else "NUMBER"
        super().__init__(nargs="+", metavar=metavar, **settings)

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,  # noqa: ANN401 - as argparse
        option_string: str | None = None,
    ) -> None:
        """Sets the tuple that the words which follow the option stand for."""
        del parser, option_string
        option = self.option_strings[0]
        value_type, count = _LISTS[option]
        try:
            words = [word for value in values for word in value.strip("[]").split(",")]
            parsed = tuple(map(value_type, words))
        except ValueError:
            raise argparse.ArgumentError(
                self,
                f"expected numbers, got {' '.join(values)}; write them last or as {option}=1,2",
            ) from None
        if count is not None and len(parsed) != count:
            what = "names" if value_type is str else "numbers"
            raise argparse.ArgumentError(self, f"expected {count} {what}, got {len(parsed)}")
        setattr(namespace, self.dest, parsed)


def refuse_other_encodings(arguments: Sequence[str]) -> None:
    """Refuse arguments that are not UTF-8, as names of another encoding's file systems are.

    Raises:
        ValueError: One is not.
    """
    for argument in arguments:
        try:
            argument.encode()
        except UnicodeEncodeError:
            raise ValueError(
                f"the name {shortened(argument, 200)} is not UTF-8, perhaps Latin-1; rename it, or "
                "give a link to it of another name"
            ) from None


def format_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    line: str | None = None,
) -> str:
    """A warning as one line for whoever gave the command; as `warnings.formatwarning`."""
    del category, filename, lineno, line
    return f"sightline: warning: {one_line(str(message))}\n"


def fail(message: str, status: int) -> int:
    """Writes a message in one line to standard error; gives the exit status back."""
    print(f"sightline: {one_line(message)}", file=sys.stderr)
    return status
