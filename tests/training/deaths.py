"""Callback of a training by torchrun whose ranks and agents die in its second epoch."""

import os
import signal
from pathlib import Path

from lightning.pytorch.callbacks import Callback

ROLE = "SIGHTLINE_TEST_ROLE"
"""Environment variable of an agent: rank-dies, agent-dies or empty."""
SECOND_EPOCH = 1


class Deaths(Callback):
    """Kills the rank itself once; in the training after that, another agent and its rank."""

    def __init__(self, folder: str) -> None:
        self.rank_died, self.agent_died = Path(folder, "rank-died"), Path(folder, "agent-died")
        role = os.environ.get(ROLE)
        self.kills_rank = role == "rank-dies" and not self.rank_died.exists()
        self.kills_agent = role == "agent-dies" and self.rank_died.exists()

    def on_train_batch_start(self, trainer, *arguments):
        if trainer.current_epoch != SECOND_EPOCH or arguments[-1] != 1:
            return
        if self.kills_rank:
            self.rank_died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if self.kills_agent:
            self.agent_died.touch()
            os.kill(os.getppid(), signal.SIGKILL)
            os.kill(os.getpid(), signal.SIGKILL)
