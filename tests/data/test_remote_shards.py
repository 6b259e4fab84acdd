"""Shards on a web server of this machine, and in other file systems of fsspec."""

import socket
import threading
from functools import partial
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import fsspec
import pytest
import torch

from sightline.cli.main import main
from sightline.data.check import check_tree
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.evaluation.kitti_object import frame_names
from sightline.files import byte_source
from sightline.files.byte_source import read_range, url_of
from sightline.files.shard_path import data_path
from tests.data.trees import write_object_tree


class RangeHandler(SimpleHTTPRequestHandler):
    """Serves whole files and ranges of them, as object stores do."""

    sent = 0  # bytes of contents

    def log_message(self, *_):
        pass

    def do_GET(self):
        try:
            content = Path(self.translate_path(self.path)).read_bytes()
        except OSError:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        given = self.headers.get("Range")
        total = len(content)
        if given:
            first, last = given.removeprefix("bytes=").split("-")
            content = content[int(first) : int(last) + 1]
            self.send_response(HTTPStatus.PARTIAL_CONTENT)
            self.send_header("Content-Range", f"bytes {first}-{last}/{total}")
        else:
            self.send_response(HTTPStatus.OK)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)
        RangeHandler.sent += len(content)


class PlainHandler(SimpleHTTPRequestHandler):
    """Serves whole files alone, as `python -m http.server` does."""

    def log_message(self, *_):
        pass


@pytest.fixture
def folder(tmp_path):
    tree = write_object_tree(tmp_path / "tree", "000000", "000001", "000002")
    (tree / "ImageSets").mkdir(exist_ok=True)
    (tree / "ImageSets" / "last.txt").write_text("000002\n")
    write_shards(tree, tmp_path / "shards", frames_per_shard=2, compress=True)
    return tmp_path


@pytest.fixture
def address(folder):
    yield from serve(folder, RangeHandler)


@pytest.fixture
def address_without_ranges(folder):
    yield from serve(folder, PlainHandler)


