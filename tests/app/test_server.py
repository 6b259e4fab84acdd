import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
from importlib.resources import files
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from starlette.testclient import TestClient

from sightline.app.guard import HEADERS
from sightline.app.parts import Task
from sightline.app.run import page_server
from sightline.app.server import make_app
from sightline.app.state import Breakage, PageState
from sightline.files.problem import FileError
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.app.makers import QuickMaker, dataset, settings
from tests.data.recordings import CAMERA_FROM_LIDAR, write_calibration, write_recording
from tests.data.trees import write_drive


def client_of(folder=PACKAGED_FRAMES, **changes):
    maker = QuickMaker(dataset(folder), folder, "torch")
    return TestClient(make_app(settings(folder, **changes), maker))


@pytest.fixture(scope="module")
def client():
    with client_of() as client:
        yield client


def events_of(response):
    blocks = response.text.strip().split("\n\n")
    pairs = [block.split("\n") for block in blocks]
    return [(name[len("event: ") :], json.loads(data[len("data: ") :])) for name, data in pairs]


def test_the_page_and_its_files_come_from_the_package_with_strict_headers(client):
    page = client.get("/")
    assert page.status_code == 200
    assert page.headers["content-type"].startswith("text/html")
    for name, value in HEADERS.items():
        assert page.headers[name] == value
    assert "default-src 'self'" in page.headers["content-security-policy"]
    script = client.get("/static/main.js")
    assert script.headers["content-type"].startswith("text/javascript")


@pytest.mark.parametrize(
    "path",
    ["/static/../server.py", "/static/%2e%2e%2fserver.py", "/static/__init__.py", "/api/file/x"],
)
def test_there_are_no_other_files(client, path):
    assert client.get(path).status_code == 404


def test_the_page_is_light(client):
    names = [each.name for each in files("sightline.app").joinpath("static").iterdir()]
    assert {"main.js", "page.css"} <= set(names)
    assert sum(len(client.get(f"/static/{name}").content) for name in names) < 400_000


def test_setup_lists_frames_kinds_and_weights(client):
    setup = client.get("/api/setup").json()
    assert setup["frames"] == ["000000", "000001"]
    assert len(setup["kinds"]) == 34
    assert setup["kinds"][0]["levels"][4] == "chance of a picture to be lost 1"
    assert setup["tasks"]["detection2d"] == ["detection2d-best", "detection2d-fast-cpu", "none"]
    assert setup["best"]["detection3d"] == "detection3d-best"


def test_the_picture_of_a_fault_is_a_jpeg_and_points_of_eight_bytes_zipped(client):
    image = client.get("/api/file/image?fault=camera_blank.5.0")
    pixels = cv2.imdecode(np.frombuffer(image.content, np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (375, 1242, 3)
    assert pixels.max() == 0
    points = client.get("/api/file/points?fault=lidar_beams.4.0")
    assert points.headers["content-encoding"] == "gzip"
    (count,) = struct.unpack_from("<I", points.content)
    assert len(points.content) == 8 + 8 * count
    scene = client.get("/api/scene?fault=lidar_beams.4.0").json()
    assert scene["num_points"] == count < client.get("/api/scene").json()["num_points"]
    assert scene["sensors"] == {"camera": True, "lidar": True}


def test_all_parts_come_as_events_and_then_the_end(client):
    response = client.get("/api/answers?client=a&fault=lidar_fog.3.1")
    assert response.headers["content-type"].startswith("text/event-stream")
    events = events_of(response)
    assert events[-1] == ("done", {})
    parts = [content["part"] for name, content in events if name == "part"]
    assert sorted(parts) == [
        "depth-completion", "detection2d", "detection3d", "health", "joined",
    ]  # fmt: skip
    assert parts.index("joined") > parts.index("detection2d")


def test_health_has_the_limits_that_fit_the_pictures_whatever_frame_is_damaged(tmp_path):
    tree = tmp_path / "tree"
    shutil.copytree(PACKAGED_FRAMES, tree)
    pictures = sorted((tree / "training/image_2").iterdir())
    for picture in pictures:
        image = cv2.imread(str(picture))
        _, encoded = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 75))
        picture.with_suffix(".jpg").write_bytes(encoded.tobytes())
        picture.unlink()
    pictures[-1].with_suffix(".jpg").write_bytes(b"damaged")
    with client_of(tree) as client:
        events = events_of(client.get("/api/answers?client=a"))
    health = next(content for _, content in events if content.get("part") == "health")
    assert health["limits"]["camera"] == "shipped, JPEG pictures (recognised)"
    assert health["camera"]["score"] > 0.5  # 0.24 by the limits of PNG


