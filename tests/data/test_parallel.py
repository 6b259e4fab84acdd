import os
import signal
import subprocess
import sys
import time

import cv2
import pytest
import torch
from threadpoolctl import threadpool_info

from sightline.data.parallel import run_pieces


def later_first(position: int) -> str:
    """The earlier the piece, the longer it takes."""
    time.sleep(0.2 if position == 0 else 0.0)
    return f"{position}"


def one_piece_ends_its_process(position: int) -> str:
    if position == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return ""


def one_piece_raises(position: int) -> str:
    if position == 1:
        raise ZeroDivisionError("by chance")
    return ""


def who_and_with_how_many_threads(position: int) -> str:  # noqa: ARG001
    return f"{os.getpid()} {torch.get_num_threads()} {cv2.getNumThreads()} {blas_threads()}"


def blas_threads() -> int:
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def ends_soon(position: int) -> str:  # noqa: ARG001
    print(os.getpid(), flush=True)
    time.sleep(3)
    return ""


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_order_whoever_is_done_first(workers: int):
    assert list(run_pieces(later_first, 7, workers)) == [str(i) for i in range(7)]


@pytest.mark.parametrize("workers", [1, 3])
def test_a_job_without_pieces_is_done_at_once(workers: int):
    assert list(run_pieces(later_first, 0, workers)) == []


def test_workers_are_other_processes_with_a_thread_each():
    found = {answer.split()[0] for answer in run_pieces(who_and_with_how_many_threads, 8, 2)}
    assert str(os.getpid()) not in found
    threads = {
        tuple(answer.split()[1:]) for answer in run_pieces(who_and_with_how_many_threads, 8, 2)
    }
    assert threads == {("1", "1", "1")}


def test_matrix_products_have_one_thread_while_a_job_runs_in_this_process():
    before = blas_threads()
    assert {answer.split()[3] for answer in run_pieces(who_and_with_how_many_threads, 2, 1)} == {
        "1"
    }
    assert blas_threads() == before


def test_a_worker_that_is_killed_ends_the_job_with_an_error():
    with pytest.raises(ChildProcessError, match="use fewer workers"):
        list(run_pieces(one_piece_ends_its_process, 4, 2))


def test_what_a_piece_raises_is_shown_with_its_traceback():
    with pytest.raises(RuntimeError, match=r"piece 1 (.|\n)*one_piece_raises(.|\n)*by chance"):
        list(run_pieces(one_piece_raises, 4, 2))


def test_a_job_that_is_not_finished_leaves_no_process():
    pieces = run_pieces(who_and_with_how_many_threads, 50, 2)
    worker = int(next(pieces).split()[0])
    pieces.close()
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


@pytest.mark.parametrize(("ending", "to_all"), [(signal.SIGINT, True), (signal.SIGKILL, False)])
def test_workers_end_with_the_program_and_say_nothing(ending: signal.Signals, to_all: bool):
    program = (
        "from sightline.data.parallel import run_pieces\n"
        "from tests.data.test_parallel import ends_soon\n"
        "try:\n"
        "    list(run_pieces(ends_soon, 2, 2))\n"
        "except KeyboardInterrupt:\n"
        "    pass\n"
    )
    command = [sys.executable, "-c", program]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **pipes, start_new_session=True) as process:
        for _ in range(2):
            assert process.stdout.readline()
        if to_all:
            os.killpg(process.pid, ending)  # as a terminal does
        else:
            process.send_signal(ending)
        # The pipe ends when the last of the workers has.
        assert process.communicate(timeout=60)[1] == b""
