"""Errors of a task's own code in training: named by their samples, and never taken for an end."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from sightline.files.problem import FileError, SetupError


class EndingError(Exception):
    """Error in place of StopIteration and SystemExit: Lightning and workers would end silently."""


@contextmanager
def naming_samples(sample_ids: Callable[[], Sequence[str]]) -> Iterator[None]:
    """Name the samples in errors of own code, and replace errors that would end a loop silently.

    The message of a ValueError gets the names, unless it holds one or names a file; other errors
    get a note, and keep their type.

    Args:
        sample_ids: Function that lists the samples, called after an error; empty: unknown.

    Raises:
        EndingError: The block raises StopIteration or SystemExit.
    """
    try:
        yield
    except (StopIteration, SystemExit) as end:
        if isinstance(end.__context__, KeyboardInterrupt):
            raise
        named = f"{listed_samples(sample_ids())}: ".removeprefix(": ")
        raise EndingError(
            f"{named}the code raises {end!r}, which would end the training without a word; raise "
            "another error, or give next(..) a default"
        ) from end
    except (FileError, SetupError):
        raise
    except ValueError as error:
        names = sample_ids()
        if not names or any(name in str(error) for name in names):
            raise
        raise ValueError(f"{listed_samples(names)}: {error}") from error
    except Exception as error:
        if names := sample_ids():
            error.add_note(listed_samples(names))
        raise


def listed_samples(sample_ids: Sequence[str]) -> str:
    """Format the names of samples for a message; empty: none."""
    plural = "s" if len(sample_ids) > 1 else ""
    return f"sample{plural} {', '.join(sample_ids)}" if sample_ids else ""
