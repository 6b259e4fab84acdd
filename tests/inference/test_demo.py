from datetime import UTC, datetime
from html.parser import HTMLParser
from importlib.metadata import version
from pathlib import Path

import pytest

from sightline.inference.demo import DemoPart, Headline, run_demo
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.tasks import find_task, task_names


class Page(HTMLParser):
    """Parsed page: its tags in order, and the words in each kind of tag."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.words, self._open = [], {}, []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._open.append(tag)

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data):
        for tag in self._open:
            self.words[tag] = self.words.get(tag, "") + data


def plain(frames, out):
    del frames, out
    return DemoPart(title="First & plain", result="3 < 4", files=(), html="<p>of its own</p>")


def with_headline(frames, out):
    del frames
    headline = Headline(text="It <goes> on", picture=out / "top.png", caption="All & everything")
    return DemoPart(title="Second", result="good", files=(), html="", headline=headline)


def nothing(frames, out):
    del frames, out


def report_of(out, *parts):
    summary = run_demo(out, parts)
    return summary, Page((out / "report.html").read_text())


def test_headline_and_picture_stand_above_all_parts(tmp_path):
    summary, page = report_of(tmp_path, plain, nothing, with_headline)
    assert summary.splitlines()[:2] == ["3 < 4", "good"]
    assert page.words["h1"] == "It <goes> on"
    assert page.words["h2"] == "First & plainSecond"
    names = [tag for tag, _ in page.tags]
    assert names.index("h1") < names.index("img") < names.index("h2")
    (picture,) = [attributes for tag, attributes in page.tags if tag == "img"]
    assert picture == {"src": "top.png", "alt": "All & everything"}
    assert {"a", "table", "pre"} & set(names) == {"a"}
    assert "3 < 4" in page.words["div"]


@pytest.mark.parametrize("name", task_names())
def test_results_of_a_demo_that_are_older_than_their_frames_are_to_be_removed(
    name, tmp_path, monkeypatch
):
    def stop(*_, remedy, **__):
        raise ValueError(remedy)

    monkeypatch.setattr(f"sightline.{name.replace('-', '_')}.demo.predict", stop)
    with pytest.raises(ValueError, match=f"^to make them anew, remove {tmp_path}/[a-z0-9]+$"):
        find_task(name).demo(PACKAGED_FRAMES, tmp_path)


def test_files_that_no_demo_wrote_are_not_replaced_and_its_own_are(tmp_path):
    own, again = tmp_path / "own", tmp_path / "again"
    own.mkdir()
    (own / "report.html").write_text("mine")
    with pytest.raises(ValueError, match="name another"):
        run_demo(own, [plain])
    assert [each.read_text() for each in own.iterdir()] == ["mine"]
    assert run_demo(again, [plain]) == run_demo(again, [plain])


def test_the_report_contains_its_version_and_date_and_fits_phones(tmp_path):
    before = datetime.now(UTC)
    _, page = report_of(tmp_path, plain)
    days = {f"{day:%d %B %Y}" for day in (before, datetime.now(UTC))}
    assert page.words["h1"] == "Sightline demo"
    assert version("sightline") in page.words["p"]
    assert any(day in page.words["p"] for day in days)
    metas = [attributes for tag, attributes in page.tags if tag == "meta"]
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in metas
    assert "img" not in [tag for tag, _ in page.tags]


def test_the_report_fetches_nothing(tmp_path):
    report_of(tmp_path, plain, with_headline)
    text = Path(tmp_path / "report.html").read_text()
    assert "http" not in text
    assert "<script" not in text
