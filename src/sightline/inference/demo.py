"""The main job from end to end on the embedded frames: what a newcomer runs first."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from sightline.data.atomic import atomic_write_text
from sightline.data.check import check_tree
from sightline.data.output_links import check_links
from sightline.inference.demo_page import demo_page, picture_html
from sightline.simulation.packaged import PACKAGED_FRAMES


@dataclass(frozen=True, kw_only=True, slots=True)
class Headline:
    """What stands on top of the report."""

    text: str
    """In one sentence."""
    picture: Path
    """That shows it."""
    caption: str
    """What the picture is."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoPart:
    """What a task shows of itself."""

    title: str
    """What it does, in a word or two."""
    result: str
    """Its best figures, in one line."""
    files: tuple[tuple[str, Path], ...]
    """What it wrote, each file or folder with a word for what it is."""
    html: str
    """Its part of the report, below its title."""
    headline: Headline | None = None
    """For the report's top; the first part's that has one stands there."""


def run_demo(out: Path, parts: Iterable[Callable[[Path, Path], DemoPart | None]]) -> str:
    """Checks the embedded frames and lets tasks show what they make of them.

    Args:
        out: Folder for all of it.
        parts: Each takes the frames' folder and `out`; one that has nothing to show gives None.

    Returns:
        What was written, for a person.

    Raises:
        ValueError: `out` cannot be written to or holds links that lead out of it, or the embedded
            frames are damaged.
    """
    check_links(out)
    problems = list(check_tree(PACKAGED_FRAMES))
    if problems:
        raise ValueError(
            f"the embedded frames are damaged ({problems[0]}); install sightline again"
        )
    shown = [made for part in parts if (made := part(PACKAGED_FRAMES, out)) is not None]
    report = out / "report.html"
    atomic_write_text(report, _report(shown))
    files = [("frames", PACKAGED_FRAMES), *(file for part in shown for file in part.files)]
    lines = [part.result for part in shown]
    return "\n".join(lines + [f"{what:<10}{path}" for what, path in [*files, ("report", report)]])


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
