"""Headless Chromium by playwright, for the tests of the page; they skip where either is missing."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest

AXE = Path(__file__).with_name("axe.min.js")
PATIENCE_MS = 600_000  # machines may be busy: the networks are converted, and graphics computed
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--disable-background-networking")  # fmt: skip

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
if CHROMIUM is None:
    pytest.skip("there is no Chromium; apt-get install chromium", allow_module_level=True)


@contextmanager
def serving(*words, environment=()):
    """Run `sightline serve` and give its process and address."""
    command = [sys.executable, "-m", "sightline", "serve", *words, "--no-browser"]
    if "--engine" not in words:
        command += ["--engine", "torch"]
    if "--port" not in words:
        command += ["--port", "0"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", **dict(environment)},
    ) as server:
        yield server, server.stdout.readline().split()[0]
        server.terminate()


@contextmanager
def chromium():
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=list(SOFTWARE))
        yield browser
        browser.close()


def serious_findings(shown):
    """Rules of axe-core that a page breaks seriously, with where."""
    shown.page.evaluate(AXE.read_text())
    found = shown.page.evaluate("axe.run()")
    return [
        (each["id"], [node["html"][:120] for node in each["nodes"]])
        for each in found["violations"]
        if each["impact"] in ("serious", "critical")
    ]


class Shown:
    """A page that is shown, with what it asked for and complained of."""

    def __init__(self, browser, address, query="", width=1280, scheme="dark"):
        self.address = address
        self.context = browser.new_context(
            viewport={"width": width, "height": 844}, color_scheme=scheme, accept_downloads=True
        )
        self.page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.asked, self.complaints, self.dropped = [], [], []
        self.page.on("request", lambda each: self.asked.append(each.url))
        self.page.on("requestfailed", lambda each: self.dropped.append(each.url))
        self.page.on("pageerror", lambda each: self.complaints.append(str(each)))
        self.page.on("console", self._hear)
        self.page.goto(f"{address}?{query}")
        self.settle()

    def _hear(self, message):
        if message.type == "error":
            self.complaints.append(message.text)

    def settle(self):
        self.page.wait_for_timeout(50)
        self.page.wait_for_selector("body[data-busy=false]")

    @property
    def elsewhere(self):
        """Requests that left the page's address; blob: is the page's own memory."""
        return [url for url in self.asked if not url.startswith((self.address, "blob:"))]

    @property
    def link(self):
        return parse_qs(urlsplit(self.page.url).query)

    def slide(self, name, value):
        self.page.locator(f"#{name}").fill(str(value))
        self.settle()

    def num_colors(self, name):
        """Colours of a canvas, 16 levels a channel, each of more than three pixels."""
        return self.page.evaluate(
            """(id) => {
              const seen = document.getElementById(id);
              const copy = new OffscreenCanvas(seen.width, seen.height).getContext("2d");
              copy.drawImage(seen, 0, 0);
              const { data } = copy.getImageData(0, 0, seen.width, seen.height);
              const counts = new Map();
              for (let k = 0; k < data.length; k += 4) {
                const key = (data[k] >> 4) * 256 + (data[k + 1] >> 4) * 16 + (data[k + 2] >> 4);
                counts.set(key, (counts.get(key) ?? 0) + 1);
              }
              return [...counts.values()].filter((count) => count > 3).length;
            }""",
            name,
        )

    def mean_level(self, name):
        return self.page.evaluate(
            """(id) => {
              const seen = document.getElementById(id);
              const { data } = seen.getContext("2d").getImageData(0, 0, seen.width, 60);
              let sum = 0;
              for (let k = 0; k < data.length; k += 4) sum += data[k + 1];
              return (4 * sum) / data.length;
            }""",
            name,
        )
