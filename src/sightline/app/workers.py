"""Worker processes that compute parts of answers, the most urgent first; a dead one is replaced."""

import asyncio
import contextlib
import itertools
import multiprocessing
import os
import pickle
import signal
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Final

from sightline.app.parts import Answer, PartMaker, Task
from sightline.files.problem import memory_fault, plain_line
from sightline.jobs.pool import (
    HELD_SIGNALS,
    holding_signals,
    ignore_interrupts,
    take_one_thread,
)

MAX_WAITING: Final = 64
"""Most tasks that wait for a worker."""

_PATIENCE_S: Final = 1.0
_SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Variable of Python: where it is set, `python -c` does not import from the current folder."""
_URGENCY: Final = {"scene": 0, "joined": 1, "detection2d": 2, "detection3d": 3}
_LATER: Final = 4
_STARTS: Final = multiprocessing.get_context("forkserver")
_STARTS.set_forkserver_preload(["sightline.app.parts"])


class WorkerLostError(ValueError):
    """Error of a task whose worker process ended twice."""


class BusyError(ValueError):
    """Error of a task for which there is no place in the queue."""


@dataclass(eq=False, slots=True)
class _Worker:
    """Process with its channel."""

    process: BaseProcess
    channel: Connection
    done: set[str] = field(default_factory=set)
    """Parts that it has computed: it has their networks."""


@dataclass(order=True, slots=True)
class _Waiting:
    """Task that waits for a worker, ordered by urgency."""

    urgency: int
    number: int
    turn: "asyncio.Future[_Worker]" = field(compare=False)


class Workers:
    """Processes that run one task at a time each; to be used in one event loop.

    A task whose caller is cancelled leaves the queue; one that already runs is finished, and its
    answer dropped.
    """

    def __init__(self, maker: PartMaker, count: int) -> None:
        """Start the processes."""
        # by value: multiprocessing would hand over tensors in /dev/shm, which may be full
        self._maker = pickle.dumps(maker)
        _start_forkserver()
        self._idle = [self._started() for _ in range(count)]
        self._waiting: list[_Waiting] = []
        self._numbers = itertools.count()
        self.all = list(self._idle)
        self.num_replaced = 0
        self._is_closed = False

    async def run(self, task: Task) -> Answer:
        """Compute a part, a second time if its worker process ends meanwhile.

        Raises:
            ValueError: The data cannot be used, the code has a fault, the queue is full, the
                process ended twice, or the processes are closed.
        """
        end = ""
        for _ in range(2):
            if self._is_closed:  # none is started in place of one that was ended on purpose
                raise WorkerLostError("the worker processes have been ended")
            worker = await self._turn(task.part)
            if not worker.process.is_alive():  # ended while it was idle
                worker = self._replacement(worker)
            worker.done.add(task.part)
            finished = asyncio.ensure_future(asyncio.to_thread(_ask, worker, task))
            finished.add_done_callback(partial(self._return, worker))
            answer = await asyncio.shield(finished)
            if isinstance(answer, Answer):
                return answer
            if isinstance(answer, str):
                raise ValueError(answer)
            end = _end_of(worker.process)
        raise WorkerLostError(
            f"a worker process {end} twice; where memory ran out, use --workers 1"
        )

    def close(self) -> None:
        """End the processes at once: they compute, and write nothing that could be cut off."""
        self._is_closed = True
        for waiting in self._waiting:
            waiting.turn.cancel()
        for worker in self.all:  # signals all before waiting: they end in parallel
            worker.process.kill()
        for worker in self.all:
            worker.process.join(_PATIENCE_S)

    async def _turn(self, part: str) -> _Worker:
        if self._idle:
            known = [worker for worker in self._idle if part in worker.done]
            worker = (known or self._idle)[0]
            self._idle.remove(worker)
            return worker
        if len(self._waiting) >= MAX_WAITING:
            raise BusyError(f"{MAX_WAITING} tasks wait already; try again in some seconds")
        turn = asyncio.get_running_loop().create_future()
        waiting = _Waiting(_URGENCY.get(part, _LATER), next(self._numbers), turn)
        self._waiting.append(waiting)
        try:
            return await waiting.turn
        except asyncio.CancelledError:
            if waiting in self._waiting:
                self._waiting.remove(waiting)
            elif waiting.turn.done() and not waiting.turn.cancelled():
                self._hand_on(waiting.turn.result())
            raise

    def _return(self, worker: _Worker, done: "asyncio.Future[Answer | str | None]") -> None:
        if self._is_closed:
            return
        is_lost = done.cancelled() or done.exception() is not None or done.result() is None
        self._hand_on(self._replacement(worker) if is_lost else worker)

    def _replacement(self, worker: _Worker) -> _Worker:
        worker.process.kill()
        self.all.remove(worker)
        started = self._started()
        self.all.append(started)
        self.num_replaced += 1
        return started

    def _hand_on(self, worker: _Worker) -> None:
        while self._waiting:
            first = min(self._waiting)
            self._waiting.remove(first)
            if not first.turn.done():
                first.turn.set_result(worker)
                return
        self._idle.append(worker)

    def _started(self) -> _Worker:
        own_end, worker_end = _STARTS.Pipe()
        given = self._maker, worker_end, warnings.formatwarning
        process = _STARTS.Process(target=_work, args=given, daemon=True)
        with holding_signals():
            _start(process)
        worker_end.close()
        return _Worker(process, own_end)


def prepare_workers() -> None:
    """Wait until the process that forks workers is ready; signals end the wait at once.

    It imports for seconds, on a busy machine for many. `Workers` would wait for it, too, but in a
    loop of events that heeds no signal meanwhile.
    """
    _start_forkserver()
    first = _STARTS.Process(target=_do_nothing, daemon=True)
    _start(first)
    first.join()


def _start(process: BaseProcess) -> None:
    """Start a process by the one that forks workers.

    Raises:
        ChildProcessError: That one has ended.
    """
    try:
        process.start()
    except (EOFError, ConnectionError) as error:
        raise ChildProcessError(
            "the process that starts workers has ended, perhaps by the lines above or for lack of "
            "memory; run the same command again"
        ) from error


def _do_nothing() -> None:
    """Return: the process that runs it shows that processes can be started."""


def _start_forkserver() -> None:
    """Start the process that forks the workers, deaf to signals that a terminal sends to all.

    It imports for seconds, and would end by Ctrl-C with a traceback. It must not import from the
    current folder, which may be a data set.
    """
    given = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        resource_tracker.ensure_running()  # it would unblock the signals again
        before = signal.pthread_sigmask(signal.SIG_BLOCK, HELD_SIGNALS)
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    finally:
        os.environ.pop(_SAFE_PATH)
        if given is not None:
            os.environ[_SAFE_PATH] = given


def _end_of(process: BaseProcess) -> str:
    """Describe the end of a process."""
    code = process.exitcode
    if code is not None and code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    return "ended by itself"


def _ask(worker: _Worker, task: Task) -> Answer | str | None:
    """Have a worker compute a part: the answer, an error's text, or None if the process ended."""
    try:
        worker.channel.send_bytes(pickle.dumps(task))
        answer: Answer | str = pickle.loads(worker.channel.recv_bytes())  # noqa: S301 - own worker
    except (EOFError, OSError):
        worker.process.join(_PATIENCE_S)  # its exit status tells why
        return None
    return answer