def test_a_changed_calibration_is_read_anew_or_asks_for_a_new_start(tmp_path):
    recording = write_recording(tmp_path / "drive", ("a",), cloud=".npy", picture=".png")
    drive, names = write_drive(tmp_path / "2011_09_26" / "raw", 1), ("a", "0000000000")
    with warnings.catch_warnings(action="ignore"):
        makers = [QuickMaker(dataset(each), each, "torch") for each in (recording, drive)]
        scenes = [
            Task(part="scene", state=PageState(broken=Breakage(frame=name))) for name in names
        ]
        before = [maker.make(scene) for maker, scene in zip(makers, scenes, strict=True)]
        stamps = [
            maker.stamp(scene.state.broken.frame)
            for maker, scene in zip(makers, scenes, strict=True)
        ]
        moved = CAMERA_FROM_LIDAR.copy()
        moved[0, 3] += 0.5
        write_calibration(recording, camera_from_lidar=moved.tolist())
        (calibration,) = tmp_path.rglob("calib_velo_to_cam.txt")
        calibration.write_text(calibration.read_text() + "\n")
        after = makers[0].make(scenes[0]).content["image_from_lidar"]
        assert after != before[0].content["image_from_lidar"]
        with pytest.raises(FileError, match="has changed since the page was started; start it ag"):
            makers[1].make(scenes[1])
    for maker, name, stamp in zip(makers, names, stamps, strict=True):
        assert maker.stamp(name) != stamp


def test_a_part_that_fails_is_told_in_one_line_and_the_others_come(client):
    events = events_of(client.get("/api/answers?client=a&fault=lidar_fog.3.8"))
    faults = [content for name, content in events if name == "fault"]
    assert {fault["part"] for fault in faults} == {"detection3d", "joined"}
    assert all("damaged" in fault["reason"] and "\n" not in fault["reason"] for fault in faults)
    assert {content["part"] for name, content in events if name == "part"} == {
        "detection2d", "depth-completion", "health",
    }  # fmt: skip


def test_a_worker_that_is_killed_is_told_and_the_page_goes_on(client):
    events = events_of(client.get("/api/answers?client=a&fault=lidar_fog.3.9"))
    reasons = {content["reason"] for name, content in events if name == "fault"}
    assert any("was ended by SIGKILL twice" in reason for reason in reasons)
    after = events_of(client.get("/api/answers?client=a"))
    assert [name for name, _ in after].count("part") == 5


def test_a_state_that_does_not_exist_is_refused_in_one_line(client):
    for path in ("scene", "file/image", "answers", "timeline", "commands"):
        refused = client.get(f"/api/{path}?frame=000009")
        assert refused.status_code == 422
        assert refused.json()["reason"].startswith("the data has no frame '000009'")


def test_the_commands_name_the_engine_of_the_page():
    with client_of(engine="torch") as client:
        assert "--engine torch" in client.get("/api/commands").json()["commands"]


def test_the_time_line_judges_each_frame_with_alarms(client):
    events = events_of(client.get("/api/timeline?client=t&fault=camera_blank.5.0"))
    assert [content.get("frame") for _, content in events[:-1]] == ["000000", "000001"]
    assert events[0][1]["scores"]["camera"] < 0.01
    assert events[0][1]["alarms"] == ["camera"]  # without data, one frame is enough
    sound = events_of(client.get("/api/timeline?client=t"))
    assert [content.get("alarms") for _, content in sound[:-1]] == [[], []]


