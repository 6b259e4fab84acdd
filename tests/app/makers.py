"""Makers of answers without networks, for the tests of processes and of the server."""

import os
import signal
import time
from pathlib import Path

import sightline
from sightline.app.parts import Answer, PartMaker, Task
from sightline.app.server import PageSettings
from sightline.simulation.packaged import PACKAGED_FRAMES


class QuickMaker(PartMaker):
    """Scenes as they are; of the other parts their names. A fault's seed tells what goes wrong."""

    def make(self, task: Task) -> Answer:
        seeds = {fault.seed for fault in task.state.broken.faults}
        if 9 in seeds and task.part != "scene":
            os.kill(os.getpid(), signal.SIGKILL)
        if 6 in seeds and task.part == "detection3d":
            raise TypeError("an index\nis missing")
        if 5 in seeds and task.part == "detection3d":
            os._exit(3)
        if 8 in seeds and task.part == "detection3d":
            raise ValueError("this frame is\ndamaged")
        if 4 in seeds and task.part != "scene":
            time.sleep(3600)
        if 7 in seeds and task.part != "scene":
            time.sleep(0.5)
        if task.part in ("scene", "health"):
            return super().make(task)
        return Answer(content={"by": task.state.weights_for(task.part)}, found=task.part.encode())


def dataset(folder: Path = PACKAGED_FRAMES):
    return sightline.open_dataset(folder, parts=("image", "points", "objects"), needs=())


def settings(folder: Path = PACKAGED_FRAMES, **changes) -> PageSettings:
    changes = {"hosts": ("testserver", "127.0.0.1"), "workers": 1} | changes
    return PageSettings(data=folder, dataset=dataset(folder), title="frames", **changes)
