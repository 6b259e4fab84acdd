import asyncio
import os
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import pytest
import torch

from sightline.app.parts import Answer, Task
from sightline.app.state import parse_state
from sightline.app.workers import MAX_WAITING, BusyError, WorkerLostError, Workers
from sightline.cli.output import format_warning
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.app.makers import QuickMaker, dataset

FRAMES = ("000000", "000001")


def task(part, query=""):
    return Task(part=part, state=parse_state(query, FRAMES))


@pytest.fixture
def workers():
    made = Workers(QuickMaker(dataset(), PACKAGED_FRAMES, "torch"), 1)
    yield made
    made.close()
    assert not any(worker.process.is_alive() for worker in made.all)


def test_a_killed_worker_is_replaced_and_its_task_done_again(workers):
    async def run():
        await workers.run(task("detection2d"))
        slow = asyncio.create_task(workers.run(task("detection2d", "fault=lidar_fog.1.7")))
        await asyncio.sleep(0.2)
        os.kill(workers.all[0].process.pid, signal.SIGKILL)
        answer = await slow
        assert answer.content == {"by": "detection2d-fast-cpu"}
        assert workers.num_replaced == 1

    asyncio.run(run())


def test_warnings_of_workers_are_formatted_like_those_of_their_parent(monkeypatch):
    monkeypatch.setattr("warnings.formatwarning", format_warning)
    made = Workers(WarningMaker(dataset(), PACKAGED_FRAMES, "torch"), 1)
    try:
        answer = asyncio.run(made.run(task("scene")))
    finally:
        made.close()
    assert answer.content == {"text": "sightline: warning: of a worker\n"}


class WarningMaker(QuickMaker):
    """Maker whose answers are formatted warnings."""

    def make(self, task):
        del task
        text = warnings.formatwarning("of a worker", UserWarning, "file.py", 1)
        return Answer(content={"text": text})


def parent_of(pid):
    return int(Path(f"/proc/{pid}/status").read_text().split("PPid:")[1].split()[0])


def test_a_terminal_s_signals_end_workers_alone_and_not_what_starts_them(workers):
    async def run():
        worker = workers.all[0].process
        starter = parent_of(worker.pid)
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
            os.kill(starter, number)
        await workers.run(task("detection2d"))
        os.kill(worker.pid, signal.SIGTERM)
        worker.join()
        assert worker.exitcode == -signal.SIGTERM
        await workers.run(task("detection2d"))
        assert parent_of(workers.all[0].process.pid) == starter

    asyncio.run(run())


def test_workers_that_end_while_they_are_idle_cost_no_answer():
    made = Workers(QuickMaker(dataset(), PACKAGED_FRAMES, "torch"), 2)

    async def run():
        await asyncio.gather(*(made.run(task("detection2d")) for _ in range(2)))
        for worker in made.all:
            os.kill(worker.process.pid, signal.SIGKILL)
            worker.process.join()
        assert (await made.run(task("detection2d"))).found == b"detection2d"
        assert made.num_replaced == 1

    asyncio.run(run())
    made.close()


def test_pictures_overtake_what_waits_and_a_cancelled_task_leaves_the_queue(workers):
    async def run():
        order = []

        async def note(part, query=""):
            await workers.run(task(part, query))
            order.append(part)

        first = asyncio.create_task(note("detection3d", "fault=lidar_fog.1.7"))
        await asyncio.sleep(0.1)
        later = [asyncio.create_task(note(part)) for part in ("depth-completion", "detection2d")]
        dropped = asyncio.create_task(note("detection3d"))
        urgent = asyncio.create_task(note("scene"))
        await asyncio.sleep(0)
        dropped.cancel()
        await asyncio.gather(first, *later, urgent)
        assert order == ["detection3d", "scene", "detection2d", "depth-completion"]

    asyncio.run(run())


def test_the_queue_is_bounded(workers):
    async def run():
        waiting = [
            asyncio.create_task(workers.run(task("health", "fault=lidar_fog.1.7")))
            for _ in range(MAX_WAITING + 1)
        ]
        await asyncio.sleep(0.05)
        with pytest.raises(BusyError, match="64 tasks wait already"):
            await workers.run(task("health"))
        for each in waiting:
            each.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)

    asyncio.run(run())


def test_errors_of_a_frame_come_as_one_line(workers):
    async def run():
        with pytest.raises(ValueError, match="damaged") as fault:
            await workers.run(task("detection3d", "fault=lidar_fog.1.8"))
        assert "\n" not in str(fault.value)
        assert workers.num_replaced == 0

    asyncio.run(run())


def test_a_fault_of_the_code_is_told_as_such_and_its_worker_goes_on(workers):
    async def run():
        with pytest.raises(
            ValueError, match="detection3d cannot be computed, by a fault of"
        ) as told:
            await workers.run(task("detection3d", "fault=lidar_fog.1.6"))
        assert "(TypeError: an index" in str(told.value)
        assert "\n" not in str(told.value)
        assert workers.num_replaced == 0

    asyncio.run(run())


