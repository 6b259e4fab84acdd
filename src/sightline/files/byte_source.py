"""Reading of byte ranges from local files, and from any file system that fsspec opens."""

import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

from sightline.files.extras import import_library
from sightline.files.plain_file import check_regular
from sightline.files.problem import FileError, address, shown_place

_NOT_THERE: Final = (404, 410)  # status of a file that a server does not have
_FIRST_FAULT: Final = 500  # status of the server's own faults
_PASSING: Final = (408, 425, 429, 500, 502, 503, 504)  # status of a server that is busy, say
_WAITS_S: Final = (0.5, 1.0, 2.0)  # before each further attempt
_TIMEOUT_S: Final = 15.0  # of a server that accepts a connection, and says nothing
_BROKEN_OFF: Final = ("ClientPayloadError", "ServerDisconnectedError", "ClientOSError")
"""Names of aiohttp's errors for answers that end early."""
_REMEDY: Final = "check the address, the network and your rights"
_LOCAL_REMEDY: Final = "copy it again, or make it again by the same command"


_Answer = TypeVar("_Answer")


class RefusedError(FileError):
    """Error for a file that a server refuses to give: some answer 403 where there is none."""


def url_of(path: Path) -> str | None:
    """URL of a path such as s3:/bucket/shards; None: a path on this machine."""
    url = address(path)
    return url if url is not None and not path.exists() else None


def check_no_address(output: Path) -> None:
    """Refuse an output at an address: it would become a folder such as s3: on this machine.

    Raises:
        ValueError: It is an address.
    """
    if address(output) is not None:
        raise ValueError(
            f"{shown_place(output)} is an address, and outputs are written to this machine; name a "
            "folder or file here, and copy it there afterwards"
        )


def read_range(path: Path, start: int, length: int) -> bytes:
    """Read a range of a file, on this machine or by its URL.

    Raises:
        FileError: The file cannot be read, or ends within the range.
        ValueError: The server of the URL ignores ranges.
    """
    url = url_of(path)
    try:
        if url is None:
            check_regular(path, max_bytes=sys.maxsize, remedy=_LOCAL_REMEDY)
            with path.open("rb") as file:
                file.seek(start)
                content = file.read(length)
        else:
            system, place = _file_system(url)
            content = _tried(lambda: system.cat_file(place, start=start, end=start + length))
    except ValueError:
        raise  # an extra that is not installed
    except Exception as error:  # file systems of other packages raise their own types
        raise _unreadable(path, error) from error
    if len(content) > length:  # no fault of one file: other files would fail by it, too
        raise ValueError(
            f"{shown_place(path)} comes whole where {length} bytes were asked for: its server "
            "ignores ranges; take a web server that answers them, or copy the shards to this "
            "machine"
        )
    if len(content) < length:
        raise FileError(
            path,
            f"ends {_end(path, start, len(content))}, expected {length} bytes from {start}",
            _LOCAL_REMEDY,
        )
    return content


def read_small(path: Path, max_bytes: int) -> bytes | None:
    """Read a whole file of limited length; None: there is none.

    A web page is none: some servers send their start page for every file that they lack.

    Raises:
        RefusedError: The server refuses the file.
        FileError: The file cannot be read, or is longer.
    """
    url = url_of(path)
    try:
        if url is None:
            size = path.stat().st_size
        else:
            system, place = _file_system(url)
            size = _known_size(path, _tried(lambda: system.info(place)))
    except (FileNotFoundError, NotADirectoryError) as error:
        cause = error.__cause__  # fsspec says so, too, of servers that cannot be reached
        if isinstance(cause, Exception) and getattr(cause, "status", 0) not in _NOT_THERE:
            raise _unreadable(path, cause) from error
        return None
    except ValueError:
        raise
    except Exception as error:  # see above
        raise _unreadable(path, error) from error
    if size > max_bytes:
        problem = f"is {size} bytes long, expected up to {max_bytes}"
        raise FileError(path, problem, "get the data from a source that you trust")
    content = read_range(path, 0, size)
    return None if url is not None and content.lstrip().startswith(b"<") else content


def _end(path: Path, start: int, num_read: int) -> str:
    """Place of the end of a file of which fewer bytes were read than requested."""
    if num_read:
        return f"at byte {start + num_read}"
    if url_of(path) is None:
        return f"at byte {path.stat().st_size}"
    return f"before byte {start + 1}"


def _tried(request: Callable[[], _Answer]) -> _Answer:
    """Send a request, and repeat it a few times if the fault passes: a server that is busy."""
    for wait_s in _WAITS_S:
        try:
            return request()
        except Exception as error:  # as above
            status = getattr(error.__cause__ or error, "status", None)
            if status not in _PASSING and type(error).__name__ not in _BROKEN_OFF:
                raise
        time.sleep(wait_s)
    return request()


def _known_size(path: Path, info: Mapping[str, Any]) -> int:
    if info.get("size") is None:
        raise ValueError(
            f"{shown_place(path)}: its server does not tell its length; take a web server that "
            "answers ranges, or copy the shards to this machine"
        )
    return int(info["size"])


def _file_system(url: str) -> tuple[Any, str]:
    """File system of a URL, and the place in it; fsspec keeps one for each process."""
    scheme = url.partition("://")[0]
    fsspec = import_library("fsspec", "remote")
    options: dict[str, Any] = {}
    if scheme in ("http", "https"):
        aiohttp = import_library("aiohttp", "remote")
        timeout = aiohttp.ClientTimeout(sock_connect=_TIMEOUT_S, sock_read=_TIMEOUT_S)
        options["client_kwargs"] = {"timeout": timeout}
    try:
        system, place = fsspec.core.url_to_fs(url, **options)
    except ImportError as error:  # s3fs, say, which another package brings
        raise ValueError(f"{shown_place(url)}: {error}") from error
    except ValueError as error:
        raise ValueError(
            f"{shown_place(url)} cannot be read: {scheme} is no known protocol"
        ) from error
    return system, str(place)


def _unreadable(path: Path, error: Exception) -> FileError:
    if isinstance(error, FileNotFoundError) and url_of(path) is not None:
        return FileError(path, "is absent", "copy it to the server, or make the shards again")
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    status = getattr(error, "status", None)
    if status == 0:  # aiohttp's for a circle
        return RefusedError(path, "cannot be read: its server redirects without an end", _REMEDY)
    if status is not None:  # not the library's text, which has the address
        kind = FileError if status >= _FIRST_FAULT else RefusedError
        return kind(path, f"cannot be read: its server answers {status}", _REMEDY)
    remedy = _LOCAL_REMEDY if url_of(path) is None else _REMEDY
    return FileError(path, f"cannot be read: {reason}", remedy)
