"""Starts the command line."""

import sys
import warnings


def run() -> int:
    """The exit status of the command.

    Ctrl-C, or SIGTERM to a training, ends it in one line while it is being imported, too.
    """
    try:
        from sightline.cli.interrupts import postpone_interrupts_while_importing

        postpone_interrupts_while_importing(sys.argv[1:])
        from sightline.cli.main import main
        from sightline.cli.parser import format_warning

        warnings.formatwarning = format_warning
        return main()
    except KeyboardInterrupt as error:
        print("sightline: interrupted", file=sys.stderr)
        return getattr(error, "exit_status", 130)  # 130 of Ctrl-C, by Python's own handler too


if __name__ == "__main__":
    sys.exit(run())