@pytest.mark.parametrize(("seed", "cause"), [(9, "was ended by SIGKILL"), (5, "ended by itself")])
def test_the_cause_of_a_worker_s_end_is_told(workers, seed, cause):
    async def run():
        with pytest.raises(WorkerLostError, match=f"a worker process {cause} twice"):
            await workers.run(task("detection3d", f"fault=lidar_fog.1.{seed}"))
        assert workers.num_replaced == 2
        assert (await workers.run(task("detection2d"))).found == b"detection2d"

    asyncio.run(run())


def test_closing_ends_all_processes_before_it_waits_for_any(monkeypatch):
    made = Workers(QuickMaker(dataset(), PACKAGED_FRAMES, "torch"), 2)
    processes = [worker.process for worker in made.all]
    calls = []
    for name in ("kill", "join"):
        original = getattr(type(processes[0]), name)

        def note(process, *given, name=name, original=original):
            if threading.current_thread() is threading.main_thread():
                calls.append(name)
            return original(process, *given)

        monkeypatch.setattr(type(processes[0]), name, note)

    async def run():
        asking = [
            asyncio.create_task(made.run(task("detection3d", "fault=lidar_fog.1.4")))
            for _ in range(3)  # of an hour each; one waits for its turn
        ]
        await asyncio.sleep(0.2)
        made.close()
        assert calls == ["kill", "kill", "join", "join"]
        answers = await asyncio.gather(*asking, return_exceptions=True)
        assert [type(each) for each in answers[:2]] == [WorkerLostError] * 2
        assert isinstance(answers[2], asyncio.CancelledError)
        with pytest.raises(WorkerLostError, match="have been ended"):
            await made.run(task("detection3d"))

    asyncio.run(run())
    assert made.num_replaced == 0
    assert not any(process.is_alive() for process in processes)


_WAITING = """
import signal, threading, time
from sightline.app import workers
from sightline.cli.interrupts import keep_interrupts
keep_interrupts()
workers._STARTS.set_forkserver_preload(["slow"])
threading.Timer(1, signal.pthread_kill, (threading.get_ident(), signal.SIGTERM)).start()
started_s = time.monotonic()
try:
    workers.prepare_workers()
except KeyboardInterrupt as error:
    print(error.exit_status, time.monotonic() - started_s < 15)
"""


def test_workers_start_while_shared_memory_is_full(monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("unable to allocate shared memory(shm): No space left on device (28)")

    monkeypatch.setattr(torch.UntypedStorage, "_share_fd_cpu_", fail)
    monkeypatch.setattr(torch.UntypedStorage, "_share_filename_cpu_", fail)
    maker = QuickMaker(dataset(), PACKAGED_FRAMES, "torch")
    maker.make(task("scene"))  # keeps a sample, whose tensors are given to the workers
    workers = Workers(maker, 1)
    try:
        answer = asyncio.run(workers.run(task("detection2d")))
    finally:
        workers.close()
    assert answer.content == {"by": "detection2d-fast-cpu"}


def test_a_signal_ends_the_wait_for_the_process_that_forks_workers(tmp_path):
    (tmp_path / "slow.py").write_text("import time; time.sleep(20)")
    paths = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    with (tmp_path / "printed").open("w") as printed:  # a pipe would wait for that process, too
        program = [sys.executable, "-c", _WAITING]
        subprocess.run(program, stdout=printed, check=True, env=os.environ | {"PYTHONPATH": paths})
    assert (tmp_path / "printed").read_text() == f"{128 + signal.SIGTERM} True\n"


def test_modules_of_the_current_folder_are_not_imported(tmp_path):
    (tmp_path / "data").mkdir()
    for name in ("http", "queue", "signal", "random"):
        (tmp_path / "data" / f"{name}.py").write_text("open('run', 'w')\nraise SystemExit\n")
    program = tmp_path / "program.py"
    program.write_text(
        "import os\n"
        "from sightline.app.workers import prepare_workers\n"
        "prepare_workers()\n"
        "print(os.environ.get('PYTHONSAFEPATH'))\n"
    )
    done = subprocess.run(
        [sys.executable, program], cwd=tmp_path / "data", check=True, capture_output=True, text=True
    )
    assert done.stdout == "None\n"
    assert not (tmp_path / "data" / "run").exists()


def test_the_end_of_the_process_that_forks_workers_is_told(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "from sightline.app.workers import prepare_workers\n"
        "try:\n"
        "    prepare_workers()\n"
        "except ChildProcessError as error:\n"
        "    print(error)\n"
    )
    modules = tmp_path / "modules"
    modules.mkdir()
    (modules / "sitecustomize.py").write_text(
        "import sys\nif '-c' in sys.orig_argv and 'forkserver' in str(sys.orig_argv): sys.exit(1)\n"
    )
    paths = f"{modules}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    done = subprocess.run(
        [sys.executable, program],
        env=os.environ | {"PYTHONPATH": paths},
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout.startswith("the process that starts workers has ended, perhaps by ")
