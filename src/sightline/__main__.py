"""Entry point of the command line."""

import os
import sys
import warnings
from io import TextIOWrapper


def run() -> int:
    """The exit status of the command.

    Ctrl-C, SIGTERM and SIGHUP end it in one line while it is being imported, too.
    """
    try:
        _open_standard_streams()
        from sightline.cli.interrupts import keep_interrupts

        keep_interrupts()
        from sightline.cli.main import main
        from sightline.cli.output import first_of_each_kind, format_warning
        from sightline.cli.process_limit import warn_of_few_threads

        warnings.formatwarning = format_warning
        if isinstance(sys.stdout, TextIOWrapper):  # a name need not fit the terminal's encoding
            sys.stdout.reconfigure(errors="backslashreplace")
        with first_of_each_kind():
            warn_of_few_threads()
            return main()
    except KeyboardInterrupt as error:
        print("sightline: interrupted", file=sys.stderr)
        return getattr(error, "exit_status", 130)  # 130 of Ctrl-C, by Python's own handler too


def _open_standard_streams() -> None:
    """Open the null device for closed standard streams; files and pipes would take their place.

    Python prints to stdout what is meant for a closed stderr, and compiled libraries write to
    descriptor 2 whatever it is.
    """
    descriptor = 0
    while descriptor <= 2:  # the system gives the lowest that is free
        descriptor = os.open(os.devnull, os.O_RDWR)
        os.set_inheritable(descriptor, descriptor <= 2)
    os.close(descriptor)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


if __name__ == "__main__":
    sys.exit(run())
