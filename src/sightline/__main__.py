"""Starts the command line."""

import sys
import warnings
from io import TextIOWrapper


def run() -> int:
    """The exit status of the command.

    Ctrl-C, SIGTERM and SIGHUP end it in one line while it is being imported, too.
    """
    try:
        from sightline.cli.interrupts import keep_interrupts

        keep_interrupts()
        from sightline.cli.main import main
        from sightline.cli.output import format_warning

        warnings.formatwarning = format_warning
        if isinstance(sys.stdout, TextIOWrapper):  # a name need not fit the terminal's encoding
            sys.stdout.reconfigure(errors="backslashreplace")
        return main()
    except KeyboardInterrupt as error:
        print("sightline: interrupted", file=sys.stderr)
        return getattr(error, "exit_status", 130)  # 130 of Ctrl-C, by Python's own handler too


if __name__ == "__main__":
    sys.exit(run())
