"""The page's server from opening the data to its end."""

import errno
import logging
import secrets
import signal
import socket
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import Final

import uvicorn
from starlette.applications import Starlette

from sightline.app.guard import LOOPBACK
from sightline.app.parts import PartMaker
from sightline.app.server import PageSettings, make_app
from sightline.app.workers import prepare_workers
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.export.names import EngineChoice
from sightline.jobs.run import check_workers
from sightline.simulation.packaged import PACKAGED_FRAMES

_PATIENCE_S: Final = 0
"""Time for answers under way when the server is told to end: they may take minutes."""


def serve_page(
    data: Path | None,
    *,
    host: str | None,
    port: int,
    browser: bool,
    workers: int,
    velodyne: Velodyne | None,
    engine: EngineChoice,
    announce: Callable[[str], None],
) -> None:
    """Serve the page until Ctrl-C.

    Args:
        data: Folder of the data set; None: the packaged frames.
        host: Address to listen on, for other machines, too; None: only this machine.
        port: Port; 0: any free one.
        browser: Whether to open the browser.
        workers: Number of worker processes.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        engine: Engine of the networks.
        announce: Called with the page's address.

    Raises:
        ValueError: The data cannot be opened, or the server cannot listen there.
    """
    check_workers(workers)
    if not 0 <= port <= 65535:
        raise ValueError(f"--port must be from 0 to 65535, got {port}; give 8000, or 0 for any")
    folder = data or PACKAGED_FRAMES
    dataset = open_dataset(
        folder, velodyne=velodyne, parts=("image", "points", "objects"), needs=()
    )
    if not len(dataset):
        raise ValueError(f"{folder} has no frames; give a folder of a data set with some")
    token = None if host is None else secrets.token_urlsafe(24)
    settings = PageSettings(
        data=folder,
        dataset=dataset,
        title="packaged frames" if data is None else data.resolve().name,
        workers=workers,
        engine=engine,
        hosts=LOOPBACK,
        token=token,
    )
    listening = _listen(host or LOOPBACK[0], port)
    address = f"http://{_shown(host)}:{listening.getsockname()[1]}/"
    address += f"?token={token}" if token else ""
    server = page_server(make_app(settings, PartMaker(dataset, folder, engine)))
    with listening:
        announce(address)
        prepare_workers()
        if browser:  # in a thread: one in a terminal, such as w3m, waits for the page
            Thread(target=webbrowser.open, args=(address,), daemon=True).start()
        server.run(sockets=[listening])


def page_server(app: Starlette) -> uvicorn.Server:
    """Make the server of an application, which ends soon when it is told to."""
    return _Server(
        uvicorn.Config(
            app,
            log_level="error",
            access_log=False,
            server_header=False,
            ws="none",
            timeout_graceful_shutdown=_PATIENCE_S,
        )
    )


class _Server(uvicorn.Server):
    """Server that drops the answers under way when it is told to end, also by SIGHUP."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """End by SIGHUP (a closed terminal) as by SIGTERM, unless it is ignored or in a thread."""
        earlier = signal.getsignal(signal.SIGHUP)
        with super().capture_signals():
            if earlier != signal.SIG_IGN and current_thread() is main_thread():
                signal.signal(signal.SIGHUP, self.handle_exit)
            try:
                yield
            finally:  # before the signal is raised again
                if current_thread() is main_thread():
                    signal.signal(signal.SIGHUP, earlier)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # dropped ones are no faults
        await super().shutdown(sockets)


def _shown(host: str | None) -> str:
    if host is None:
        return LOOPBACK[0]
    if host in ("0.0.0.0", "::"):  # noqa: S104 - asked for by --host
        return socket.gethostname()
    return _bracketed(host)


def _bracketed(address: str) -> str:
    return f"[{address}]" if ":" in address else address


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (while")[0].lower()
        remedy = (
            "another --port, or 0 for any"
            if error.errno in (errno.EADDRINUSE, errno.EACCES)
            else "an address of this machine by --host, such as 0.0.0.0 for all of them"
        )
        raise ValueError(
            f"the page cannot be served on {host}, port {port}: {reason}; give {remedy}"
        ) from error
