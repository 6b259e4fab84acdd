"""Memory of a training process."""

import sys
from pathlib import Path

import numpy as np
import pytest
from lightning import LightningModule, Trainer

from sightline.training.callbacks import ReturnFreeMemory

_BLOCKS, _BLOCK_BYTES = 3_200, 65_536  # small enough for the C library's heap


def _resident_bytes() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    line = next(line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) * 1024


@pytest.mark.skipif(sys.platform != "linux", reason="glibc's heap and /proc")
def test_freed_memory_below_a_live_block_is_returned_every_ten_steps() -> None:
    callback = ReturnFreeMemory()
    trainer, module = Trainer(logger=False, enable_checkpointing=False), LightningModule()
    before = _resident_bytes()
    blocks = [np.ones(_BLOCK_BYTES, dtype=np.uint8) for _ in range(_BLOCKS)]
    last = blocks.pop()  # above the others, so that the heap cannot shrink by itself
    blocks.clear()
    kept = _resident_bytes() - before
    callback.on_train_batch_end(trainer, module, None, None, 9)
    assert _resident_bytes() - before == pytest.approx(kept, abs=8e6)
    callback.on_train_batch_end(trainer, module, None, None, 10)
    assert _resident_bytes() - before < kept - 0.7 * _BLOCKS * _BLOCK_BYTES
    assert last.sum() == _BLOCK_BYTES
