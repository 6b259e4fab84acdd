"""The page in a real browser: headless Chromium by playwright, where both are installed."""

import json
import shutil
from urllib.parse import urlsplit

import cv2
import pytest

from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.app.browsing import Shown, serious_findings, serving

DARK_OF_256 = 12
NAMED = """() => {  // number of objects with their score in the image
  const own = CanvasRenderingContext2D.prototype.fillText;
  let count = 0;
  CanvasRenderingContext2D.prototype.fillText = function (text, ...rest) {
    if (this.canvas.id === "image-broken" && /[0-9][.][0-9]{2}$/.test(text)) count += 1;
    own.call(this, text, ...rest);
  };
  dispatchEvent(new Event("resize"));
  CanvasRenderingContext2D.prototype.fillText = own;
  return count;
}"""


@pytest.fixture(scope="module")
def address():
    with serving() as (_, address):
        yield address


def test_sound_sensors_show_objects_points_depth_and_health(show):
    shown = show()
    page = shown.page
    assert page.locator("#objects tr").count() >= 3
    assert {each.inner_text() for each in page.locator("#objects td.found").all()} == {"found"}
    assert shown.num_colors("image-broken") > 100
    assert shown.num_colors("cloud") > 20
    assert page.locator("#depth-broken").is_visible()
    assert not page.locator("#image-clean").is_visible()
    assert "ok" in page.locator("#health").inner_text()
    assert page.locator("#notice").is_hidden()
    assert "sightline perceive" in page.locator("#commands").inner_text()


def test_a_blank_camera_is_seen_noticed_and_kept_in_the_link(show):
    shown = show()
    shown.page.get_by_role("button", name="Camera blank").click()
    shown.settle()
    shown.page.wait_for_selector(".alarm")
    assert shown.link["fault"] == ["camera_blank.5.0"]
    assert shown.mean_level("image-broken") < DARK_OF_256 < shown.mean_level("image-clean")
    assert "covered: black areas without texture" in shown.page.locator("#health").inner_text()
    pressed = shown.page.locator("#presets button[aria-pressed=true]")
    assert pressed.all_inner_texts() == ["Camera blank"]
    assert shown.page.locator("#objects td.kept").count() >= 1
    again = show(urlsplit(shown.page.url).query)
    assert again.link == shown.link
    assert again.mean_level("image-broken") < DARK_OF_256


def test_each_control_changes_the_link_and_each_is_restored_from_it(show):
    shown = show()
    page = shown.page
    page.get_by_role("button", name="Next frame").click()
    page.get_by_role("button", name="Add a fault").click()
    page.get_by_label("Kind of fault").select_option("camera_jpeg")
    page.get_by_label("Severity").fill("2")
    page.get_by_label("Seed").fill("5")
    page.get_by_label("Seed").press("Tab")
    shown.slide("beams", 4)
    shown.slide("yaw", -1.5)
    shown.slide("score", 0.5)
    page.get_by_label("choose", exact=True).check()
    page.locator("#weights-depth-completion").select_option("nearest")
    for name in ("2D boxes", "3D boxes in the image", "labels of the data", "view follows"):
        page.get_by_label(name).click()
    for name, value in {"gates": "lidar", "colour": "range", "depth": "uncertainty"}.items():
        page.locator(f"#{name}").select_option(value)
    page.get_by_label("clean", exact=True).check()
    page.get_by_role("button", name="Light").click()
    shown.settle()
    expected = {
        "frame": ["000001"],
        "fault": ["camera_jpeg.2.5", "lidar_beams.4.0"],
        "yaw": ["-1.5"],
        "depth-completion": ["nearest"],
        "score": ["0.5"],
        "compare": ["clean"],
        "boxes2d": ["0"],
        "projected": ["0"],
        "labels": ["1"],
        "follow": ["1"],
        "gates": ["lidar"],
        "colour": ["range"],
        "depth": ["uncertainty"],
        "theme": ["light"],
    }
    assert shown.link == expected
    again = show(urlsplit(page.url).query)
    assert again.link == expected
    assert again.page.locator("#beams-out").inner_text() == "8 of 64"
    assert again.page.locator("html").get_attribute("data-theme") == "light"
    again.page.get_by_role("button", name="Remove this fault").first.click()
    again.settle()
    assert again.link["fault"] == ["lidar_beams.4.0"]


def test_what_a_link_names_in_vain_is_told_and_the_rest_is_shown(show):
    shown = show("frame=77&fault=lidar_fog.2.0&fault=lidar_mist.3.0&yaw=2.0&detection2d=mine")
    expected = "frame 77, fault lidar_mist.3.0, detection2d mine"
    assert shown.page.locator("#notice").inner_text().endswith(f": {expected}")
    assert shown.link == {"frame": ["000000"], "fault": ["lidar_fog.2.0"], "yaw": ["2"]}


def test_while_networks_are_used_for_the_first_time_the_page_says_so(browser, address):
    context = browser.new_context()
    page = context.new_page()
    page.route("**/api/answers*", lambda _: None)  # never answered
    page.goto(address)
    page.locator("#status", has_text="picture came after").wait_for()
    assert "networks used for the first time" in page.locator("#status").inner_text()
    context.close()


