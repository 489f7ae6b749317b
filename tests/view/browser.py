"""A run, its view, and a browser without a window that drives the page."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

SCENARIO = Path(__file__).parents[2] / "scenarios" / "stopping_horde.toml"
TOOLS = ("chromium", "chromedriver")
SETTINGS = (
    "run.episodes=100000",
    "telemetry.control=true",
    "horde.demons.0.bins=0",
    "horde.features.prototypes=50",
)
"""What is said of the scenario: 112 demons, and no end."""
RATE = ("devices.joint.sampling={rate='1kHz'}",)
PATIENCE = 60
"""So long (s) is waited for what has to come: kernels may have to be compiled first."""
Driver = webdriver.Chrome


def found_tools() -> list[str]:
    """Return the paths of the browser and of what drives it; skip, but fail where CI should have them."""
    paths = [shutil.which(tool) for tool in TOOLS]
    if None in paths:
        sentence = "chromium and chromedriver are missing: apt-get install chromium chromium-driver"
        pytest.fail(sentence) if os.environ.get("CI") else pytest.skip(sentence)
    return [path for path in paths if path]


@contextmanager
def browser(width: int = 1440, height: int = 1000, *more: str) -> Iterator[Driver]:
    """Give a browser, with `more` arguments."""
    chromium, driver = found_tools()
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", *more):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    with webdriver.Chrome(options=options, service=Service(driver)) as window:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        window.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        yield window


def colours(window: Driver, scheme: str) -> None:
    """Have the browser prefer light or dark."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    window.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start(*arguments: str) -> subprocess.Popen[str]:
    """Start rtagent."""
    return subprocess.Popen([sys.executable, "-m", "rtagent", *arguments], stdout=subprocess.PIPE, text=True)


@contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """Give a process that is interrupted in the end."""
    with process:
        try:
            yield process
        finally:
            process.terminate()


@contextmanager
def view_of(endpoint: str) -> Iterator[tuple[str, int]]:
    """Give the address of a view of all runs there, and the process's number."""
    with ended(start("view", "--port", "0", "--endpoint", endpoint)) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[4], process.pid


@contextmanager
def run_at(endpoint: str, settings: Sequence[str] = SETTINGS + RATE) -> Iterator[subprocess.Popen[str]]:
    """Give a run that is published there."""
    given = [f"--set={each}" for each in (*settings, f"telemetry.endpoint='{endpoint}'")]
    with ended(start("run", str(SCENARIO), "--quiet", *given)) as process:
        yield process


INK = """
const canvas = document.querySelector(arguments[0]);
const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
const wanted = getComputedStyle(document.documentElement).getPropertyValue("--s1").trim();
const [r, g, b] = [1, 3, 5].map((at) => parseInt(wanted.slice(at, at + 2), 16));
let count = 0;
for (let at = 0; at < data.length; at += 4) {
  const away = Math.abs(data[at] - r) + Math.abs(data[at + 1] - g) + Math.abs(data[at + 2] - b);
  count += data[at + 3] > 60 && away < 60;
}
return count;
"""
"""Counts the pixels of a canvas in the colour of its first series, thin lines among them."""


@dataclass
class Viewed:
    """A page in a browser, and where its run is published."""

    window: Driver
    address: str
    endpoint: str
    server: int

    def __call__(self, script: str) -> Any:
        """Return what a script in the page returns."""
        return self.window.execute_script(f"return {script}")

    def find(self, selector: str) -> WebElement:
        return self.window.find_element(By.CSS_SELECTOR, selector)

    def text(self, selector: str) -> str:
        return self.find(selector).text

    def count(self, selector: str) -> int:
        return len(self.window.find_elements(By.CSS_SELECTOR, selector))

    def until(self, true: Callable[[], Any], what: str) -> Any:
        return WebDriverWait(self.window, PATIENCE, 0.1, [WebDriverException]).until(lambda _: true(), what)

    def press(self, *keys: str) -> None:
        ActionChains(self.window).send_keys(*keys).perform()

    def drag(self, selector: str, begin: float, end: float) -> None:
        """Drag over a part of an element, from one fraction of its width to another."""
        target = self.find(selector)
        self.window.execute_script("arguments[0].scrollIntoView({block: 'center'})", target)
        width = target.size["width"]
        actions = ActionChains(self.window).move_to_element_with_offset(target, round((begin - 0.5) * width), 0)
        actions.click_and_hold().move_by_offset(round((end - begin) * width), 0).release().perform()

    def load(self) -> None:
        """Load the page, and wait until it shows a run."""
        self.window.get(self.address)
        self.until(
            lambda: self("rtagentView.measured.frames.length > 5 && rtagentView.view.run !== ''"), "a run is shown"
        )
        self.until(lambda: self.count(".plot") > 4, "plots are shown")

    def ink(self, plot: str) -> int:
        """Return how many pixels of a plot have the colour of its first series."""
        return int(self.window.execute_script(INK, f"{plot} canvas"))

    def complaints(self) -> list[str]:
        """Return what the browser complained of since it was last asked."""
        return [
            entry["message"] for entry in self.window.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")
        ]


@contextmanager
def viewed(settings: Sequence[str] = SETTINGS + RATE) -> Iterator[tuple[Viewed, subprocess.Popen[str]]]:
    """Give a page that shows a run, and the run."""
    found_tools()
    with ExitStack() as stack:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        address, pid = stack.enter_context(view_of(endpoint))
        run = stack.enter_context(run_at(endpoint, settings))
        page = Viewed(stack.enter_context(browser()), address, endpoint, pid)
        page.load()
        yield page, run