def _work(pickled_maker: bytes, channel: Connection, format_warning: Callable[..., str]) -> None:
    """Compute the tasks that come through the channel, until an empty one or the parent's end."""
    setattr(warnings, "formatwarning", format_warning)  # noqa: B010 - mypy rejects an assignment
    maker: PartMaker = pickle.loads(pickled_maker)  # noqa: S301 - from our own parent
    ignore_interrupts()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD_SIGNALS)
    take_one_thread()
    parent = multiprocessing.parent_process()
    assert parent is not None, "a worker has a parent"
    with contextlib.suppress(EOFError, OSError):
        while parent.sentinel not in wait([channel, parent.sentinel]):
            data = channel.recv_bytes()
            if not data:
                return
            channel.send_bytes(pickle.dumps(_outcome(maker, pickle.loads(data))))  # noqa: S301


def _outcome(maker: PartMaker, task: Task) -> Answer | str:
    try:
        return maker.make(task)
    except (ValueError, OSError) as error:
        return plain_line(str(error))
    except Exception as error:  # noqa: BLE001 - told on the page, so that it goes on
        if (fault := memory_fault(error)) is not None:
            return fault
        with contextlib.suppress(OSError):  # standard error on a full disk
            traceback.print_exc()  # for a report of the fault
        kind = type(error).__name__
        return plain_line(
            f"{task.part} cannot be computed, by a fault of Sightline ({kind}: {error}); report "
            "it with the lines that the server has printed"
        )
