"""Time and cost of a network: operations, memory, parameters."""

import re
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import FlopCounterMode

_MIB = 2**20
_OWN_STATUS = Path("/proc/self/status")
_OWN_RESET = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # see `man 5 proc_pid_clear_refs`


@dataclass(frozen=True, kw_only=True, slots=True)
class Latency:
    """Wall-clock time of one call, over many."""

    median_ms: float
    percentile_95_ms: float
    repeats: int
    """Number of timed calls, without the warm-up."""
    peak_memory_mib: float | None
    """Peak memory during the calls, including the warm-up, minus the memory in use before: GPU
    memory allocated by PyTorch, or memory of the process, which keeps memory of earlier calls.
    None if the system does not report it."""

    def to_json(self) -> dict[str, object]:
        """Convert to the content of a report file."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class Cost:
    """Cost of one call of a network on any machine."""

    parameters: int
    gflop: float
    """Thousand million floating-point operations; a multiplication and an addition are two."""
    traffic_mib: float
    """Bytes that all operators read and write unmerged: an upper bound of the memory traffic."""

    def to_json(self) -> dict[str, object]:
        """Convert to the content of a report file."""
        return asdict(self)


def measure_latency(
    run: Callable[[], object],
    *,
    device: torch.device | str = "cpu",
    warm_up: int = 10,
    repeats: int = 50,
) -> Latency:
    """Time calls one after the other, each from an idle device to its finished result.

    On a GPU the time is taken by the GPU's own events around each call, waits for the CPU
    included; on the CPU by the clock.

    Args:
        run: Function to time.
        device: Device of the network.
        warm_up: Number of calls that are not timed, at first.
        repeats: Number of timed calls.

    Raises:
        ValueError: There is no call to measure.
    """
    if repeats < 1 or warm_up < 0:
        raise ValueError(
            f"repeats must be at least 1 and warm_up at least 0, got {repeats} and {warm_up}"
        )
    device = torch.device(device)
    # Before the first call: libraries keep its memory, so later calls seem to need none.
    before_mib = _start_watching_memory(device)
    for _ in range(warm_up):
        run()
    time_call = _time_on_gpu if device.type == "cuda" else _time_on_cpu
    times_ms = [time_call(run, device) for _ in range(repeats)]
    peak_mib = _peak_memory_mib(device)
    return Latency(
        median_ms=statistics.median(times_ms),
        percentile_95_ms=float(np.percentile(times_ms, 95)),
        repeats=repeats,
        peak_memory_mib=(
            None if before_mib is None or peak_mib is None else max(0.0, peak_mib - before_mib)
        ),
    )


def count_cost(module: nn.Module, inputs: Mapping[str, Tensor]) -> Cost:
    """Count the cost of a module's call by running it once.

    Operations are those of convolutions, matrix products and attention, as
    `torch.utils.flop_counter` counts them; the few of activations and sums are left out.

    Args:
        module: In eval mode, not compiled.
        inputs: By parameter of `forward`.
    """
    traffic = _TrafficCounter()
    with torch.no_grad(), FlopCounterMode(display=False) as flops, traffic:
        module(**inputs)
    return Cost(
        parameters=sum(parameter.numel() for parameter in module.parameters()),
        gflop=flops.get_total_flops() / 1e9,
        traffic_mib=traffic.num_bytes / _MIB,
    )


class _TrafficCounter(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Sum of the bytes of tensors that operators read and write; views count nothing."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.num_bytes = 0

    def __torch_dispatch__(
        self,
        func: Any,  # noqa: ANN401 - as the base class has it
        types: Iterable[type],
        args: tuple[object, ...] = (),
        kwargs: dict[str, object] | None = None,
    ) -> object:
        del types
        kwargs = kwargs or {}
        result = func(*args, **kwargs)
        if not func.is_view:
            leaves = tree_leaves((args, kwargs, result))
            self.num_bytes += sum(leaf.nbytes for leaf in leaves if isinstance(leaf, Tensor))
        return result


def _time_on_cpu(run: Callable[[], object], device: torch.device) -> float:
    """Milliseconds."""
    del device
    start = time.perf_counter()
    run()
    return (time.perf_counter() - start) * 1e3


def _time_on_gpu(run: Callable[[], object], device: torch.device) -> float:
    """Milliseconds."""
    start, end = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
    with torch.cuda.device(device):
        torch.cuda.synchronize()
        start.record()
        run()
        end.record()
        torch.cuda.synchronize()
    elapsed_ms: float = start.elapsed_time(end)
    return elapsed_ms


def _start_watching_memory(device: torch.device) -> float | None:
    """Reset the peak, and return the memory in use now [MiB]."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
        torch.cuda.reset_peak_memory_stats(device)
        return torch.cuda.memory_allocated(device) / _MIB
    try:
        _OWN_RESET.write_text(_RESET_PEAK)
    except OSError:
        return None
    return _own_memory_mib("VmRSS")


def _peak_memory_mib(device: torch.device) -> float | None:
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device) / _MIB
    return _own_memory_mib("VmHWM")


def _own_memory_mib(entry: str) -> float | None:
    """Read an entry of the system's status of this process; None if there is none."""
    if not _OWN_STATUS.is_file():
        return None
    found = re.search(rf"^{entry}:\s+(\d+) kB$", _OWN_STATUS.read_text(), re.MULTILINE)
    return None if found is None else int(found[1]) / 1024
