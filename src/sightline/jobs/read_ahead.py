"""Threads that read files a little ahead of their use."""

import itertools
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

MAX_WORKERS = 256
_QUEUED_PER_WORKER = 4


def map_ahead(
    function: Callable[[Item], Result], items: Iterable[Item], *, workers: int
) -> Iterator[Result]:
    """Map a function over items in order, in threads that run a few items ahead.

    Raises:
        ValueError: `workers` is not 1 to `MAX_WORKERS`.
    """
    check_threads(workers)
    return _map_ahead(function, iter(items), workers)


def check_threads(workers: int) -> None:
    """Refuse a number of threads that is not 1 to `MAX_WORKERS`.

    Raises:
        ValueError: The number is out of range.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if workers > MAX_WORKERS:
        raise ValueError(f"workers must be at most {MAX_WORKERS}, got {workers}")


def _map_ahead(
    function: Callable[[Item], Result], remaining: Iterator[Item], workers: int
) -> Iterator[Result]:
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for item in itertools.islice(remaining, _QUEUED_PER_WORKER * workers):
                waiting.append(pool.submit(function, item))
            while waiting:
                yield waiting.popleft().result()
                for item in itertools.islice(remaining, 1):
                    waiting.append(pool.submit(function, item))
        finally:
            pool.shutdown(cancel_futures=True)
