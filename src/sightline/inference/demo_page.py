"""Report of the demo: one HTML file beside its pictures, for a screen or a phone."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Final

_STYLE: Final = """
:root { color-scheme: light; --ink: #1c2530; --soft: #5b6672; --line: #dfe4ea; --ground: #f6f8fa; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 1280px;
  margin: 0 auto; padding: 1.4em 1.2em 4em; }
h1 { font-size: 1.7em; line-height: 1.25; margin: .1em 0 .3em; }
h2 { font-size: 1.3em; margin: 2.4em 0 .4em; padding-top: .8em; border-top: 1px solid var(--line); }
h3 { font-size: 1.05em; margin: 1.6em 0 .3em; } p { margin: .4em 0; max-width: 46em; }
.soft, figcaption { color: var(--soft); }
code { background: var(--ground); padding: 0 .25em; border-radius: 3px; overflow-wrap: anywhere; }
figure { margin: 1em 0; } figcaption { font-size: .9em; margin-top: .3em; }
img { width: 100%; display: block; border-radius: 6px; background: #111; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(260px, 1fr)); gap: .7em;
  margin: 1.2em 0; }
.tile { background: var(--ground); border-radius: 6px; padding: .7em .9em; }
.tile b { display: block; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: .6em 0; }
th { font-weight: 500; text-align: left; }
tbody th { font-weight: 400; white-space: nowrap; }
th, td { padding: .3em .8em .3em 0; } td, thead th:not(:first-child) { text-align: right; }
td, thead th:not(:first-child) { padding-left: .8em; }
thead th { color: var(--soft); font-size: .9em; } tbody tr { border-top: 1px solid var(--line); }
@media (max-width: 560px) { body { padding: .9em .8em 3em; } h1 { font-size: 1.3em; }
  table { font-size: .9em; } th, td { padding-right: .3em; }
  td, thead th:not(:first-child) { padding-left: .3em; }
  .wide img { width: auto; max-width: none; height: 460px; }
  .wide { overflow-x: auto; } .wide figcaption { position: sticky; left: 0; } }
"""

_PAGE: Final = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Sightline demo</title>
<style>{style}</style>
</head>
<body>
<p class="soft">{about}</p>
<h1>{headline}</h1>
{picture}
<div class="tiles">{tiles}</div>
{sections}
</body>
</html>
"""


def demo_page(
    *,
    about: str,
    headline: str,
    picture: str,
    results: Sequence[tuple[str, str]],
    sections: Sequence[tuple[str, str]],
) -> str:
    """Lay out the whole report.

    Args:
        about: Description with version and date.
        headline: Main result, at the top.
        picture: HTML of the picture below the headline; empty: none.
        results: Titles of the parts with their best scores.
        sections: Titles of the parts with their HTML.
    """
    return _PAGE.format(
        style=_STYLE,
        about=escape(about),
        headline=escape(headline),
        picture=picture,
        tiles="".join(
            f'<div class="tile"><b>{escape(title)}</b>{escape(result)}</div>'
            for title, result in results
        ),
        sections="\n".join(
            f"<section><h2>{escape(title)}</h2>\n{content}</section>" for title, content in sections
        ),
    )


def picture_html(picture: Path, caption: str, *, is_wide: bool = False) -> str:
    """HTML of a picture beside the report, with a link to its full size.

    Args:
        picture: File of the picture.
        caption: Caption below the picture.
        is_wide: Whether a phone scrolls the picture sideways instead of shrinking it.
    """
    name, text = escape(picture.name), escape(caption)
    link = f'<a href="{name}"><img src="{name}" alt="{text}"></a>'
    style = ' class="wide"' if is_wide else ""
    return f"<figure{style}>{link}<figcaption>{text}</figcaption></figure>"
