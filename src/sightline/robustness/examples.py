"""Example pictures of one frame, clean and under each kind of corruption, with the predictions."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from sightline.corruptions.suites import CLEAN, Case
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import list_files
from sightline.robustness.record import CaseInfo
from sightline.robustness.scoring import BenchPrediction, Scoring

_PICTURES: Final = "pictures"
_WIDTHS_PX: Final = (100, 4000)


class Example(NamedTuple):
    """Picture of a run."""

    caption: str
    path: Path


@dataclass(frozen=True, slots=True)
class ExampleDrawer:
    """Drawer of the predictions for one frame in every case, during a run over all frames."""

    out: Path
    """Folder of the run."""
    frame: str
    scoring: Scoring
    width_px: int
    """Width of each picture."""

    def __post_init__(self) -> None:
        """Check the width."""
        smallest, largest = _WIDTHS_PX
        if not smallest <= self.width_px <= largest:
            raise ValueError(
                f"picture_px must be between {smallest} and {largest}, got {self.width_px}; give "
                "the width of each picture of the page in pixels"
            )

    @property
    def settings(self) -> dict[str, object]:
        """Collect all settings of the pictures, except the predictions, for a run's manifest."""
        return {"shown": self.frame, "picture_px": self.width_px}

    def __call__(self, case: Case, prediction: BenchPrediction) -> None:
        """Draw the prediction, if it is for this frame."""
        if prediction.frame.sample.sample_id != self.frame:
            return
        for number, panel in enumerate(self.scoring.draw(prediction, self.width_px)):
            name = f"{number}_{panel.caption.replace(' ', '_')}.jpg"
            write_rgb(self.out / _PICTURES / case.name / name, panel.picture)


def example_cases(cases: Mapping[str, CaseInfo]) -> tuple[str, ...]:
    """List the clean case and the middle severity of each kind."""
    by_kind: dict[str, list[str]] = {}
    for name, case in cases.items():
        by_kind.setdefault(case.kind, []).append(name)
    middle = {names[len(names) // 2] for names in by_kind.values()}
    return tuple(name for name in cases if name == CLEAN or name in middle)


def list_examples(out: Path, case: str) -> list[Example]:
    """List the pictures of a case, in order; empty if none were drawn."""
    files = list_files(out / _PICTURES / case, (".jpg",))
    return [Example(stem.partition("_")[2].replace("_", " "), path) for stem, path in files.items()]
