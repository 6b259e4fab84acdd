"""The main job from end to end on the embedded frames: what a newcomer runs first."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from sightline.data.atomic import atomic_write_text
from sightline.data.check import check_tree
from sightline.simulation.packaged import PACKAGED_FRAMES

_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>Sightline demo</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 1400px; margin: 2em auto; padding: 0 1em;
  color: #1c2530; }}
img {{ width: 100%; border-radius: 6px; margin: .5em 0 2em; }}
pre {{ background: #f2f4f7; padding: 1em; border-radius: 6px; overflow-x: auto; }}
</style>
<h1>Sightline demo</h1>
<p>On street frames that come with Sightline and were made by its simulator (<code>sightline
simulate</code> makes more).</p>
{parts}
</html>
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class DemoPart:
    """What a task shows of itself."""

    result: str
    """Its best figures, in one line."""
    files: tuple[tuple[str, Path], ...]
    """What it wrote, each file or folder with a word for what it is."""
    html: str
    """Its part of the report."""


def run_demo(out: Path, parts: Iterable[Callable[[Path, Path], DemoPart | None]]) -> str:
    """Checks the embedded frames and lets tasks show what they make of them.

    Args:
        out: Folder for all of it.
        parts: Each takes the frames' folder and `out`; one that has nothing to show gives None.

    Returns:
        What was written, for a person.

    Raises:
        ValueError: `out` cannot be written to.
    """
    frames = PACKAGED_FRAMES
    problems = list(check_tree(frames))
    if problems:
        raise ValueError(f"the embedded frames are damaged: {problems[0]}")
    shown = [made for part in parts if (made := part(frames, out)) is not None]
    report = out / "report.html"
    atomic_write_text(report, _PAGE.format(parts="\n".join(part.html for part in shown)))
    files = [("frames", frames), *(file for part in shown for file in part.files)]
    lines = [part.result for part in shown]
    return "\n".join(lines + [f"{what:<10}{path}" for what, path in [*files, ("report", report)]])
