"""Starts the command line."""

import sys
import warnings


def run() -> int:
    """The exit status of the command; Ctrl-C while it is being imported ends it in one line too."""
    try:
        from sightline.cli.interrupts import postpone_interrupts_while_importing

        postpone_interrupts_while_importing()
        from sightline.cli.main import main
        from sightline.cli.parser import format_warning

        warnings.formatwarning = format_warning
        return main()
    except KeyboardInterrupt:
        print("sightline: interrupted", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(run())
