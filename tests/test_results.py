"""The pages of results say what their records say, and records can be traced."""

import hashlib
import json
import re
import subprocess
from pathlib import Path

import pytest

from benchmarks import tables

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
PAGES = {page.name: page.read_text() for page in tables.pages()}
LOG = (ROOT / "docs" / "log.md").read_text()
PROSE = {**PAGES, **{name: (ROOT / "docs" / name).read_text() for name in ("log.md", "models.md")}}
MAX_LOG_LINES = 5
BLOCK = re.compile(r"<!-- table: ([\w-]+) -->\n.*?<!-- end -->", re.DOTALL)

if not RESULTS.is_dir():
    pytest.skip("an archive of the source holds no records of results", allow_module_level=True)

RECORDS = [
    (path.stem, record)
    for path in sorted(RESULTS.glob("*.json"))
    if path.stem != "quoted"
    for record in tables.load(path.stem)
]


def git(*words):
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else None


def is_kept(commit):
    """Whether HEAD's history holds a commit; an object outside of it does not count."""
    done = subprocess.run(
        ["git", "merge-base", "--is-ancestor", commit, "HEAD"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    return done.returncode == 0


@pytest.fixture(scope="module")
def history():
    """The whole history; a shallow clone or an archive cannot tell which commits exist."""
    if git("rev-parse", "--is-shallow-repository") != "false":
        pytest.skip("a shallow clone, or none: its history cannot be asked for commits")


@pytest.mark.parametrize("name", PAGES)
def test_each_generated_table_of_a_page_is_what_its_records_give(name):
    assert tables.rendered(PAGES[name]) == PAGES[name], "run `make results`"


def test_each_table_stands_on_one_page():
    named = [name for text in PAGES.values() for name in BLOCK.findall(text)]
    assert sorted(named) == sorted(tables.TABLES)


def test_a_page_whose_figure_differs_from_its_record_is_noticed():
    block = BLOCK.search(PAGES["depth.md"]).group()
    figure = re.search(r"\| (\d{4}) / ", block)
    changed = block[: figure.start(1)] + "1111" + block[figure.end(1) :]
    assert tables.rendered(changed) == tables.rendered(block) != changed


def test_check_fails_and_names_the_page_that_differs(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(PAGES["simulation.md"].replace("| 0.51 [", "| 0.99 ["))
    monkeypatch.setattr(tables, "ROOT", tmp_path)
    monkeypatch.setattr(tables, "pages", lambda: [page])
    with pytest.raises(SystemExit, match=r"page.md differ from benchmarks/results; run `make"):
        tables.main(check=True)
    assert "0.99 [" in page.read_text()
    tables.main()
    assert page.read_text() == PAGES["simulation.md"]
    tables.main(check=True)


def test_a_table_that_there_is_not_is_refused_by_name():
    with pytest.raises(ValueError, match="there is no table speeds; name one of scoreboard"):
        tables.rendered("<!-- table: speeds -->\n\n<!-- end -->")


@pytest.mark.parametrize(("name", "record"), RECORDS, ids=[name for name, _ in RECORDS])
def test_a_record_says_where_it_comes_from(name, record):
    command = record["command"]
    assert "/" not in command
    if script := re.fullmatch(r"python -m benchmarks\.(\w+)( .*)?", command):
        assert (ROOT / "benchmarks" / f"{script[1]}.py").is_file()
    else:
        assert command.startswith("sightline reproduce ")
    assert re.fullmatch(r"[0-9a-f]{7}", record["commit"])
    assert isinstance(record["dirty"], bool)
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", record["date"])
    assert record["seed"] is None or record["seed"] >= 0
    assert {"processor", "cores", "system", "python"} <= record["machine"].keys()
    assert all(re.fullmatch(r"[0-9a-f]{64}", digest) for digest in record["weights"].values())
    assert name in {each for table in tables.TABLES.values() for each in table.records}


@pytest.mark.usefixtures("history")
@pytest.mark.parametrize("record", [each for _, each in RECORDS], ids=[name for name, _ in RECORDS])
def test_the_commit_of_a_record_is_in_the_history_unless_it_says_not(record):
    assert is_kept(record["commit"]) == record.get("commit_kept", True)


@pytest.mark.usefixtures("history")
def test_each_commit_that_a_page_names_is_in_the_history():
    named = {
        (page, commit)
        for page, text in PROSE.items()
        for commit in re.findall(r"\b(?=[0-9a-f]*[a-f])(?=[0-9a-f]*\d)[0-9a-f]{7}\b", text)
    }
    assert len(named) > 40
    assert {each for each in named if not is_kept(each[1])} == set()


@pytest.mark.usefixtures("history")
def test_a_commit_that_is_not_in_the_history_is_noticed():
    assert not is_kept("254b15e")
    assert is_kept(git("rev-parse", "--short=7", "HEAD"))


@pytest.mark.parametrize(("name", "record"), RECORDS, ids=[name for name, _ in RECORDS])
def test_a_table_tells_which_weights_ship_and_which_are_earlier_ones(name, record):
    digests = {
        path.stem: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in tables.WEIGHTS.glob("*.safetensors")
    }
    expected = {
        each: "weights that do not ship"
        if each not in digests
        else "weights as shipped"
        if digests[each] == digest
        else "**earlier weights**"
        for each, digest in record["weights"].items()
    }
    said = {
        each: state
        for state, names in re.findall(r"(\**[a-z ]+\**): ([^;]+)", tables.origin(name, record))
        for each in names.split(", ")
        if "weights" in state
    }
    assert {each: state.strip() for each, state in said.items()} == expected


def test_what_is_quoted_has_its_source():
    quoted = json.loads((RESULTS / "quoted.json").read_text())
    figures = {name: each for name, each in quoted.items() if name != "about"}
    assert len(figures) > 5
    assert all(each["source"] for each in figures.values())


def test_entries_of_the_log_are_short_and_begin_with_their_finding():
    entries = re.findall(r"^\* .*\n(?:  .*\n)*", LOG, re.MULTILINE)
    assert len(entries) > 100
    assert [each for each in entries if each.count("\n") > MAX_LOG_LINES] == []
    assert [each for each in entries if not re.match(r"\* (\*\*|No)", each)] == []


TABLE = re.compile(r"^\| method \| 64 beams \|.*\n(?:\|.*\n)+", re.MULTILINE)
FIGURES = 48
"""RMSE, MAE and median in four blocks for four numbers of beams."""


def table_of_depth_networks(text):
    return TABLE.search(text.partition("\n## Shift-Convolution networks\n")[2]).group()


def figures(table, method):
    """All figures of a method, row by row."""
    rows = re.findall(rf"^\| \**{method}\** \|(.*)\|$", table, re.MULTILINE)
    return [int(figure) for row in rows for figure in re.findall(r"\d+", row)]


def worse_figures(table):
    """Those of depth-best that are larger than the adaptive completion's."""
    best, adaptive = (figures(table, method) for method in ("depth-best", "adaptive"))
    assert len(best) == len(adaptive) == FIGURES
    return [ours for ours, theirs in zip(best, adaptive, strict=True) if ours > theirs]


def test_depth_best_is_no_worse_than_the_adaptive_completion_where_the_archive_says_so():
    page = PAGES["archive_depth.md"]
    assert f"in RMSE, MAE and median, in all {FIGURES} figures" in page
    assert worse_figures(table_of_depth_networks(page)) == []


def test_a_figure_of_depth_best_that_gets_worse_is_noticed():
    table = table_of_depth_networks(PAGES["archive_depth.md"])
    places = [
        place.span()
        for row in re.finditer(r"^\| \*\*depth-best\*\* \|.*$", table, re.MULTILINE)
        for place in re.compile(r"\d+").finditer(table, *row.span())
    ]
    assert len(places) == FIGURES
    for theirs, (start, end) in zip(figures(table, "adaptive"), places, strict=True):
        assert worse_figures(f"{table[:start]}{theirs + 1}{table[end:]}") == [theirs + 1]
