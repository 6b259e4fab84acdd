import json
from pathlib import Path

import pytest

from sightline.cli.report import check_writable, deliver


class SmallReport:
    def table(self):
        return "the table"

    def to_json(self):
        return {"score": 1}


class BrokenTable(SmallReport):
    def table(self):
        raise BrokenPipeError


@pytest.mark.parametrize(
    "place", ["/dev/full", "/proc/nothing/report.json", "/dev/null/report.json"]
)
def test_a_place_where_no_file_can_stand_is_refused_before_the_work(place):
    with pytest.raises(ValueError, match=f"{place} cannot be written"):
        check_writable(Path(place))


def test_a_place_in_a_folder_that_is_not_there_yet_is_fine_and_nothing_is_made(tmp_path):
    check_writable(None)
    check_writable(tmp_path / "a" / "b" / "report.json")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_no_place_for_a_report(tmp_path):
    with pytest.raises(ValueError, match="no regular file"):
        check_writable(tmp_path)


def test_the_table_is_printed_before_a_file_that_cannot_be_written_ends_the_command(
    capsys, tmp_path
):
    with pytest.raises(ValueError, match="no regular file"):
        deliver(SmallReport(), tmp_path)
    assert "the table" in capsys.readouterr().out


def test_the_file_is_written_though_the_reader_of_the_table_has_gone(tmp_path):
    with pytest.raises(BrokenPipeError):
        deliver(BrokenTable(), tmp_path / "report.json")
    assert json.loads((tmp_path / "report.json").read_text()) == {"score": 1}
