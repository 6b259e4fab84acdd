"""An exported page in a real browser, from a plain web server under a sub-path."""

import json
import subprocess
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from tests.app.browsing import Shown, serious_findings

DARK_OF_256 = 12
WHY = "not computed when this page was exported"


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_message):
        pass


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Root of a web server with the exported page below it."""
    root = tmp_path_factory.mktemp("web")
    command = [sys.executable, "-m", "sightline", "serve", "--export", root / "docs/play"]
    command += ["--kinds", "lidar_fog", "lidar_beams", "--severities", "2", "4"]
    # In a process of its own, as playwright's event loop runs in this one.
    subprocess.run([*command, "--engine", "torch"], check=True)
    return root


@pytest.fixture(scope="module")
def address(root):
    handler = partial(Quiet, directory=str(root))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/docs/play/"
        server.shutdown()
        thread.join()


def test_the_views_and_the_buttons_work_from_files(show):
    shown = show()
    page = shown.page
    assert page.locator("#objects tr").count() >= 3
    assert shown.num_colors("image-broken") > 100
    assert shown.num_colors("cloud") > 20
    assert page.locator("#exported").is_visible()
    assert "sightline perceive frames found" in page.locator("#commands").inner_text()
    page.get_by_role("button", name="Camera blank").click()
    shown.settle()
    assert shown.mean_level("image-broken") < DARK_OF_256 < shown.mean_level("image-clean")
    assert "covered" in page.locator("#health").inner_text()
    assert page.locator("#objects td.kept").count() >= 1
    page.get_by_role("button", name="Turned 2 degrees").click()
    shown.settle()
    assert shown.link["yaw"] == ["2"]
    assert "turned" in page.locator("#health").inner_text()
    for name, value in {"gates": "lidar", "colour": "fault", "depth": "uncertainty"}.items():
        page.locator(f"#{name}").select_option(value)
    shown.slide("score", 0.5)
    page.get_by_label("labels of the data").check()
    assert {"gates", "colour", "depth", "score", "labels"} <= shown.link.keys()
    loaded = "each => each.complete && each.naturalWidth > 0"  # perhaps after the page has settled
    page.wait_for_function(loaded, arg=page.locator("#depth-broken").element_handle())
    assert page.locator("#notice").is_hidden()


def test_sliders_go_through_what_was_computed(show):
    shown = show()
    page = shown.page
    beams = [64, 32, 8]  # severities 2 and 4
    for position, count in enumerate(beams):
        shown.slide("beams", position)
        text = page.locator("#beams-out").inner_text()
        assert text == ("all" if position == 0 else f"{count} of 64")
    assert shown.link["fault"] == ["lidar_beams.4.0"]
    shown.slide("yaw", 1)  # alone, as both together were not computed
    assert shown.link["yaw"] == ["2"]
    assert "fault" not in shown.link
    shown.slide("yaw", 0)
    page.get_by_role("button", name="Add a fault").click()
    page.get_by_label("Kind of fault").select_option("lidar_fog")
    shown.settle()
    assert shown.link["fault"] == ["lidar_fog.2.0"]
    page.get_by_label("Severity").press("ArrowRight")
    shown.settle()
    assert shown.link["fault"] == ["lidar_fog.4.0"]
    page.get_by_role("button", name="Remove this fault").click()
    shown.settle()
    assert "fault" not in shown.link


def test_what_was_not_computed_is_switched_off_and_says_why(show):
    shown = show("fault=lidar_fog.2.0")
    page = shown.page
    for each in ("Seed", "best", "choose"):
        control = page.get_by_label(each, exact=True)
        assert control.is_disabled()
        assert control.get_attribute("title") == WHY
    assert page.get_by_role("button", name="Add a fault").is_disabled()  # one fault at a time
    kinds = page.get_by_label("Kind of fault").locator("option")
    offered = [each.get_attribute("value") for each in kinds.all() if each.is_enabled()]
    assert offered == ["camera_blank", "lidar_blank", "lidar_beams", "lidar_fog"]


def test_fog_of_both_sensors_can_only_be_taken_off_where_the_other_was_computed(show):
    shown = show()
    shown.page.get_by_role("button", name="Fog").click()
    shown.settle()
    assert shown.link["fault"] == ["camera_fog.4.0", "lidar_fog.4.0"]
    assert shown.page.get_by_label("Severity").first.is_disabled()
    camera, lidar = shown.page.get_by_role("button", name="Remove this fault").all()
    assert lidar.is_disabled()  # fog of the camera alone was not computed
    camera.click()
    shown.settle()
    assert shown.link["fault"] == ["lidar_fog.4.0"]


def test_frames_are_played_and_judged(show):
    shown = show("fault=camera_blank.5.0")
    shown.page.get_by_role("button", name="Play").click()
    shown.page.wait_for_url("**frame=000001*")
    shown.settle()
    shown.page.get_by_role("button", name="Health of all frames").click()
    shown.page.wait_for_timeout(500)
    assert shown.num_colors("timeline") > 2


def test_a_link_to_a_state_that_was_not_computed_says_so_and_shows_the_sound_frame(show):
    shown = show("frame=000001&fault=lidar_rain.3.0")
    assert "was not computed" in shown.page.locator("#notice").inner_text()
    assert shown.link == {"frame": ["000001"]}
    shown.page.get_by_role("button", name="8 beams").click()
    shown.settle()
    assert shown.page.locator("#notice").is_hidden()
    assert shown.page.locator("#objects td.kept").count() >= 1


def test_what_is_seen_is_saved(show, tmp_path):
    shown = show("fault=lidar_blank.5.0")
    for name in ("PNG", "JSON"):
        with shown.page.expect_download() as saved:
            shown.page.get_by_role("button", name=f"Save {name}").click()
        saved.value.save_as(tmp_path / saved.value.suggested_filename)
    assert (tmp_path / "sightline-000000.png").read_bytes()[:4] == b"\x89PNG"
    line = json.loads((tmp_path / "sightline-000000.json").read_text())
    assert line["faults"] == [{"kind": "lidar_blank", "severity": 5, "seed": 0}]
    assert line["objects"]


def test_a_file_that_is_missing_is_told_and_the_page_goes_on_when_it_is_there(
    browser, address, root
):
    places = json.loads((root / "docs/play/setup.json").read_text())["states"]
    place = root / "docs/play" / places["frame=000001"]
    content = place.read_bytes()
    place.unlink()
    shown = Shown(browser, address)
    shown.page.get_by_role("button", name="Next frame").click()
    shown.page.wait_for_selector("#notice:not([hidden])")
    assert "cannot be loaded; the page goes on" in shown.page.locator("#notice").inner_text()
    place.write_bytes(content[: len(content) // 2])  # as while it is copied
    shown.page.wait_for_timeout(3000)
    assert "cannot be loaded; the page goes on" in shown.page.locator("#notice").inner_text()
    place.write_bytes(content)
    shown.page.wait_for_selector("#notice[hidden]", state="attached")
    shown.settle()
    assert shown.page.locator("#objects tr").count() >= 3
    shown.context.close()


@pytest.mark.parametrize("width", [1280, 390])
def test_axe_finds_nothing_serious(show, width):
    shown = show("fault=lidar_fog.2.0", width=width)
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= width
    assert serious_findings(shown) == []
