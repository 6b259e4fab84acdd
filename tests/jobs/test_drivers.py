"""One job by each driver, with workers, programs and machines killed in the middle."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from sightline.jobs.run import JobResult
from tests.inference.trees import write_object_tree
from tests.jobs.scale_jobs import DEADLY, digest, run

ROOT = Path(__file__).parents[2]
NUM_FRAMES = 24


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_object_tree(tmp_path_factory.mktemp("scale") / "data", NUM_FRAMES, num_points=50)


@pytest.fixture(scope="module")
def expected(data):
    """Digest of the results of one undisturbed process."""
    run(data, data.parent / "expected")
    return digest(data.parent / "expected")


def start(*arguments, **settings):
    command = [sys.executable, "-m", "tests.jobs.scale_jobs", *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, **pipes, **settings)


def wait_for_files(job, out, number):
    limit_s = time.monotonic() + 300
    while len(list(out.glob("*.png"))) < number:
        assert job.poll() is None, job.communicate()
        assert time.monotonic() < limit_s, "the job wrote nothing"
        time.sleep(0.02)


def result_of(job):
    """What a job that ends well has printed."""
    result, errors = job.communicate(timeout=300)
    assert job.returncode == 0, errors
    return result


def children(process):
    """Numbers of the processes that a process has started."""
    listed = Path(f"/proc/{process}/task/{process}/children")
    return [int(number) for number in listed.read_text().split()]


def test_workers_that_are_killed_in_the_middle_change_nothing(data, expected, tmp_path):
    out = tmp_path / "out"
    job = start(data, out, "local", 2, 0.1)
    for number in (2, 6, 10):
        wait_for_files(job, out, number)
        os.kill(children(job.pid)[0], signal.SIGKILL)
    assert result_of(job) == f"{NUM_FRAMES} written, 0 there already\n"
    assert digest(out) == expected


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")  # forks with threads around
def test_a_frame_that_ends_three_workers_is_named_and_the_others_are_done(data, tmp_path):
    message = (
        f"1 of {NUM_FRAMES} failed, the others are done: sample {DEADLY}: its worker has ended 3"
    )
    with pytest.raises(ValueError, match=message):
        run(data, tmp_path, workers=2, deadly=True)
    done = {path.stem for path in tmp_path.glob("*.png")}
    assert len(done) == NUM_FRAMES - 1
    assert DEADLY not in done


def test_a_program_that_is_killed_with_its_workers_goes_on_where_it_was(data, expected, tmp_path):
    out = tmp_path / "out"
    job = start(data, out, "local", 2, 0.1)
    wait_for_files(job, out, 5)
    os.killpg(job.pid, signal.SIGKILL)
    job.communicate(timeout=300)
    done = len(list(out.glob("*.png")))
    assert 5 <= done < NUM_FRAMES
    assert run(data, out) == JobResult(written=NUM_FRAMES - done, skipped=done)
    assert digest(out) == expected


def test_three_of_four_array_jobs_and_then_the_fourth_twice(data, expected, tmp_path):
    jobs = [start(data, tmp_path, "local", 1, 0, index, 4) for index in (0, 1, 3)]
    for job in jobs:
        assert result_of(job) == "6 written, 0 there already\n"
    assert run(data, tmp_path, shard_index=2, num_shards=4) == JobResult(written=6, skipped=0)
    assert run(data, tmp_path, shard_index=2, num_shards=4) == JobResult(written=0, skipped=6)
    assert digest(tmp_path) == expected


def test_a_second_job_at_the_same_time_joins_the_first(data, expected, tmp_path):
    jobs = [start(data, tmp_path, "local", 2, 0.05) for _ in range(2)]
    assert all("written" in result_of(job) for job in jobs)
    assert digest(tmp_path) == expected


TWO_NODES = """
    import os, sys, time
    from pathlib import Path
    from threading import Thread

    os.environ["RAY_AUTH_MODE"], os.environ["RAY_USAGE_STATS_ENABLED"] = "disabled", "0"
    from ray.cluster_utils import Cluster

    from tests.jobs.scale_jobs import run

    data, out = Path(sys.argv[1]), Path(sys.argv[2])
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    second = cluster.add_node(num_cpus=1)
    os.environ["RAY_ADDRESS"] = cluster.address

    def kill_second():
        while len(list(out.glob("*.png"))) < 60:
            time.sleep(0.05)
        cluster.remove_node(second, allow_graceful=False)

    killer = Thread(target=kill_second)
    killer.start()
    print(run(data, out, "ray", 2, 0.05))
    killer.join()
    cluster.shutdown()
"""


@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed: pip install '.[ray]'")
def test_one_of_two_nodes_of_ray_is_killed_and_every_frame_is_there_once(tmp_path):
    data = write_object_tree(tmp_path / "data", 240, num_points=50)
    run(data, tmp_path / "expected")
    command = [sys.executable, "-c", textwrap.dedent(TWO_NODES), data, tmp_path / "out"]
    done = subprocess.run(
        command, check=False, cwd=ROOT, capture_output=True, text=True, timeout=1200
    )
    assert done.stdout.strip().splitlines()[-1:] == ["240 written, 0 there already"], done.stderr
    assert digest(tmp_path / "out") == digest(tmp_path / "expected")


@pytest.mark.skipif(find_spec("ray") is not None, reason="Ray is installed")
def test_without_ray_the_driver_names_the_extra_before_any_work(data, tmp_path):
    with pytest.raises(ValueError, match=r"ray is not installed; install it with: .*\[ray\]"):
        run(data, tmp_path / "out", "ray", 2)
    assert not (tmp_path / "out").exists()
