"""Demo: the main job from end to end on the embedded frames, for newcomers."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from sightline.data.check import check_tree
from sightline.files.atomic import atomic_write_text
from sightline.inference.demo_page import demo_page, picture_html
from sightline.jobs.output_dirs import acquire_output_dir
from sightline.simulation.packaged import PACKAGED_FRAMES


@dataclass(frozen=True, kw_only=True, slots=True)
class Headline:
    """Headline of the report."""

    text: str
    """Headline text, one sentence."""
    picture: Path
    """Picture that illustrates the headline."""
    caption: str
    """Caption of the picture."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoPart:
    """A task's part of the demo."""

    title: str
    """Short name of the task."""
    result: str
    """Best scores of the task, in one line."""
    files: tuple[tuple[str, Path], ...]
    """Written files or folders, each with a short description."""
    html: str
    """HTML for the report, below the title."""
    headline: Headline | None = None
    """Headline for the report; the first part with one provides it."""


def run_demo(out: Path, parts: Iterable[Callable[[Path, Path], DemoPart | None]]) -> str:
    """Check the embedded frames and run the tasks' demos on them.

    Args:
        out: Folder of all results.
        parts: Functions of the frames' folder and `out`; None: nothing to show.

    Returns:
        Summary of the written files for the user.

    Raises:
        ValueError: `out` cannot be written to, contains links that lead outside or files such as
            a demo's that none wrote, or the embedded frames are damaged.
    """
    acquire_output_dir(out, {"job": "demo"}, results=("*.html", "*.png"))
    problems = list(check_tree(PACKAGED_FRAMES))
    if problems:
        raise ValueError(
            f"the embedded frames are damaged ({problems[0]}); install sightline again"
        )
    made = [each for part in parts if (each := part(PACKAGED_FRAMES, out)) is not None]
    report = out / "report.html"
    atomic_write_text(report, _report(made))
    files = [("frames", PACKAGED_FRAMES), *(file for part in made for file in part.files)]
    lines = [part.result for part in made]
    return "\n".join(lines + [f"{name:<10}{path}" for name, path in [*files, ("report", report)]])


def _report(parts: Sequence[DemoPart]) -> str:
    today = datetime.now(UTC).date()
    headline = next((part.headline for part in parts if part.headline is not None), None)
    return demo_page(
        about=(
            f"sightline demo, version {version('sightline')}, {today:%d %B %Y}, on street frames "
            "that come with it, made by its simulator"
        ),
        headline="Sightline demo" if headline is None else headline.text,
        picture="" if headline is None else picture_html(headline.picture, headline.caption),
        results=[(part.title, part.result) for part in parts],
        sections=[(part.title, part.html) for part in parts],
    )