def test_a_damaged_frame_is_told_and_the_next_one_works(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    with client_of(tmp_path / "tree") as client:
        (tmp_path / "tree/training/image_2/000000.png").write_bytes(b"\x89PNG cut")
        refused = client.get("/api/scene?frame=000000")
        assert refused.status_code == 422
        assert "000000.png" in refused.json()["reason"]
        assert client.get("/api/scene?frame=000001").status_code == 200


def test_a_frame_whose_file_is_replaced_is_read_anew(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    with client_of(tmp_path / "tree") as client:
        before = client.get("/api/scene?frame=000001").content
        assert client.get("/api/scene?frame=000001").content == before
        training = tmp_path / "tree/training"
        shutil.copy(training / "velodyne/000000.bin", training / "velodyne/000001.bin")
        assert client.get("/api/scene?frame=000001").content != before
        (training / "image_2/000001.png").write_bytes(b"\x89PNG cut")
        assert client.get("/api/scene?frame=000001").status_code == 422


def test_a_link_that_leads_out_of_the_data_is_refused(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    sweep = tmp_path / "tree/training/velodyne/000000.bin"
    sweep.rename(tmp_path / "outside.bin")
    sweep.symlink_to(tmp_path / "outside.bin")
    with client_of(tmp_path / "tree") as client:
        refused = client.get("/api/scene?frame=000000")
        assert refused.status_code == 422
        assert "is a link that leads out of the data" in refused.json()["reason"]


def test_nothing_is_written_to_the_data(tmp_path):
    shutil.copytree(PACKAGED_FRAMES, tmp_path / "tree")
    before = sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*"))
    with client_of(tmp_path / "tree") as client:
        client.get("/api/answers?client=a&fault=camera_fog.3.0")
        client.get("/api/commands?fault=camera_fog.3.0")
    assert sorted(path.stat().st_mtime_ns for path in tmp_path.rglob("*")) == before


@pytest.mark.parametrize("path", ["answers?client=a&turn=1", "file/depth?turn=1"])
def test_a_server_that_is_told_to_end_does_not_wait_for_answers(path, capfd):
    server = page_server(make_app(settings(), QuickMaker(dataset(), PACKAGED_FRAMES, "torch")))
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        with socket.create_connection(listening.getsockname()) as asking:
            request = f"GET /api/{path}&fault=lidar_fog.1.4 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
            asking.sendall(request.encode())
            while not server.server_state.tasks:  # an answer of an hour
                time.sleep(0.05)
            server.should_exit = True
            thread.join()
    assert capfd.readouterr().err == ""


def test_a_browser_that_waits_for_the_page_gets_it(tmp_path):
    """As browsers in a terminal do, such as w3m."""
    (tmp_path / "browser.py").write_text(
        "import sys, pathlib, urllib.request\n"
        "with urllib.request.urlopen(sys.argv[1]) as page:\n"
        "    pathlib.Path(sys.argv[2]).write_text(str(page.status))\n"
    )
    seen = tmp_path / "seen"
    browser = f"{sys.executable} {tmp_path / 'browser.py'} %s {seen}"
    command = [sys.executable, "-m", "sightline", "serve", "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "BROWSER": browser},
    ) as server:  # fmt: skip
        deadline = time.monotonic() + 300
        while not seen.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        server.terminate()
        server.communicate()
    assert seen.read_text() == "200"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_page_with_a_word_of_its_own(number):
    command = [sys.executable, "-m", "sightline", "serve", "--port", "0", "--no-browser"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as server:
        address, _, hint = server.stdout.readline().partition(" ")
        assert hint == "(Ctrl-C ends it)\n"
        urlopen(address).close()  # the server's loop runs
        server.send_signal(number)
        _, told = server.communicate()
    assert (told, server.returncode) == ("sightline: the page has ended\n", 128 + number)
