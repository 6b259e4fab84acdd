"""Answers kept in bounded memory; what several wait for is computed once."""

import asyncio
from collections import OrderedDict
from collections.abc import AsyncGenerator, Awaitable, Callable, Hashable
from functools import partial
from typing import Final, get_args

from sightline.app.parts import Answer, PartName, Task
from sightline.app.state import PageState
from sightline.joining.models import JOINED

MAX_KEPT_BYTES: Final = 96 * 2**20
"""Most memory of kept answers."""

_DETECTORS: Final[tuple[PartName, PartName]] = ("detection2d", "detection3d")


class Answers:
    """Parts of answers by state, the last used of them kept."""

    def __init__(
        self,
        compute: Callable[[Task], Awaitable[Answer]],
        max_bytes: int = MAX_KEPT_BYTES,
        stamp: Callable[[str], Hashable] | None = None,
    ) -> None:
        """Begin with none.

        Args:
            compute: Computes a part, such as `Workers.run`.
            max_bytes: Most memory of kept answers.
            stamp: Stamp of a frame's files, such as `PartMaker.stamp`; None: they do not change.
        """
        self._stamp = stamp
        self._compute = compute
        self._max_bytes = max_bytes
        self._kept: OrderedDict[Hashable, Answer] = OrderedDict()
        self._num_bytes = 0
        self._running: dict[Hashable, _Shared] = {}

    async def part(self, name: PartName, state: PageState) -> Answer:
        """Compute a part of the answer, or take the kept one.

        Raises:
            ValueError: From `compute`.
        """
        stamp = None if self._stamp is None else self._stamp(state.broken.frame)
        key = stamp, _key(name, state)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        shared = self._running.get(key)
        if shared is None or shared.is_abandoned:
            shared = self._running[key] = _Shared(asyncio.create_task(self._make(name, state)))
            shared.task.add_done_callback(partial(self._ended, key))
        answer = await shared.result()
        if key not in self._kept:
            self._keep(key, answer)
        return answer

    async def parts(self, state: PageState) -> AsyncGenerator[tuple[PartName, Answer | ValueError]]:
        """Compute all parts but the scene and yield them as they come.

        A part that fails yields its error, and the others go on. Parts that nobody waits for any
        more are cancelled when the iterator is closed.
        """
        names = [name for name in get_args(PartName) if name != "scene"]
        pending = {asyncio.create_task(self.part(name, state)): name for name in names}
        try:
            while pending:
                done, _ = await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    name = pending.pop(task)
                    error = task.exception()
                    if error is not None and not isinstance(error, ValueError):
                        raise error
                    yield name, task.result() if error is None else error
        finally:
            for task in pending:
                task.cancel()

    async def _make(self, name: PartName, state: PageState) -> Answer:
        found = (b"", b"")
        if name == JOINED:
            image, sweep = await asyncio.gather(*(self.part(each, state) for each in _DETECTORS))
            found = (image.found, sweep.found)
        return await self._compute(Task(part=name, state=state, found=found))

    def _ended(self, key: Hashable, task: "asyncio.Task[Answer]") -> None:
        if key in self._running and self._running[key].task is task:
            del self._running[key]

    def _keep(self, key: Hashable, answer: Answer) -> None:
        self._kept[key] = answer
        self._num_bytes += answer.num_bytes
        while self._num_bytes > self._max_bytes:
            _, dropped = self._kept.popitem(last=False)
            self._num_bytes -= dropped.num_bytes


class _Shared:
    """Computation that is cancelled once all who wait for it are."""

    def __init__(self, task: "asyncio.Task[Answer]") -> None:
        self.task = task
        self.is_abandoned = False
        self._num_waiting = 0

    async def result(self) -> Answer:
        self._num_waiting += 1
        try:
            return await asyncio.shield(self.task)
        except asyncio.CancelledError:
            if self._num_waiting == 1:
                self.is_abandoned = True
                self.task.cancel()
            raise
        finally:
            self._num_waiting -= 1


def _key(name: PartName, state: PageState) -> Hashable:
    """Make the key of all that a part depends on, without weights of other tasks."""
    if name in ("scene", "health"):
        return name, state.broken
    needed = _DETECTORS if name == JOINED else (name,)
    return name, state.broken, tuple(state.weights_for(each) for each in needed)
