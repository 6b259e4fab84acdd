import subprocess
import sys
import time

import pytest
import torch
from torch import nn

from benchmarks import latency
from benchmarks.latency import count_cost, measure_latency


def test_the_median_and_the_percentile_are_those_of_the_calls_after_the_warm_up(monkeypatch):
    durations = iter([100.0, 50.0, *range(1, 22)])  # seconds; two to warm up
    clock = 0.0

    def run():
        nonlocal clock
        clock += next(durations)

    monkeypatch.setattr(latency.time, "perf_counter", lambda: clock)
    measured = measure_latency(run, warm_up=2, repeats=21)
    assert measured.median_ms == pytest.approx(11e3)
    assert measured.percentile_95_ms == pytest.approx(20e3)
    assert measured.repeats == 21


def test_peak_memory_holds_what_a_call_takes_and_gives_back():
    program = """if True:
        from benchmarks.latency import measure_latency
        run = lambda: bytearray(64 * 2**20).count(0)
        print(measure_latency(run, warm_up=1, repeats=2).peak_memory_mib)
    """
    # in a process of its own: memory that other tests left may be given back meanwhile
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    if done.stdout.strip() == b"None":
        pytest.skip("the system does not tell the peak of a process")
    assert 50 < float(done.stdout) < 150


def test_where_the_system_does_not_tell_memory_there_is_no_figure(monkeypatch, tmp_path):
    monkeypatch.setattr(latency, "_OWN_RESET", tmp_path / "absent" / "file")
    measured = measure_latency(time.perf_counter, warm_up=0, repeats=1)
    assert measured.peak_memory_mib is None
    assert measured.to_json()["peak_memory_mib"] is None


@pytest.mark.parametrize(("warm_up", "repeats"), [(0, 0), (-1, 1)])
def test_no_calls_are_refused(warm_up, repeats):
    with pytest.raises(ValueError, match=f"got {repeats} and {warm_up}"):
        measure_latency(time.perf_counter, warm_up=warm_up, repeats=repeats)


def test_operations_and_parameters_are_those_of_the_formula():
    cost = count_cost(nn.Conv2d(3, 8, 3, padding=1), {"input": torch.rand(1, 3, 10, 20)})
    assert cost.parameters == 8 * 3 * 9 + 8
    assert cost.gflop == pytest.approx(2 * 8 * 3 * 9 * 10 * 20 / 1e9)


def test_traffic_is_what_operators_read_and_write_and_views_are_free():
    class Views(nn.Module):
        def forward(self, values):
            return values.reshape(4, 256)[:, :128].T.relu()

    cost = count_cost(Views(), {"values": torch.rand(1024)})
    assert cost.traffic_mib == pytest.approx(2 * 512 * 4 / 2**20)
    assert cost.to_json() == {"parameters": 0, "gflop": 0.0, "traffic_mib": cost.traffic_mib}


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_a_gpu_is_waited_for():
    left = torch.rand(4096, 4096, device="cuda")
    measured = measure_latency(lambda: left @ left, device="cuda", warm_up=3, repeats=5)
    assert measured.median_ms > 0.05  # the launch alone takes less than the product
    assert measured.peak_memory_mib == pytest.approx(64, abs=1)
