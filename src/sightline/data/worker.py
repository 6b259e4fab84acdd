"""What a data set does in the worker processes of a `DataLoader`."""

import cv2
from torch.utils.data import get_worker_info


def keep_opencv_to_one_thread_in_workers() -> None:
    """Stops OpenCV from starting a thread per core in every worker; outside of one, nothing.

    The workers are the parallelism: threads on top make all of them wait for each other.
    """
    if get_worker_info() is not None:
        cv2.setNumThreads(0)
