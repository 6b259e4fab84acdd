"""Simulated data sets of small frames of boxes."""

from pathlib import Path

from sightline.jobs.run import JobResult
from sightline.simulation.generate import simulate
from sightline.simulation.settings import SimulationConfig
from tests.simulation.streets import make_tiny_street

TINY = SimulationConfig(seed=3, image_size=(94, 310), focal_px=180.0)
DRIVES = SimulationConfig(seed=3, image_size=(94, 310), focal_px=180.0, sequence_length=3)


def make(out: Path, frames: int, config: SimulationConfig = TINY, **options) -> JobResult:
    return simulate(out, frames=frames, config=config, streets=make_tiny_street, **options)


def content(folder: Path) -> dict[str, bytes]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}
