"""What fails while the page is open is told in one line, and the page goes on: in Chromium."""

import os
import resource
import signal
import socket
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from tests.app.browsing import Shown, serving


@pytest.fixture(scope="module")
def served():
    with serving() as served:
        yield served


def workers_of(server):
    """Process ids of the workers: all that descend from the server and compute."""
    parents = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            name, _, rest = status.read_text().rpartition(")")
        except OSError:  # ended meanwhile
            continue
        parents[int(name.split()[0])] = int(rest.split()[1])
    children = {pid for pid, parent in parents.items() if parent == server.pid}
    return {pid for pid, parent in parents.items() if parent in children}


def fill_disk(server):
    """Let no process of a server write to a file any more, as on a full disk."""
    while len(workers := workers_of(server)) < 2:
        time.sleep(0.1)
    for pid in (server.pid, *workers):
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0))


def told(shown):
    """The line of the notice, once there is one."""
    shown.page.wait_for_selector("#notice:not([hidden])")
    text = shown.page.locator("#notice").inner_text()
    assert text
    assert "\n" not in text
    return text


def test_a_killed_worker_is_told_and_the_whole_answer_comes(browser, served):
    server, address = served
    shown = Shown(browser, address)
    for pid in workers_of(server):
        os.kill(pid, signal.SIGKILL)
    shown.page.get_by_role("button", name="8 beams").click()
    assert told(shown) == "a worker process had ended and was started again"
    shown.settle()
    assert shown.page.locator("#status").inner_text().startswith("all results")
    assert shown.page.locator("#objects td.kept").count() >= 1
    shown.page.get_by_role("button", name="Camera blank").click()
    shown.settle()
    assert shown.page.locator("#notice").is_hidden()
    shown.context.close()


def test_two_tabs_show_each_its_own_state(browser, served):
    _, address = served
    one, other = Shown(browser, address), Shown(browser, address, "frame=000001")
    one.page.get_by_role("button", name="LiDAR blank").click()
    other.page.get_by_role("button", name="Camera blank").click()
    one.settle()
    other.settle()
    for shown, empty in ((one, "cloud"), (other, "image-broken")):
        assert shown.page.locator("#notice").is_hidden()
        assert shown.page.locator("#status").inner_text().startswith("all results")
        assert shown.complaints == []
        assert shown.page.locator(f"#{empty}").is_visible()
    assert one.page.locator("#cloud-note").inner_text() == "0 points"
    assert "frame 000001" in other.page.locator("#time-note").inner_text()
    assert "covered" in other.page.locator("#health").inner_text()
    one.context.close()
    other.context.close()


def test_a_server_that_is_gone_is_told_and_the_page_goes_on_when_it_is_back(browser):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    with serving("--port", port) as (server, address):
        shown = Shown(browser, address)
        server.terminate()
        server.wait()
        shown.page.get_by_role("button", name="8 beams").click()
        assert told(shown).startswith("the server does not answer; the page goes on when")
    with serving("--port", port) as (_, address):
        shown.page.wait_for_selector("#notice[hidden]", state="attached")
        shown.settle()
        assert shown.page.locator("#objects td.kept").count() >= 1
        assert shown.link["fault"] == ["lidar_beams.4.0"]
        assert urlsplit(shown.page.url).netloc == urlsplit(address).netloc
        shown.context.close()


def test_on_a_full_disk_the_page_goes_on_as_nothing_is_written(browser, served):
    server, address = served
    fill_disk(server)  # for good: the last test of this server
    shown = Shown(browser, address)
    shown.page.get_by_role("button", name="Fog").click()
    shown.settle()
    assert shown.page.locator("#status").inner_text().startswith("all results")
    assert shown.page.locator("#notice").is_hidden()
    assert shown.page.locator("#objects td.kept").count() >= 1
    shown.context.close()
