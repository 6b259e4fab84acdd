"""Import of the libraries of an extra at the time of use."""

import importlib
from importlib.util import find_spec
from types import ModuleType

from sightline.files.problem import Extra, install_command


def import_library(module: str, extra: Extra, *, package: str | None = None) -> ModuleType:
    """Import a module of a library that an extra installs.

    Args:
        module: Name of the module.
        extra: The extra.
        package: Name of the package, if it differs from the library's.

    Raises:
        ValueError: The library is not installed; the message has the command that installs it.
    """
    library = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        raise _not_installed(package or library, extra) from error


def require_library(library: str, extra: Extra) -> None:
    """Refuse work that needs a library which is not installed, without importing it.

    Raises:
        ValueError: See `import_library`.
    """
    if find_spec(library) is None:
        raise _not_installed(library, extra)


def _not_installed(package: str, extra: Extra) -> ValueError:
    return ValueError(f"{package} is not installed; install it with: {install_command(extra)}")
