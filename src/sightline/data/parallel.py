"""A pool of processes for jobs of many independent pieces."""

from collections.abc import Callable, Iterator

import torch
from torch.utils.data import DataLoader, Dataset

from sightline.data.worker import keep_opencv_to_one_thread_in_workers

Piece = Callable[[int], str]
"""Does piece N of a job; returns the error, empty if there is none."""


def run_pieces(piece: Piece, count: int, workers: int) -> Iterator[str]:
    """Does pieces 0 to `count` - 1 of a job and gives what each returns, in order.

    A piece returns its error instead of raising it: from a worker an exception would come back
    wrapped in a traceback. It writes a file aside and renames it, so that a job which is stopped,
    by Ctrl-C for one, leaves whole files only.

    Args:
        piece: Picklable where workers are started afresh (macOS, Windows).
        count: Number of pieces.
        workers: Processes that work; 1 is this process alone.
    """
    yield from DataLoader(
        _Pieces(piece, count),
        batch_size=None,
        num_workers=0 if workers == 1 else min(workers, count),
        generator=torch.Generator(),  # the loader draws a seed, which must not be the global one
    )


class _Pieces(Dataset[str]):
    """One item for each piece; getting it does it.

    A data set because torch's `DataLoader` then brings all that a pool of processes needs: it
    hands over bad exits and Ctrl-C, and keeps torch to one thread in each worker.
    """

    def __init__(self, piece: Piece, count: int) -> None:
        self.piece = piece
        self.count = count

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, position: int) -> str:
        keep_opencv_to_one_thread_in_workers()
        return self.piece(position)
