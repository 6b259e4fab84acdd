"""Latencies of the page of `sightline serve`, its weight, its first paint and its 3D view.

python -m benchmarks.page_latency [--states 20] [--frames 60]

The server runs as for a user, with two worker processes and the fast weights; the page is opened in
headless Chromium, which draws in software. Each state turns the LiDAR by another
angle, as the slider does, so nothing is taken from memory. Wall times count from the change of the
slider to the part's arrival on the page; processor time is that of the server with its workers, or
of the browser. Prints a row for each part, then one line of JSON, kept in
benchmarks/results/page_latency.json.
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import torch
from playwright.sync_api import Page, sync_playwright

import sightline
from benchmarks.record import print_record
from sightline.app.parts import PartMaker, PartName, Task
from sightline.app.state import FAST, parse_state
from sightline.jobs.pool import one_blas_thread
from sightline.simulation.packaged import PACKAGED_FRAMES

_FIRST_DEG: Final = 0.5
_STEP_DEG: Final = 0.25
_POINTS: Final = 120_000
_SETTLED: Final = "body[data-busy=false]"
_PATIENCE_MS: Final = 600_000
_DRAWN_MS: Final = 300
"""Time after the last part, within which the browser has drawn it."""
_SOFTWARE: Final = ("--no-sandbox", "--enable-unsafe-swiftshader")
"""Options of Chromium, which then draws as it does wherever there is no graphics card."""
_PARTS: Final[tuple[PartName, ...]] = (
    "scene", "health", "detection2d", "detection3d", "depth-completion", "joined",
)  # fmt: skip
_WATCH: Final = """() => {
  window.told = [];
  const seen = document.getElementById("status");
  new MutationObserver(() => window.told.push([performance.now(), seen.textContent]))
    .observe(seen, { childList: true });
}"""
_SPIN: Final = """async ([points, frames]) => {
  const { Cloud } = await import("./static/cloud.js");
  const canvas = document.createElement("canvas");
  canvas.style = "position: fixed; inset: 0; width: 960px; height: 420px; z-index: 9";
  document.body.append(canvas);
  const cloud = new Cloud(canvas, [[0, 0, 80], [250, 230, 30]], () => {});
  const bytes = new Uint8Array(8 * points);
  const view = new DataView(bytes.buffer);
  for (let k = 0; k < points; k += 1) {
    const [azimuth, ring] = [k * 0.0031, k % 64];
    const far = Math.min(6000, 173 / Math.tan(0.03 + (0.4 * ring) / 64));
    view.setInt16(8 * k, far * Math.cos(azimuth), true);
    view.setInt16(8 * k + 2, far * Math.sin(azimuth), true);
    view.setInt16(8 * k + 4, -173, true);
  }
  const image = new ImageData(4, 4);
  const rows = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]];
  cloud.load("broken", { cloud: { count: points, step: 0.01, bytes }, image,
    image_from_lidar: rows, image_size_px: [4, 4] });
  cloud.show([{ side: "broken", boxes: [] }], { mode: 0, isLight: false });
  const pixel = new Uint8Array(4);
  const since = performance.now();
  for (let k = 0; k < frames; k += 1) {
    cloud.camera[0] += 0.05;
    cloud.draw();
    cloud.gl.readPixels(0, 0, 1, 1, cloud.gl.RGBA, cloud.gl.UNSIGNED_BYTE, pixel);
  }
  const taken = performance.now() - since;
  canvas.remove();
  return (1000 * frames) / taken;
}"""
_FIRST_PAINT: Final = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--frames", type=int, default=60)
    given = parser.parse_args()
    load_before = os.getloadavg()[0]
    alone = parts_alone(given.states)
    with serving() as (server, address), sync_playwright() as started:
        chromium = shutil.which("chromium")
        if chromium is None:
            parser.error("there is no Chromium; apt-get install chromium")
        browser = started.chromium.launch(executable_path=chromium, args=list(_SOFTWARE))
        page = browser.new_page(viewport={"width": 1280, "height": 844})
        page.set_default_timeout(_PATIENCE_MS)
        page.goto(address)
        page.wait_for_selector(_SETTLED)
        wall, cpu = slider(page, server.pid, given.states)
        paints = [first_paint(page) for _ in range(5)]
        spin = float(page.evaluate(_SPIN, [_POINTS, given.frames]))
        browser.close()
    processor = {**alone, **cpu}
    results = [
        {"part": name, **_pair("processor", processor[name]), **_pair("wall", wall.get(name, ()))}
        for name in ("picture", *_PARTS[1:], "whole", "browser")
    ]
    for row in results:
        print(row)
    static = files("sightline.app").joinpath("static")
    print_record(
        {
            "states": given.states,
            "workers": 2,
            "load_average": [round(load_before, 1), round(os.getloadavg()[0], 1)],
            "results": results,
            "page_bytes": sum(len(each.read_bytes()) for each in static.iterdir()),
            "first_paint_ms": round(statistics.median(paints), 1),
            "view": {"points": _POINTS, "frames_per_s": round(spin, 1), "by": "SwiftShader"},
        },
        seed=None,
        weights=FAST.values(),
    )


def parts_alone(num_states: int) -> dict[str, list[float]]:
    """Measure the processor time of each part in this process, with one thread [ms]."""
    cv2.setNumThreads(0)
    torch.set_num_threads(1)
    one_blas_thread()
    dataset = sightline.open_dataset(
        PACKAGED_FRAMES, parts=("image", "points", "objects"), needs=()
    )
    maker = PartMaker(dataset, PACKAGED_FRAMES, "auto")
    times: dict[str, list[float]] = {}
    for number, yaw_deg in enumerate(angles(num_states + 1)):
        state = parse_state(f"yaw={yaw_deg:g}", dataset.sample_ids)
        found = {"detection2d": b"", "detection3d": b""}
        for name in _PARTS:
            given = found["detection2d"], found["detection3d"]
            since = time.process_time()
            answer = maker.make(Task(part=name, state=state, found=given))
            taken_ms = 1000 * (time.process_time() - since)
            found[name] = answer.found
            if number:  # the first one starts the networks
                times.setdefault("picture" if name == "scene" else name, []).append(taken_ms)
    return times


def slider(
    page: Page, pid: int, num_states: int
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Move the slider of the yaw, and measure the parts' arrivals and the processor times [ms].

    Processor time is that of the server with its workers (`whole`) and that of the browser.
    """
    wall: dict[str, list[float]] = {}
    processor: dict[str, list[float]] = {"whole": [], "browser": []}
    page.evaluate(_WATCH)
    for number, yaw_deg in enumerate(angles(num_states + 1)):
        page.evaluate("() => { window.told = []; }")
        before, all_before = processor_ms(pid), processor_ms(os.getpid())
        since = page.evaluate("() => performance.now()")
        page.locator("#yaw").fill(f"{yaw_deg:g}")
        page.wait_for_selector(_SETTLED)
        if not number:
            continue
        page.wait_for_timeout(_DRAWN_MS)
        server_ms = processor_ms(pid) - before
        processor["whole"].append(server_ms)
        processor["browser"].append(processor_ms(os.getpid()) - all_before - server_ms)
        for arrived, text in page.evaluate("() => window.told"):
            part = re.search(r"(\S+) came after", text)
            if part or text.startswith("all results"):
                name = part[1] if part else "whole"
                wall.setdefault(name, []).append(arrived - since)
    return wall, processor