def test_everything_can_be_done_by_keys(show):
    shown = show()
    page = shown.page
    page.locator("main").focus()
    for key in (".", "c", "l", "g", "3"):
        page.keyboard.press(key)
    shown.settle()
    page.keyboard.press("n")
    expected = {
        "frame": ["000001"],
        "compare": ["broken"],
        "labels": ["1"],
        "gates": ["camera"],
        "colour": ["reflectance"],
        "selected": ["c0"],
    }
    assert {name: shown.link.get(name) for name in expected} == expected
    assert page.locator("tr[data-selected=true]").count() == 1
    page.keyboard.press("Escape")
    assert "selected" not in shown.link
    page.locator("#cloud").focus()
    for key in ("ArrowLeft", "Shift+ArrowUp", "+"):
        page.keyboard.press(key)
    assert len(shown.link["camera"][0].split(",")) == 6


def test_only_the_selected_object_is_named_in_the_image(show):
    shown = show()
    named = shown.page.evaluate(NAMED)
    shown.page.locator("#objects button").first.click()
    assert named >= 3
    assert shown.page.evaluate(NAMED) == 1


def test_a_selected_object_is_selected_in_all_views(show):
    shown = show("compare=broken")
    before = shown.page.evaluate("document.getElementById('image-broken').toDataURL()")
    shown.page.locator("#objects button").first.click()
    assert shown.link["selected"] == ["c0"]
    after = shown.page.evaluate("document.getElementById('image-broken').toDataURL()")
    assert before != after
    assert shown.page.locator("#objects button").first.get_attribute("aria-pressed") == "true"


def test_a_newer_request_cancels_the_older_and_the_last_state_is_shown(show):
    shown = show()
    for value in (0.5, 1.0, 1.5, 2.0):
        shown.page.locator("#yaw").fill(str(value))
    shown.settle()
    assert any("api/answers" in url and "yaw=0.5" in url for url in shown.dropped)
    assert shown.link["yaw"] == ["2"]
    assert shown.page.locator("#status").inner_text().startswith("all results")
    assert "turned" in shown.page.locator("#health").inner_text()


def test_an_older_answer_that_comes_all_the_same_does_not_end_the_newer_request(show):
    shown = show()
    shown.page.evaluate("""() => {
      AbortController.prototype.abort = () => {};
      window.numEnds = 0;
      const count = () => { if (document.body.dataset.busy === "false") window.numEnds += 1; };
      new MutationObserver(count).observe(document.body, { attributeFilter: ["data-busy"] });
    }""")

    over = []
    for event in ("requestfinished", "requestfailed"):  # a stream's end may be told as either
        shown.page.on(event, lambda request: over.append(request.url))
    shown.page.evaluate("""() => {
      const slider = document.getElementById("yaw");
      for (const value of ["0.5", "2"]) {
        slider.value = value;
        slider.dispatchEvent(new Event("input", { bubbles: true }));
      }
    }""")
    for _ in range(6000):
        if any("api/answers" in url and "yaw=2" in url for url in over):
            break
        shown.page.wait_for_timeout(100)
    shown.settle()
    assert shown.page.locator("#status").inner_text().startswith("all results")
    assert shown.page.evaluate("window.numEnds") == 1


def test_the_drive_is_played_and_judged(show):
    shown = show()
    shown.page.get_by_role("button", name="Play").click()
    shown.page.wait_for_url("**frame=000001*")
    shown.settle()
    before = shown.num_colors("timeline")
    shown.page.get_by_role("button", name="Health of all frames").click()
    shown.page.wait_for_timeout(3000)
    assert shown.num_colors("timeline") >= before > 2


def test_what_is_seen_is_saved_as_png_and_as_a_line_of_json(show, tmp_path):
    shown = show("fault=lidar_blank.5.0")
    for name in ("PNG", "JSON"):
        with shown.page.expect_download() as saved:
            shown.page.get_by_role("button", name=f"Save {name}").click()
        saved.value.save_as(tmp_path / saved.value.suggested_filename)
    picture = cv2.imread(str(tmp_path / "sightline-000000.png"))
    captions = picture[:26].max(axis=2)
    assert 20 < (captions > 200).sum() < captions.size / 4  # words, white on black
    assert captions[:, -300:].max() == 0  # black beside them
    line = json.loads((tmp_path / "sightline-000000.json").read_text())
    assert line["faults"] == [{"kind": "lidar_blank", "severity": 5, "seed": 0}]
    assert line["num_points"] == 0
    assert line["tasks"]["detection2d"] == {"by": "detection2d-fast-cpu"}
    assert {"class", "score", "box_px", "box_3d", "support"} == line["objects"][0].keys()


def test_a_damaged_frame_is_told_in_one_line_and_the_next_one_is_shown(browser, tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    with serving(str(tmp_path / "tree")) as (_, address):
        (tmp_path / "tree/training/velodyne/000001.bin").write_bytes(b"123")
        shown = Shown(browser, address, "frame=000001")
        notice = shown.page.locator("#notice")
        assert "000001.bin" in notice.inner_text()
        assert "\n" not in notice.inner_text()
        shown.page.get_by_role("button", name="Previous frame").click()
        shown.settle()
        assert notice.is_hidden()
        assert shown.page.locator("#objects tr").count() >= 3
        shown.context.close()


def test_a_phone_shows_all_without_scrolling_aside(show):
    shown = show(width=390)
    assert shown.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert shown.page.locator("#image-broken").bounding_box()["y"] < 300
    assert shown.num_colors("cloud") > 10


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_axe_finds_nothing_serious(show, scheme):
    shown = show("fault=camera_fog.3.0", scheme=scheme)
    assert serious_findings(shown) == []
