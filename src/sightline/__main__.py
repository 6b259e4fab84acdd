"""Starts the command line."""

import sys


def run() -> int:
    """The exit status of the command; Ctrl-C while it is being imported ends it in one line too."""
    try:
        from sightline.cli.main import main
    except KeyboardInterrupt:
        print("sightline: interrupted", file=sys.stderr)
        return 130
    return main()


if __name__ == "__main__":
    sys.exit(run())