def angles(count: int) -> list[float]:
    """List other angles within the slider's ten degrees [deg]."""
    return [_FIRST_DEG + number * _STEP_DEG for number in range(count)]


def first_paint(page: Page) -> float:
    """Load the page again, and give the time of its first paint with content [ms]."""
    page.reload()
    page.wait_for_selector(_SETTLED)
    return float(page.evaluate(_FIRST_PAINT))


@contextmanager
def serving() -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Run the server on the packaged frames, and give its process and address."""
    command = [sys.executable, "-m", "sightline", "serve", "--no-browser", "--port", "0"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"}
    ) as server:
        assert server.stdout is not None, "it was asked for"
        yield server, server.stdout.readline().split()[0]
        server.terminate()


def processor_ms(pid: int) -> float:
    """Sum the processor time of a process and of all that it has started [ms]."""
    parents: dict[int, int] = {}
    ticks: dict[int, int] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:  # ended meanwhile
            continue
        own = int(status.parent.name)
        parents[own], ticks[own] = int(fields[1]), int(fields[11]) + int(fields[12])
    family = {pid}
    while more := {each for each, parent in parents.items() if parent in family} - family:
        family |= more
    return 1000 * sum(ticks.get(each, 0) for each in family) / os.sysconf("SC_CLK_TCK")


def _pair(name: str, times_ms: Sequence[float]) -> dict[str, Any]:
    if not times_ms:
        return {}
    median, upper = np.quantile(times_ms, (0.5, 0.95))
    return {
        f"{name}_median_ms": round(float(median), 1),
        f"{name}_percentile_95_ms": round(float(upper), 1),
    }


if __name__ == "__main__":
    main()
