import os
import re
import signal
import subprocess
import sys
import time
import warnings

import cv2
import pytest
import torch
from threadpoolctl import threadpool_info

from sightline.jobs import crew
from sightline.jobs import pool as parallel
from sightline.jobs.crew import Lost
from sightline.jobs.pool import ProcessCrew, holding_signals
from sightline.jobs.run import run_job, run_pieces


def later_first(position: int) -> str:
    """Piece that takes longer the earlier it is."""
    time.sleep(0.2 if position == 0 else 0.0)
    return f"{position}"


def one_piece_ends_its_process(position: int) -> str:
    if position == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return ""


def every_piece_ends_its_process(position: int) -> str:
    os.kill(os.getpid(), signal.SIGKILL)
    return f"{position}"


def one_piece_exhausts_an_iterator(position: int) -> str:
    return next(iter([] if position == 1 else ["done"]))


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
@pytest.mark.parametrize("workers", [1, 2])
def test_a_piece_that_exhausts_an_iterator_ends_no_job_without_a_word(workers):
    with pytest.raises(RuntimeError, match="StopIteration"):
        list(run_pieces(one_piece_exhausts_an_iterator, 3, workers))


class EndsOnce:
    """Pieces of which one ends its process when it runs for the first time, and says its number."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self, position: int) -> str:
        (self.folder / f"{position}-{os.getpid()}").touch()
        if position == 2 and len(list(self.folder.glob("2-*"))) == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        return f"{position}"


class EndsTheOther:
    """Pieces of which the last ends the worker of the first, which has nothing more to do."""

    def __init__(self, folder):
        self.folder = folder

    def __call__(self, position: int) -> str:
        (self.folder / f"{position}-{os.getpid()}").touch()
        while not (others := list(self.folder.glob(f"{1 - position}-*"))):
            time.sleep(0.01)  # so that each has a worker
        if position == 1:
            time.sleep(0.5)
            os.kill(int(others[0].name[2:]), signal.SIGKILL)
            time.sleep(0.5)
        return f"{position}"


def one_piece_raises(position: int) -> str:
    if position == 1:
        raise ZeroDivisionError("by chance")
    return ""


def process_and_thread_counts(position: int) -> str:  # noqa: ARG001
    return f"{os.getpid()} {torch.get_num_threads()} {cv2.getNumThreads()} {blas_threads()}"


def blas_threads() -> int:
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


class PanicError(BaseException):
    """Error that is no `Exception`, as in some compiled libraries."""


def one_piece_panics(position: int) -> str:
    if position == 1:
        raise PanicError("overflow in a library")
    return ""


def one_piece_hangs(position: int) -> str:
    time.sleep(60 if position == 1 else 0)
    return f"{position}"


def hundred_megabytes(position: int) -> str:
    return str(position) * 100_000_000


def warns(position: int) -> str:
    warnings.warn(f"{position // 2}.npy: a warning of {os.getpid()}", stacklevel=1)
    return f"{position}"


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
    found = {line.split()[0] for line in run_pieces(process_and_thread_counts, 8, 2)}
    assert str(os.getpid()) not in found
    threads = {tuple(line.split()[1:]) for line in run_pieces(process_and_thread_counts, 8, 2)}
    assert threads == {("1", "1", "1")}


def test_matrix_products_have_one_thread_while_a_job_runs_in_this_process():
    before = blas_threads()
    assert {line.split()[3] for line in run_pieces(process_and_thread_counts, 2, 1)} == {"1"}
    assert blas_threads() == before


def test_the_piece_of_a_worker_that_is_killed_is_done_by_another(tmp_path):
    assert list(run_pieces(EndsOnce(tmp_path), 6, 2)) == [str(i) for i in range(6)]
    assert len(list(tmp_path.glob("2-*"))) == 2


def test_a_worker_that_is_killed_while_it_has_nothing_to_do_is_no_loss(tmp_path):
    assert list(run_pieces(EndsTheOther(tmp_path), 2, 2)) == ["0", "1"]


def test_a_piece_that_ends_three_workers_is_lost_and_the_others_are_done():
    outcomes = list(run_pieces(one_piece_ends_its_process, 4, 2))
    assert outcomes[:1] + outcomes[2:] == ["", "", ""]
    reason = "its worker has ended 3 times, the last time it was ended from outside by signal 9"
    assert outcomes[1] == Lost(reason)


def test_workers_that_all_end_without_a_result_end_the_job_with_an_error():
    with pytest.raises(ChildProcessError, match=r"9 workers in a row .*use fewer workers"):
        list(run_pieces(every_piece_ends_its_process, 50, 2))


def test_an_error_of_a_piece_is_raised_with_its_traceback():
    with pytest.raises(RuntimeError, match=r"piece 1 (.|\n)*one_piece_raises(.|\n)*by chance"):
        list(run_pieces(one_piece_raises, 4, 2))


def test_a_job_that_is_not_finished_leaves_no_process():
    pieces = run_pieces(process_and_thread_counts, 50, 2)
    worker = int(next(pieces).split()[0])
    pieces.close()
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


class Faulty:
    """Piece with a fault."""

    def run(self) -> str:
        raise ValueError(f"by {os.getpid()}")


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_a_failed_job_leaves_no_process_while_its_error_is_kept():
    with pytest.raises(ValueError, match=r"by \d+") as raised:
        run_job([Faulty()] * 4, 2, description="faulty")
    worker = int(re.findall(r"by (\d+)", str(raised.value))[0])
    assert worker != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)


@pytest.mark.parametrize(
    ("ending", "to_all"), [(signal.SIGINT, True), (signal.SIGHUP, True), (signal.SIGKILL, False)]
)
def test_workers_end_with_the_program_and_say_nothing(ending: signal.Signals, to_all: bool):
    program = (
        "from sightline.jobs.run import run_job, run_pieces\n"
        "from tests.jobs.test_pool import ends_soon\n"
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


def test_what_is_no_exception_of_pythons_own_comes_back_with_its_traceback():
    with pytest.raises(RuntimeError, match=r"piece 1 (.|\n)*overflow in a library"):
        list(run_pieces(one_piece_panics, 4, 2))


def test_a_result_of_any_length_comes_back():
    assert [len(result) for result in run_pieces(hundred_megabytes, 2, 2)] == [100_000_000] * 2


def test_a_worker_that_hangs_is_replaced_and_its_piece_lost_at_the_third_time(monkeypatch):
    monkeypatch.setattr(crew, "_MAX_PIECE_S", 0.5)
    monkeypatch.setattr(crew, "_POLL_S", 0.1)
    outcomes = list(run_pieces(one_piece_hangs, 4, 2))
    assert [outcomes[i] for i in (0, 2, 3)] == ["0", "2", "3"]
    assert outcomes[1].reason.endswith("3 times, the last time it gave no result for 0.5 s")


def test_workers_that_never_start_end_the_job_with_an_error(monkeypatch):
    class Absent:
        """Crew of a cluster without a free CPU."""

        def hire(self):
            return 0

        def reports(self, timeout_s):
            time.sleep(timeout_s)
            return {}

        def hand(self, *_):
            raise AssertionError("none is ready")

        def dismiss(self, *_):
            raise AssertionError("none has a piece")

        def close(self):
            """Nothing was started."""

    monkeypatch.setattr(crew, "_MAX_PIECE_S", 0.2)
    monkeypatch.setattr(crew, "_POLL_S", 0.1)
    with pytest.raises(ChildProcessError, match=r"no worker has started .* CPUs are free"):
        list(crew.run_on_crew(Absent(), 3, 1))


def test_workers_that_cannot_be_started_end_the_job_with_an_error(monkeypatch):
    def refuse(*_, **__):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(parallel.multiprocessing, "Process", refuse)
    with pytest.raises(ChildProcessError, match=r"cannot be started: resource .*use fewer workers"):
        list(run_pieces(later_first, 4, 2))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_held_until_the_block_ends_whoever_handles_it(number):
    came = []
    previous = signal.signal(number, lambda number, _: came.append(number))
    try:
        with holding_signals():
            signal.raise_signal(number)
            assert came == []
        assert came == [number]
    finally:
        signal.signal(number, previous)


def test_ctrl_c_ends_a_job_at_whichever_of_twenty_moments_of_its_start_it_comes():
    def calls_until_the_first_result(struck: int | None) -> int:
        """Raise Ctrl-C at the given function call of the job's start."""
        count = 0

        def strike(*_):
            nonlocal count
            count += 1
            if count == struck and os.getpid() == process:
                sys.setprofile(None)
                signal.raise_signal(signal.SIGINT)

        pieces, process = run_pieces(later_first, 4, 2), os.getpid()
        sys.setprofile(strike)
        try:
            next(pieces)
        finally:
            sys.setprofile(None)
            pieces.close()
        return count

    total = min(calls_until_the_first_result(None) for _ in range(3))  # waiting takes calls, too
    for moment in range(20):
        with pytest.raises(KeyboardInterrupt):
            calls_until_the_first_result(1 + moment * (total // 2) // 20)


class Stubborn:
    """Process that ends when terminated, and records its calls."""

    def __init__(self, number, calls):
        self.number, self.calls, self.is_terminated = number, calls, False

    def join(self, timeout):
        assert timeout >= 0
        if self.is_terminated:
            self.calls.append(f"join {self.number}")

    def terminate(self):
        self.is_terminated = True
        self.calls.append(f"end {self.number}")

    def is_alive(self):
        return not self.is_terminated

    def kill(self):
        raise AssertionError("it has ended")


def test_workers_that_do_not_finish_are_all_ended_before_one_is_waited_for(monkeypatch):
    monkeypatch.setattr(parallel, "_PATIENCE_S", 0.0)
    calls = []
    pool = ProcessCrew(str)
    pool._processes = {
        number: (parallel.multiprocessing.Pipe()[0], Stubborn(number, calls)) for number in range(3)
    }
    pool.close()
    assert calls == ["end 0", "end 1", "end 2", "join 0", "join 1", "join 2"]


_BAR_OF_A_KILLED_WORKER = """
import os, signal, time
from multiprocessing import get_context
import torch
from tqdm import tqdm
from sightline.jobs.pool import take_one_thread

def work():
    take_one_thread()
    tqdm(range(2), disable=True)
    os.kill(os.getpid(), signal.SIGKILL)

if __name__ == "__main__":
    worker = get_context("spawn").Process(target=work)
    worker.start()
    worker.join()
    print(worker.exitcode)
"""


def test_a_killed_worker_leaves_no_semaphore_of_a_progress_bar(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(_BAR_OF_A_KILLED_WORKER)
    ended = subprocess.run([sys.executable, script], check=False, capture_output=True, text=True)
    assert ended.stdout == f"{-signal.SIGKILL}\n"
    assert ended.stderr == ""


def test_warnings_of_workers_are_given_in_the_process_of_the_job():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        assert list(run_pieces(warns, 4, 2)) == ["0", "1", "2", "3"]
    texts = [str(each.message) for each in caught]
    assert sorted(text[:5] for text in texts) == ["0.npy", "0.npy", "1.npy", "1.npy"]
    assert not any(str(os.getpid()) in text for text in texts)
