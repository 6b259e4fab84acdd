"""Actors of a Ray cluster as workers of a job."""

import itertools
import os
import signal
from pathlib import Path
from typing import Any, Final

from sightline.files.extras import import_library
from sightline.files.plain_text import shortened
from sightline.files.problem import plain_line
from sightline.geometry.user_warning import warn_user
from sightline.jobs.crew import Piece, Report, report_of
from sightline.jobs.pool import HELD_SIGNALS, take_one_thread

_TOKENS: Final = ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")
_TOKEN_FILE: Final = Path(".ray", "auth_token")  # in the home
_MAX_REASON: Final = 300  # characters
_PATIENCE_S: Final = 5.0
"""Time for workers to finish their current pieces when the job is stopped."""


class RayCrew:
    """Actors with one CPU each, on any nodes of a running cluster.

    An actor that finds no free CPU waits without a piece, so it stops nobody; an actor whose node
    dies counts as a worker that has ended. All nodes need the same folders, such as a shared disk,
    and the same environment.
    """

    def __init__(self, piece: Piece) -> None:
        """Connect to the cluster of RAY_ADDRESS, or that of this machine.

        Raises:
            ChildProcessError: No cluster is running.
            ValueError: Ray is not installed.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        os.environ.setdefault("RAY_AUTH_MODE", _auth_mode())  # Ray's default depends on the release
        self._ray: Any = import_library("ray", "ray")
        self._is_own = not self._ray.is_initialized()
        if self._is_own:
            self._connect()
        self._warn_of_busy_cluster()
        self._piece = self._ray.put(piece)
        self._make = self._ray.remote(num_cpus=1, max_restarts=0)(_Actor).remote
        self._actors: dict[int, Any] = {}
        self._expected: dict[Any, int] = {}  # of the reports to come: their workers
        self._pieces: set[Any] = set()  # among them, those of pieces
        self._numbers = itertools.count()

    def _connect(self) -> None:
        handlers = {number: signal.getsignal(number) for number in HELD_SIGNALS}
        try:
            self._ray.init(address="auto", log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ChildProcessError(
                f"no Ray cluster can be reached ({_reason(error)}); start one "
                "by: ray start --head, or name it by RAY_ADDRESS"
            ) from error
        for number, handler in handlers.items():  # Ray replaces that of SIGTERM
            signal.signal(number, handler)

    def _warn_of_busy_cluster(self) -> None:
        """Warn if no CPU is free, as actors then wait without a word."""
        if self._ray.available_resources().get("CPU", 0) < 1:
            number = self._ray.cluster_resources().get("CPU", 0)
            warn_user(
                f"no CPU of the Ray cluster is free, it has {number:g} in all: the job waits for "
                "one; start further nodes by: ray start --address HEAD:6379",
            )

    def hire(self) -> int:
        """Request an actor."""
        number, actor = next(self._numbers), self._make(self._piece, str(Path.cwd()))
        self._actors[number] = actor
        self._expected[actor.start.remote()] = number
        return number

    def hand(self, worker: int, position: int) -> None:
        """Send an actor the number of its next piece."""
        reference = self._actors[worker].run.remote(position)
        self._expected[reference] = worker
        self._pieces.add(reference)

    def reports(self, timeout_s: float) -> dict[int, Report]:
        """Fetch the results of actors, and note those that have died."""
        pending = list(self._expected)
        ready, _ = self._ray.wait(pending, num_returns=1, timeout=timeout_s)
        reports = {}
        for reference in ready:
            worker = self._expected.pop(reference)
            self._pieces.discard(reference)
            try:
                reports[worker] = Report(*self._ray.get(reference))
            except self._ray.exceptions.RayError as error:
                reports[worker] = Report(ended=f"ended: {_reason(error)}")
            if reports[worker].ended:
                self.dismiss(worker)
        return reports

    def dismiss(self, worker: int) -> None:
        """Kill an actor."""
        actor = self._actors.pop(worker)
        for reference in [each for each, number in self._expected.items() if number == worker]:
            del self._expected[reference]
            self._pieces.discard(reference)
        self._ray.kill(actor, no_restart=True)

    def close(self) -> None:
        """Let every actor finish its piece, end them all, and leave the cluster."""
        if self._pieces:
            pieces = list(self._pieces)
            self._ray.wait(pieces, num_returns=len(pieces), timeout=_PATIENCE_S)
        for worker in list(self._actors):
            self.dismiss(worker)
        if self._is_own:
            self._ray.shutdown()


class _Actor:
    """Worker on a node of the cluster."""

    def __init__(self, piece: Piece, folder: str) -> None:
        self._piece = piece
        self._folder = folder

    def start(self) -> tuple[object, ...]:
        """Enter the folder of the command, by which relative paths are meant."""
        try:
            os.chdir(self._folder)
        except OSError as error:
            return tuple(Report(ended=f"found no folder {self._folder} on its node: {error}"))
        take_one_thread()
        return tuple(Report())

    def run(self, position: int) -> tuple[object, ...]:
        """Run a piece."""
        return tuple(report_of(self._piece, position))


def _auth_mode() -> str:
    """Mode of authentication: by token, if there is one."""
    has_token = any(name in os.environ for name in _TOKENS) or (Path.home() / _TOKEN_FILE).is_file()
    return "token" if has_token else "disabled"


def _reason(error: Exception) -> str:
    """Beginning and end of an error's text, which for an actor are its death and the cause."""
    lines = [line for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    return shortened(plain_line(" .. ".join(dict.fromkeys((lines[0], lines[-1])))), _MAX_REASON)