def serve(folder, kind):
    handler = partial(kind, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_shards_on_a_server_give_the_samples_of_the_tree(folder, address):
    one, other = open_dataset(folder / "tree"), open_dataset(f"{address}/shards")
    assert one.sample_ids == other.sample_ids
    assert torch.equal(one[2].image, other[2].image)
    assert torch.equal(one[2].points, other[2].points)
    sample_ids = open_dataset(f"{address}/shards/000001.tar").sample_ids
    assert sample_ids == ("000002",)


def test_check_finds_damage_of_the_files_of_no_frame_on_a_server(folder, address):
    (folder / "tree" / "ImageSets" / "val.txt").write_text("000001\n")
    write_shards(folder / "tree", folder / "other", frames_per_shard=2)
    before = list(check_tree(f"{address}/other"))
    (folder / "other" / "shared.tar").unlink()
    problem, *others = check_tree(f"{address}/other")
    assert others == before
    assert str(problem).startswith(f"{address}/other/shared.tar: is absent; copy it to the server")


def test_a_remote_file_that_ends_before_a_range_is_told_as_it_is():
    place = "memory://end/000000.tar"
    with fsspec.open(place, "wb") as file:
        file.write(bytes(100))
    for start, end in ((90, "at byte 100"), (200, "before byte 201")):
        with pytest.raises(ValueError, match=f"ends {end}, expected 30 bytes from {start}"):
            read_range(Path(place), start, 30)


def test_a_frame_is_read_without_its_shard(folder, address):
    dataset = open_dataset(f"{address}/shards")
    RangeHandler.sent = 0
    dataset[0]
    assert 0 < RangeHandler.sent < (folder / "shards" / "000000.tar").stat().st_size / 2


def test_commands_give_the_bytes_of_the_tree_by_several_workers(folder, address, capfd):
    for data, name in ((folder / "tree", "one"), (f"{address}/shards", "two")):
        arguments = ["predict", "depth-completion", data, folder / name, "--method", "nearest"]
        assert main([*map(str, arguments), "--workers", "2"]) == 0
        assert main(["check", str(data)]) in (0, 1)
    printed = capfd.readouterr().out.replace(str(folder / "tree"), "DATA")
    _, second = printed.split("two: depth of frames:")
    assert "3 written" in second
    files = sorted(path.name for path in (folder / "one").iterdir())
    assert files == ["000000.png", "000001.png", "000002.png", "sightline.json"]
    for name in files:
        assert (folder / "one" / name).read_bytes() == (folder / "two" / name).read_bytes()


def test_a_server_that_ignores_ranges_is_named(address_without_ranges):
    shards = f"{address_without_ranges}/shards"
    problem = rf"^{shards}/000000\.tar comes whole .* its server ignores ranges; take a web server"
    with pytest.raises(ValueError, match=problem):
        open_dataset(shards)


def test_any_file_system_of_fsspec_is_read(folder):
    memory = fsspec.filesystem("memory")
    for path in (folder / "shards").iterdir():
        memory.pipe_file(f"/bucket/{path.name}", path.read_bytes())
    dataset = open_dataset("memory://bucket")
    assert dataset.sample_ids == ("000000", "000001", "000002")
    assert dataset[0].image is not None
    memory.rm("/bucket", recursive=True)


def test_what_cannot_be_reached_is_named(address):
    with pytest.raises(ValueError, match="/nothing: holds no shards, or cannot be reached; give"):
        open_dataset(f"{address}/nothing")
    with pytest.raises(
        ValueError,
        match=r"^http://127\.0\.0\.1:9/shards/shards\.json: cannot be read: Connect call failed",
    ):
        open_dataset("http://127.0.0.1:9/shards")
    with pytest.raises(
        ValueError, match=r"sig=x: has a query, which is of one file, and shards are"
    ):
        open_dataset(f"{address}/shards/000001.tar?sig=x")
    with pytest.raises(
        ValueError, match=r"steam://x/shards\.json cannot be read: steam is no known"
    ):
        open_dataset("steam://x")


class RefusingHandler(RangeHandler):
    """Serves shards, and answers 403 for all that is not there, as stores without listing do."""

    def send_error(self, *_):
        self.send_response(HTTPStatus.FORBIDDEN)
        self.end_headers()


def test_a_refusal_by_the_server_is_named_and_hides_no_shards(folder):
    for address in serve(folder, RefusingHandler):
        assert len(open_dataset(f"{address}/shards/training")) == 3
        secret = address.replace("//", "//bob:hunter2@")
        with pytest.raises(ValueError, match="cannot be read: its server answers 403; ") as raised:
            open_dataset(f"{secret}/nothing")
        assert str(raised.value).startswith(f"{address}/nothing/shards.json: ")


def test_a_manifest_of_too_few_shards_and_a_missing_shard_are_told(folder, address, capsys):
    manifest = folder / "shards" / "shards.json"
    text = manifest.read_text()
    manifest.write_text(text.replace('"frames": 3', '"frames": 2'))
    with pytest.raises(ValueError, match=r"counts 1 shards, but there is 000001\.json; copy it"):
        open_dataset(f"{address}/shards")
    manifest.write_text(text)
    (folder / "shards" / "000001.tar").rename(folder / "away.tar")
    assert main(["check", address.replace("http", "HTTP") + "/shards"]) == 1
    out = capsys.readouterr().out
    assert "000002.png: cannot be read: 000001.tar is absent; copy it to the server, or" in out


class StartPageHandler(RangeHandler):
    """Answers with its start page for what is not there, as servers of single pages do."""

    def translate_path(self, path):
        found = super().translate_path(path)
        return found if Path(found).is_file() else str(Path(self.directory) / "index.html")


def test_a_start_page_in_the_place_of_what_is_absent_is_no_shard(folder, capsys):
    (folder / "index.html").write_text("<!DOCTYPE html><html><body>Hello</body></html>\n")
    for address in serve(folder, StartPageHandler):
        assert len(open_dataset(f"{address}/shards/training")) == 3
        assert len(open_dataset(f"{address}/shards/000001.tar")) == 1
        with pytest.raises(ValueError, match="holds no shards, or cannot be reached"):
            open_dataset(f"{address}/nothing")
        assert main(["shard", f"{address}/nothing", str(folder / "out")]) == 2
        assert f"{address}/nothing is no folder" in capsys.readouterr().err


class FailingHandler(RangeHandler):
    """Answers 503 for one file at every attempt."""

    def do_HEAD(self):
        if self.path.endswith("/000001.json"):
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            super().do_HEAD()

    def do_GET(self):
        self.do_HEAD() if self.path.endswith("/000001.json") else super().do_GET()


def test_a_shard_that_the_server_fails_to_give_is_not_taken_for_absent(folder, monkeypatch):
    monkeypatch.setattr(byte_source, "_WAITS_S", (0.01,))
    manifest = folder / "shards" / "shards.json"
    manifest.write_text(manifest.read_text().replace('"frames": 3', '"frames": 2'))
    for address in serve(folder, FailingHandler):
        with pytest.raises(
            ValueError, match=r"000001\.json: cannot be read: its server answers 503"
        ):
            open_dataset(f"{address}/shards")


class EndlessHandler(PlainHandler):
    """Serves files without their length."""

    def do_GET(self):
        self.send_response(HTTPStatus.OK)
        self.end_headers()

    def do_HEAD(self):
        self.do_GET()


def test_a_server_that_does_not_tell_lengths_is_named(folder):
    for address in serve(folder, EndlessHandler):
        with pytest.raises(ValueError, match=r"shards\.json: its server does not tell its length"):
            open_dataset(f"{address}/shards")


def test_a_server_that_accepts_and_says_nothing_is_named(monkeypatch):
    monkeypatch.setattr(byte_source, "_TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        shards = f"http://127.0.0.1:{silent.getsockname()[1]}/shards"
        with pytest.raises(
            ValueError, match=f"^{shards}/shards.json: cannot be read: .*[Tt]imeout"
        ):
            open_dataset(shards)


class BusyHandler(RangeHandler):
    """Answers the first request for each tar by an error, or by half of it, and then serves it."""

    refused: ClassVar[set[str]] = set()
    faults = ("503", "half")

    def do_GET(self):
        if not self.path.endswith(".tar") or self.path in self.refused:
            super().do_GET()
            return
        self.refused.add(self.path)
        if self.faults[len(self.refused) % 2] == "503":
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        self.send_response(HTTPStatus.PARTIAL_CONTENT)
        self.send_header("Content-Length", "1000")
        self.end_headers()
        self.wfile.write(b"half")


def test_a_server_that_is_busy_for_a_moment_is_asked_again(folder, monkeypatch):
    monkeypatch.setattr(byte_source, "_WAITS_S", (0.01, 0.01))
    for address in serve(folder, BusyHandler):
        dataset, tree = open_dataset(f"{address}/shards"), open_dataset(folder / "tree")
        for index in range(len(tree)):
            assert torch.equal(dataset[index].points, tree[index].points)
    assert len(BusyHandler.refused) == 2


class OverloadedHandler(RangeHandler):
    """Answers all requests for tars by 429."""

    def do_GET(self):
        if self.path.endswith(".tar"):
            self.send_error(HTTPStatus.TOO_MANY_REQUESTS)
        else:
            super().do_GET()


def test_a_server_s_fault_is_not_blamed_on_the_files(folder, monkeypatch, capsys):
    monkeypatch.setattr(byte_source, "_WAITS_S", (0.01,))
    for address in serve(folder, OverloadedHandler):
        assert main(["check", f"{address}/shards"]) == 1
    out = capsys.readouterr().out
    assert f"{address}/shards/training/image_2/000000.png: cannot be read: 000000.tar cannot" in out
    assert "its server answers 429; check the address, the network and your rights" in out
    assert "http:/1" not in out
    assert "extract it again" not in out
    assert "KITTI" not in out


class CircleHandler(PlainHandler):
    """Redirects each address to itself."""

    def do_GET(self):
        self.send_response(HTTPStatus.FOUND)
        self.send_header("Location", self.path)
        self.end_headers()

    def do_HEAD(self):
        self.do_GET()


def test_a_server_that_redirects_in_a_circle_is_named(folder):
    for address in serve(folder, CircleHandler):
        with pytest.raises(ValueError, match="cannot be read: its server redirects without an end"):
            open_dataset(f"{address}/shards")


def test_shards_at_the_root_of_a_server_are_checked(folder, capsys):
    for address in serve(folder / "shards", RangeHandler):
        assert main(["check", address]) == main(["check", str(folder / "tree")])
        one, other = capsys.readouterr().out.split("object frames")[1:]
        assert one.partition("\n")[0] == other.partition("\n")[0]


@pytest.mark.parametrize("output", ["s3://b/out", "memory://x/out", "file:///tmp/x/out"])
def test_an_output_at_an_address_is_refused(folder, capsys, monkeypatch, output):
    monkeypatch.chdir(folder)
    tree = str(folder / "tree")
    before = sorted(folder.rglob("*"))
    for arguments in (
        ("shard", tree, output),
        ("predict", "depth-completion", tree, output, "--method", "nearest"),
        ("show", tree, "000000", "--out", f"{output}.png"),
        ("health", tree, "--json", f"{output}.json"),
        ("corrupt", tree, output, "--cases", "camera_blank"),
        ("perceive", tree, output),
        ("unshard", str(folder / "shards"), output),
        ("simulate", output, "--preset", "street-8k"),
    ):
        assert main([*arguments]) == 2, arguments
        (line,) = capsys.readouterr().err.splitlines()
        assert "is an address, and outputs are written to this machine; name" in line, arguments
        assert output in line
    assert sorted(folder.rglob("*")) == before


def test_a_file_s_address_keeps_its_root(folder):
    dataset = open_dataset(f"file://{folder}/shards")
    assert dataset.sample_ids == ("000000", "000001", "000002")


def test_a_path_of_this_machine_is_no_url(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert url_of(tmp_path) is None
    (tmp_path / "s3:").mkdir()
    (tmp_path / "s3:" / "x").touch()
    assert url_of(Path("s3:/x")) is None
    assert url_of(Path("s3:/y/z")) == "s3://y/z"


def test_labels_at_an_address_have_the_lists_of_their_data_set(address):
    labels = Path(f"{address}/shards/training/label_2")
    for place in (labels, data_path(labels)):
        assert list(frame_names(place, "last")) == ["000002"]
        with pytest.raises(ValueError, match="there is no list 'first'"):
            frame_names(place, "first")
