"""How the command line reads its arguments and refuses them."""

import re
import sys
from functools import reduce
from typing import Any, Literal, NoReturn

import jsonargparse

Method = Literal["nearest", "linear", "classical", "adaptive"]
Engine = Literal["torch", "onnxruntime", "openvino"]
Device = Literal["cpu", "cuda"]
Velodyne = Literal["velodyne", "velodyne_reduced"]
LidarModel = Literal["hdl-64e", "hdl-32e", "vlp-16"]

REFUSED = 2
"""Exit status."""

_NUMBER_LISTS = ("--beams", "--ious", "--image-size")


class OneLineParser(jsonargparse.ArgumentParser):
    """Refuses arguments in one line, and writes options with dashes."""

    def add_argument(self, *names: str, **settings: Any) -> Any:  # noqa: ANN401 - as jsonargparse
        """Adds an argument; a Boolean one becomes a flag without a value."""
        dashed = [
            name.replace("_", "-") if name.startswith("--") and name != "--print_config" else name
            for name in names
        ]
        if settings.get("type") is bool:  # `--overwrite`, not `--overwrite true`
            del settings["type"]
            settings["action"] = jsonargparse.ActionYesNo(no_prefix="no-")
        return super().add_argument(*dashed, **settings)

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        """Ends the program."""
        del ex  # its text is in the message
        sys.exit(fail(f"{message}; see sightline --help", REFUSED))


def fail(message: str, status: int) -> int:
    """Writes a message in one line to standard error; gives the exit status back."""
    one_line = re.sub(r"\s+", " ", message).strip()
    print(f"sightline: {one_line}", file=sys.stderr)
    return status


def join_number_lists(arguments: list[str]) -> list[str]:
    """Lets `--beams 64 32` stand for the list that jsonargparse writes `--beams=[64,32]`."""
    return reduce(_join_numbers, _NUMBER_LISTS, arguments)


def _join_numbers(arguments: list[str], option: str) -> list[str]:
    if option not in arguments:
        return arguments
    start = arguments.index(option)
    end = start + 1
    while end < len(arguments) and re.fullmatch(r"[0-9.]+", arguments[end]):
        end += 1
    if end == start + 1:
        return arguments  # the parser says what is wrong
    joined = f"{option}=[{','.join(arguments[start + 1 : end])}]"
    return [*arguments[:start], joined, *arguments[end:]]
