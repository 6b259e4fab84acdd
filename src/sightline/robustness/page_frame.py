"""Frame of a report page: embedded style and script, without any downloads."""

from html import escape
from typing import Final

_STYLE: Final = """
:root { color-scheme: light; --ink: #1c2530; --soft: #5b6672; --line: #dfe4ea; --ours: #1f5fbf;
  --other: #b4552d; --third: #2f7d4f; --fourth: #8a4fa3; --alone: #6b7480; --ground: #f6f8fa; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); max-width: 1180px; margin: 0 auto;
  padding: 1.2em 1em 4em; }
h1 { font-size: 1.55em; margin: .2em 0; } h2 { font-size: 1.2em; margin: 2em 0 .5em; }
p { margin: .4em 0; } .reading { margin-top: 1.6em; }
.soft, figcaption, .scale { color: var(--soft); }
code { background: var(--ground); padding: 0 .25em; border-radius: 3px; }
.pick { margin: 1.2em 0 0; } select { font: inherit; max-width: 100%; padding: .25em; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: .6em;
  margin: 1em 0; }
.tile { background: var(--ground); border-radius: 6px; padding: .55em .8em; }
.tile b { display: block; font-size: 1.35em; font-variant-numeric: tabular-nums; }
.tile small { color: var(--soft); overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th { font-weight: 500; text-align: left; }
tbody th { position: sticky; left: 0; background: #fff; }
thead th { color: var(--soft); font-size: .87em; }
th, td { padding: .28em .6em; } td { text-align: right; white-space: nowrap; }
thead th:not(:first-child) { text-align: right; }
.heat th[scope=row] { white-space: nowrap; } .heat td.cell { min-width: 4.2em; }
.heat td.cell { border: 2px solid #fff; border-radius: 4px; } .heat td.sum { color: var(--soft); }
.plain tbody tr { border-top: 1px solid var(--line); }
.plain td { white-space: normal; } .plain tbody th { font-weight: 400; white-space: nowrap; }
.scale { font-size: .87em; } .scale span { display: inline-block; white-space: nowrap; }
.scale i { display: inline-block; font-style: normal; min-width: 2.5em; text-align: center; }
.charts { display: grid; gap: .8em;
  grid-template-columns: repeat(auto-fill, minmax(min(235px, 45%), 1fr)); }
figure { margin: 0; } figcaption { font-size: .9em; }
svg { width: 100%; height: auto; display: block; } svg text { font: 9px system-ui, sans-serif;
  fill: #5b6672; } .grid { stroke: #dfe4ea; fill: none; }
path.ours, path.other, path.third, path.fourth, path.alone { fill: none; stroke-width: 2; }
path.ours { stroke: var(--ours); } path.other { stroke: var(--other); stroke-dasharray: 5 3; }
path.third { stroke: var(--third); stroke-dasharray: 9 3; }
path.fourth { stroke: var(--fourth); stroke-dasharray: 2 2; }
path.alone { stroke: var(--alone); stroke-dasharray: 1 3; }
circle.ours { fill: var(--ours); } circle.other { fill: var(--other); }
circle.third { fill: var(--third); } circle.fourth { fill: var(--fourth); }
.key { display: flex; flex-wrap: wrap; gap: .3em 1.4em; margin: .5em 0; }
.key i { display: inline-block; width: 1.9em; margin-right: .45em; vertical-align: middle;
  border-top: 3px solid; } .key i.ours { color: var(--ours); }
.key i.other { color: var(--other); border-top-style: dashed; }
.key i.third { color: var(--third); border-top-style: dashed; }
.key i.fourth { color: var(--fourth); border-top-style: dotted; }
.key i.alone { color: var(--alone); border-top-style: dotted; }
.bars { margin-top: 1.2em; display: grid; grid-template-columns: max-content 1fr; gap: .35em .8em;
  max-width: 760px; align-items: center; }
.track { display: grid; grid-template-columns: 1fr max-content; gap: 2px .5em;
  align-items: center; } .bar { height: 13px; border-radius: 2px; min-width: 1px; }
.bar.ours { background: var(--ours); } .bar.other { background: var(--other); }
.bar.third { background: var(--third); } .bar.fourth { background: var(--fourth); }
.track span { font-variant-numeric: tabular-nums; font-size: .9em; min-width: 3.4em;
  text-align: right; }
.example { margin: 1em 0; } .pictures { display: grid; gap: .5em;
  grid-template-columns: repeat(auto-fit, minmax(260px, 1fr)); align-items: start; }
.pictures figure { cursor: zoom-in; }
.pictures .large { grid-column: 1 / -1; cursor: zoom-out; }
.pictures img { width: 100%; border-radius: 4px; display: block; background: #111; }
@media (max-width: 560px) { body { padding: .8em .7em 3em; } h1 { font-size: 1.3em; }
  th, td { padding: .25em .4em; font-size: .88em; } .heat td.cell { min-width: 3.1em; }
  .plain tbody th { white-space: normal; min-width: 10em; }
  .bars { grid-template-columns: 1fr; gap: .1em; }
  .label { margin-top: .5em; } }
"""

_SCRIPT: Final = """
const pick = document.getElementById("metric");
const show = () => document.querySelectorAll("[data-metric]").forEach(
  part => { part.hidden = part.dataset.metric !== pick.value; });
pick.addEventListener("change", show); show();
document.querySelectorAll(".pictures figure").forEach(
  each => each.addEventListener("click", () => each.classList.toggle("large")));
"""

_PAGE: Final = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<h1>{title}</h1>
{body}
<script>{script}</script>
</body>
</html>
"""


def whole_page(title: str, body: str) -> str:
    """Make a page in one file; its body has a `metric_picker`."""
    return _PAGE.format(title=escape(title), style=_STYLE, body=body, script=_SCRIPT)


def metric_picker(titles: dict[str, str]) -> str:
    """Make a selection of the metric; elements with another data-metric are hidden.

    Args:
        titles: Titles of the metrics, by name.
    """
    options = "".join(
        f'<option value="{escape(name)}">{escape(title)}</option>' for name, title in titles.items()
    )
    return f'<p class="pick"><label>Metric: <select id="metric">{options}</select></label></p>'


def metric_section(name: str, content: str) -> str:
    """Wrap content that is shown only for the selected metric."""
    return f'<section data-metric="{escape(name)}">{content}</section>'
