"""What docs/results.md says of its own tables holds."""

import re
from pathlib import Path

RESULTS = (Path(__file__).parents[1] / "docs" / "results.md").read_text()
TABLE = re.compile(r"^\| method \| 64 beams \|.*\n(?:\|.*\n)+", re.MULTILINE)
FIGURES = 48
"""RMSE, MAE and median in four blocks for four numbers of beams."""


def table_of_depth_networks(text):
    section = text.partition("\n## Depth completion by Shift-Convolution networks\n")[2]
    return TABLE.search(section).group()


def figures(table, method):
    """All figures of a method, row by row."""
    rows = re.findall(rf"^\| \**{method}\** \|(.*)\|$", table, re.MULTILINE)
    return [int(figure) for row in rows for figure in re.findall(r"\d+", row)]


def worse_figures(table):
    """Those of depth-best that are larger than the adaptive completion's."""
    best, adaptive = (figures(table, method) for method in ("depth-best", "adaptive"))
    assert len(best) == len(adaptive) == FIGURES
    return [ours for ours, theirs in zip(best, adaptive, strict=True) if ours > theirs]


def test_depth_best_is_no_worse_than_the_adaptive_completion_where_the_results_say_so():
    assert "**No worse than the adaptive completion** is depth-best in RMSE, MAE" in RESULTS
    assert f"in all {FIGURES} figures" in RESULTS
    assert worse_figures(table_of_depth_networks(RESULTS)) == []


def test_a_figure_of_depth_best_that_gets_worse_is_noticed():
    table = table_of_depth_networks(RESULTS)
    places = [
        place.span()
        for row in re.finditer(r"^\| \*\*depth-best\*\* \|.*$", table, re.MULTILINE)
        for place in re.compile(r"\d+").finditer(table, *row.span())
    ]
    assert len(places) == FIGURES
    for theirs, (start, end) in zip(figures(table, "adaptive"), places, strict=True):
        assert worse_figures(f"{table[:start]}{theirs + 1}{table[end:]}") == [theirs + 1]
